"""What training, early exit, use and studies ask of a network, whichever it is."""

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from neurotact.errors import InputError
from neurotact.metrics import synops
from neurotact.metrics.synops import Synops
from neurotact.networks.definition import clock
from neurotact.networks.definition.readouts import Integration
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.networks.exit.rule import FULL_WINDOW, ExitRule, Leader

RASTER_VALUES = 2**25
"""Spikes and sums that are held in memory where full windows are simulated for early exit."""


class Counts(NamedTuple):
    """Spikes per window, differentiable: `readout` `(trial, class)` and `hidden` `(trial, hidden)`.

    `readout` of an integrator is its value at the end of the window. `hidden` has no neuron where they are not counted.
    """

    readout: Tensor
    hidden: Tensor


class Rasters(NamedTuple):
    """Spikes per step of the network: `hidden` `(trial, bin, hidden)` and `readout` `(trial, bin, class)`.

    `readout` of an integrator is its input at each step, in float64; `Network.integration` adds it up. `hidden` has no
    neuron where hidden spikes are not counted.
    """

    hidden: Tensor
    readout: Tensor


class Simulated(NamedTuple):
    """`Rasters`, and operations by projection, `(trial, bin, projection)`, where the network counts them itself."""

    rasters: Rasters
    sops: Tensor | None = None


class Inference(NamedTuple):
    """The decisions of a network and their cost, one row per trial.

    labels: index of the largest readout count or value, ties to the lowest, or the number of classes for none of them
        (`ExitRule.told`), `(trial,)` int64.
    steps: simulated steps of the input's clock, `(trial,)` int64.
    input_spikes, hidden_spikes: spikes in those steps, summed over neurons, `(trial,)` int64; input spikes that a bin
        merges are one. NaN where hidden spikes are not counted.
    readout: spikes of each readout neuron in those steps, `(trial, class)` int64; values of an integrator, float64.
    """

    labels: Tensor
    steps: Tensor
    input_spikes: Tensor
    hidden_spikes: Tensor
    readout: Tensor


class CountedInference(Inference):
    """The decisions of a network that counts its operations itself: `sops`, `(trial, projection)`."""

    sops: Tensor


class Network(nn.Module):
    """A network on the clock of its spikes or a slower one; `rsnn.RSNN` and `module.ModuleNetwork` are such."""

    spec: RSNNSpec
    sampling_rate_Hz: float
    steps_per_bin: int
    clock_Hz: float

    @property
    def n_inputs(self) -> int:
        raise NotImplementedError

    @property
    def n_classes(self) -> int:
        raise NotImplementedError

    @property
    def integration(self) -> Integration | None:
        """How a readout that does not spike adds up its input; None if readout spikes are counted."""
        raise NotImplementedError

    def counts(self, spikes: Tensor) -> Counts:
        """The counts of windows whose spikes are `binned`."""
        raise NotImplementedError

    def simulate(self, spikes: Tensor) -> Rasters:
        """Every spike of every neuron, or what the network gives of them."""
        raise NotImplementedError

    def simulated(self, spikes: Tensor) -> Simulated:
        """`simulate`, with the operations that the network counts itself."""
        return Simulated(self.simulate(spikes))

    def _infer(self, spikes: Tensor, rule: ExitRule) -> Inference:
        """`infer` for spikes that are `binned`; its steps are the network's."""
        raise NotImplementedError

    @property
    def device(self) -> torch.device:
        """Where its weights are."""
        return next(self.parameters()).device

    @property
    def dtype(self) -> torch.dtype:
        """The float type of its weights."""
        return next(self.parameters()).dtype

    def binned(self, spikes: Tensor) -> Tensor:
        """Input spikes on the network's clock, `(trial, bin, afferent)`."""
        self._check(spikes)
        return clock.binned(spikes, self.steps_per_bin)

    @torch.no_grad()
    def infer(self, spikes: Tensor, rule: ExitRule = FULL_WINDOW) -> Inference:
        """Decide each trial; `rule` stops its simulation.

        For an integrator, the reference simulates full windows and ignores the steps after the exit.
        """
        n_steps, spikes = spikes.shape[1], self.binned(spikes)
        inference = self._infer(spikes, rule.in_bins(self.steps_per_bin))
        labels, steps = rule.told(inference.labels, inference.readout), inference.steps * self.steps_per_bin
        found = inference._replace(labels=labels, steps=steps.clamp(max=n_steps))
        if isinstance(inference, CountedInference):
            found.sops = inference.sops  # pyright: ignore[reportAttributeAccessIssue]
        return found

    @property
    def synapses(self) -> dict[str, int]:
        """Synapses of each projection, by the names of `flops.SYNAPSES`, of a pruned network, else empty."""
        return {}

    def operations(self, input_spikes: np.ndarray, hidden_spikes: np.ndarray, sops: np.ndarray | None) -> Synops:
        """The synaptic operations of decisions, from what `Inference` says of them; NaN if they are not counted."""
        return synops.of_network(self, input_spikes, hidden_spikes)

    @torch.no_grad()
    def bound(self) -> None:
        """Keep learned constants where the dynamics are stable; called after each training step."""

    def _check(self, spikes: Tensor) -> None:
        if spikes.ndim != 3 or spikes.shape[2] != self.n_inputs:
            raise InputError(
                f"spikes: have shape {tuple(spikes.shape)} where (trial, time, {self.n_inputs}) is expected; "
                "train and run a network on the same afferents"
            )


def decided(spikes: Tensor, simulated: Simulated, rule: ExitRule, integration: Integration) -> Inference:
    """The decisions of an integrator on full windows whose spikes are `binned`; steps after the exit do not count."""
    (n_trials, n_steps, _), rasters = spikes.shape, simulated.rasters
    steps = torch.full((n_trials,), n_steps, device=spikes.device)
    leader = Leader.start(n_trials, rasters.readout.shape[2], spikes.device, integration, rule.band)
    labels, sums, running = leader.counts.argmax(dim=1), leader.counts.clone(), steps > 0
    for t in range(n_steps):
        leader = leader.after(rasters.readout[:, t], integration, rule.band)
        stops = running & (leader.exits(rule) | (t + 1 == n_steps))
        labels[stops], sums[stops], steps[stops] = leader.index[stops], leader.counts[stops], t + 1
        running = running & ~stops
    ran = torch.arange(n_steps, device=spikes.device) < steps[:, None]
    n_input = (spikes.sum(dim=2) * ran).sum(dim=1).to(torch.int64)
    n_hidden = (rasters.hidden.sum(dim=2) * ran).sum(dim=1).to(torch.int64)
    if not rasters.hidden.shape[2]:
        n_hidden = n_hidden.double().fill_(torch.nan)
    found = Inference(labels, steps, n_input, n_hidden, sums)
    if simulated.sops is None:
        return found
    counted = CountedInference(*found)
    counted.sops = (simulated.sops * ran[..., None]).sum(dim=1)
    return counted
