"""The loss of `training.loss` and its gradient, for all members together."""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from neurotact.networks.population.population import Batch, Counts
from neurotact.networks.specs import RSNNSpec


class Settings(NamedTuple):
    """Parameters of the loss of each member, `(member,)` each, in the float type of the counts."""

    hidden: Tensor
    """Hidden neurons, without padding."""
    temperature: Tensor
    rate_penalty: Tensor
    population_penalty: Tensor

    @staticmethod
    def of(networks: Sequence[RSNNSpec], device: torch.device) -> "Settings":
        rows = [
            (spec.hidden, spec.training.temperature, spec.training.rate_penalty, spec.training.population_penalty)
            for spec in networks
        ]
        return Settings(*torch.tensor(rows, dtype=torch.float32, device=device).unbind(dim=1))


class Losses(NamedTuple):
    """For each place: its loss in float64, the number of correctly decided windows, and dL/d counts."""

    loss: Tensor
    correct: Tensor
    g: Counts


def losses(counts: Counts, labels: Tensor, batch: Batch, settings: Settings, n_classes: int) -> Losses:
    """Cross-entropy and rate penalties of the windows of a batch; labels `(place, trial)`.

    Sums are float64, so they do not depend on the number of places or padded trials.
    """
    at = batch.members.long()
    hidden, temperature, rate, population = (each[at][:, None] for each in settings)
    real = batch.real
    n = batch.trials[:, None].to(counts.readout.dtype)
    decided = counts.readout[..., :n_classes]
    log_p = torch.log_softmax(decided * temperature[..., None], dim=2)
    right = torch.nn.functional.one_hot(labels, n_classes).to(log_p.dtype)
    entropy = -(log_p * right).sum(dim=2).double() * real
    hidden_spikes = counts.hidden * real[..., None]
    of_neurons = hidden_spikes.sum(dim=1)  # whole numbers, exact in float32
    n_hidden, trials = hidden[:, 0].double(), n[:, 0].double()
    loss = (
        entropy.sum(dim=1) / trials
        + rate[:, 0] * of_neurons.double().sum(dim=1) / (trials * n_hidden)
        + population[:, 0] * of_neurons.double().square().sum(dim=1) / n_hidden
    )
    g_readout = torch.zeros_like(counts.readout)
    g_readout[..., :n_classes] = (log_p.exp() - right) * (temperature / n * real)[..., None]
    own = torch.arange(counts.hidden.shape[2], device=real.device) < hidden
    each = (rate / (n * hidden) + 2 * population * of_neurons / hidden) * own
    g_hidden = each[:, None, :] * real[..., None]
    correct = ((decided.argmax(dim=2) == labels) & real).sum(dim=1)
    return Losses(loss, correct, Counts(g_hidden, g_readout))
