"""Training by surrogate gradients: cross-entropy on readout counts, rate penalties, Adam, early stopping."""

import copy
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from neurotact.errors import InputError
from neurotact.networks.rsnn import RSNN, Counts
from neurotact.networks.specs import TrainingSpec


class Examples(NamedTuple):
    """Spikes `(trial, time, afferent)` uint8 and class indices `(trial,)` int64."""

    spikes: Tensor
    labels: Tensor


class Epoch(NamedTuple):
    """One line of the training log; accuracies are shares of trials."""

    epoch: int
    train_loss: float
    train_accuracy: float
    validation_loss: float
    validation_accuracy: float


@dataclass(frozen=True)
class Training:
    """How a training went: its log, and the epoch whose weights the network now has."""

    epochs: tuple[Epoch, ...]
    best: Epoch


def loss(counts: Counts, labels: Tensor, spec: TrainingSpec) -> Tensor:
    """Cross-entropy of the readout counts and the two rate penalties of the Braille-reading study.

    `rate_penalty` weighs the spikes of a hidden neuron in a window, averaged over trials and neurons;
    `population_penalty` the squared spike count of a batch, averaged over neurons.
    """
    total = functional.cross_entropy(counts.readout, labels)
    if spec.rate_penalty:
        total = total + spec.rate_penalty * counts.hidden.mean()
    if spec.population_penalty:
        total = total + spec.population_penalty * counts.hidden.sum(dim=0).square().mean()
    return total


def train(
    network: RSNN,
    training: Examples,
    validation: Examples,
    *,
    generator: torch.Generator,
    progress: Callable[[Epoch], None] | None = None,
) -> Training:
    """Train `network` in place by its spec and leave it with the weights of the lowest validation loss.

    generator: orders the trials; with the network's own it fixes every number.
    progress: called after each epoch.
    Raises InputError when a weight is no longer finite: its neurons would fall silent, not fail.

    >>> from neurotact.networks.specs import RSNNSpec, TrainingSpec
    >>> spec = RSNNSpec(hidden=8, training=TrainingSpec(epochs=2, batch=4))
    >>> net = RSNN(2, 2, spec, 2000.0, backend="reference", generator=torch.Generator().manual_seed(0))
    >>> touches = Examples(torch.ones(6, 50, 2, dtype=torch.uint8), torch.tensor([0, 1, 0, 1, 0, 1]))
    >>> len(train(net, touches, touches, generator=torch.Generator().manual_seed(0)).epochs)
    2
    """
    spec = network.spec.training
    device = network.w_in.device
    optimiser = torch.optim.Adam(
        (p for p in network.parameters() if p.requires_grad), lr=spec.learning_rate, fused=True
    )
    log: list[Epoch] = []
    best, best_weights = None, None
    for epoch in range(1, spec.epochs + 1):
        order = torch.randperm(len(training.labels), generator=generator)
        total, correct = 0.0, 0
        for batch in order.split(spec.batch):
            spikes, labels = training.spikes[batch].to(device), training.labels[batch].to(device)
            optimiser.zero_grad()
            counts = network(spikes)
            batch_loss = loss(counts, labels, spec)
            batch_loss.backward()
            optimiser.step()
            _bound(network)
            total += batch_loss.item() * len(batch)
            correct += int((counts.readout.argmax(dim=1) == labels).sum())
        n_trials = len(training.labels)
        log.append(Epoch(epoch, total / n_trials, correct / n_trials, *evaluate(network, validation)))
        if not all(p.isfinite().all() for p in network.parameters()):
            raise InputError(f"training: weights are not finite after epoch {epoch}; lower training.learning_rate")
        if progress:
            progress(log[-1])
        if best is None or log[-1].validation_loss < best.validation_loss:
            best, best_weights = log[-1], copy.deepcopy(network.state_dict())
        elif epoch - best.epoch >= spec.patience:
            break
    assert best is not None  # there is at least one epoch
    assert best_weights is not None
    network.load_state_dict(best_weights)
    return Training(tuple(log), best)


@torch.no_grad()
def evaluate(network: RSNN, examples: Examples) -> tuple[float, float]:
    """`(loss, accuracy)` over the full window."""
    spec = network.spec.training
    device = network.w_in.device
    total, correct = 0.0, 0
    for spikes, labels in zip(examples.spikes.split(spec.batch), examples.labels.split(spec.batch), strict=True):
        counts = network(spikes.to(device))
        labels = labels.to(device)
        total += loss(counts, labels, spec).item() * len(labels)
        correct += int((counts.readout.argmax(dim=1) == labels).sum())
    return total / len(examples.labels), correct / len(examples.labels)


@torch.no_grad()
def _bound(network: RSNN) -> None:
    """Learned decays stay in [0, 1], where the dynamics are stable; a learned threshold stays positive."""
    if network.spec.learn:
        network.alpha.clamp_(0.0, 1.0)
        network.beta.clamp_(0.0, 1.0)
        network.threshold.clamp_(min=1e-3)
