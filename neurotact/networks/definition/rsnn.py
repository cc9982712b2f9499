"""The spiking network: one CUBA-LIF layer, recurrent or not, and a readout that spikes or adds up.

Texture paper, Fig. 1c and Eqs. 4 to 7; initial weights from the Braille-reading study.

A readout that does not spike adds up a bias and the weights of every hidden spike, with a leak or without one
(`readouts.Integration`). It does so in float64, where sums of float32 weights are almost always exact: a decision
depends neither on the order of the spikes nor on the size of a batch.
"""

import math
from functools import cache
from typing import Any, Literal, get_args

import numpy as np
import torch
from torch import Tensor, nn

from neurotact import effects
from neurotact.backend import Backend
from neurotact.checks import at_least, one_of
from neurotact.data.recordings import check_sampling_rate
from neurotact.errors import InputError, number_of
from neurotact.metrics.flops import SYNAPSES
from neurotact.metrics.synops import Synops
from neurotact.networks.definition import clock, executors, native, reference
from neurotact.networks.definition.network import (
    RASTER_VALUES,
    CountedInference,
    Counts,
    Inference,
    Network,
    Rasters,
    Simulated,
    decided,
)
from neurotact.networks.definition.parts import NetworkPart, Sizes
from neurotact.networks.definition.readouts import Integration, Stretches
from neurotact.networks.definition.specs import Model, RSNNSpec, void_keys
from neurotact.networks.definition.surrogate import FastSigmoid, spike_function
from neurotact.networks.exit.rule import ExitRule, Leader
from neurotact.neurons import Adaptation, CubaLIF, SpikeFunction, cuba_lif_start, decay_per_step
from neurotact.progress import say
from neurotact.spec import build, leaves, override

Returns = Literal["counts", "scores", "spikes"]
"""What a call of a network gives."""


def _stretches_of(spec: RSNNSpec, clock_Hz: float) -> Stretches | None:
    """The stretches of a window with readout weights of their own, on the network's clock; None if there is one.

    Raises InputError unless a stretch is a whole number of steps.

    >>> keys = {"readout": "integrator", "readout_stretches": 4, "readout_stretch_ms": 50.0}
    >>> _stretches_of(RSNNSpec.model_validate(keys), 200.0)
    Stretches(number=4, steps=10)
    """
    if spec.readout_stretches == 1:
        return None
    return Stretches(
        spec.readout_stretches, clock.steps_per_bin(spec.readout_stretch_ms, clock_Hz, "readout_stretch_ms")
    )


def _check_decided(spec: RSNNSpec) -> None:
    """InputError for a spec of another network, or of one that training decides on."""
    if spec.model not in get_args(Model):
        what = "'auto' is decided in training" if spec.model == "auto" else f"RSNN is no '{spec.model}'"
        raise InputError(f"model: {what}; give 'rsnn' or 'snn', or train with `nt.train`")
    if spec.direct == "auto":
        raise InputError("direct: 'auto' is decided in training; give true or false, or train with `nt.train`")


class RSNN(Network):
    """`n_inputs` afferents, `spec.hidden` hidden neurons, `n_classes` readout neurons.

    Weights are `(presynaptic, postsynaptic)`: `w_in`, `w_rec`, `w_out`; a feed-forward network's `w_rec` is None.
    An integrator that hears the afferents, too (`spec.direct`, `spec.hidden = 0`), has a row of `w_out` for each of
    them behind those of the hidden neurons.
    `alpha`, `beta` and `threshold` hold one value for the hidden layer and one for the readout, which an integrator
    does not use. An integrator has a `bias` `(class,)`; it is None if the readout spikes. With `readout_stretches` K
    above 1 its weights are `w_out` + `w_stretch`, the latter `(K, heard, class)`, else None. Input spikes are
    `(trial, time, afferent)` of any type with the values 0 and 1, `sampling_rate_Hz` steps a second; with
    `spec.step_ms` the network puts them into bins, and is computed once a bin (`clock`). `backend` chooses the
    implementation (see `native.use_native`).

    Give a complete spec, or its keys: `RSNN(16, 8, hidden=30, tau_mem_ms=40, sampling_rate_Hz=2000.0)`; keys that are
    not given have the spec's defaults. InputError names an unknown key, and one that has no effect beside the others.

    `returns` says what a call gives: `counts`, the pair of readout and hidden neurons; `scores`, the readout alone,
    `(trial, class)`, as a loss of torch and the end of an `nn.Sequential` take it; or `spikes`, the readout's spikes in
    each step of its clock, `(trial, bin, class)`, as the next network of an `nn.Sequential` takes them. Gradients pass
    through all of them to the input.

    >>> net = RSNN(16, 8, hidden=20, sampling_rate_Hz=2000.0, generator=torch.Generator().manual_seed(0))
    >>> net
    RSNN(16 afferents, 20 hidden (recurrent), 8 classes, clock 2000 Hz, tau_mem 20 ms, tau_syn 10 ms, 880 weights)
    >>> spikes = (torch.rand(4, 300, 16) < 0.1).to(torch.uint8)
    >>> net(spikes).readout.shape
    torch.Size([4, 8])
    >>> first = RSNN(16, 9, sampling_rate_Hz=2000.0, returns="spikes")
    >>> nn.Sequential(first, RSNN(9, 8, sampling_rate_Hz=2000.0, returns="scores"))(spikes).shape
    torch.Size([4, 8])
    """

    def __init__(
        self,
        n_inputs: int,
        n_classes: int,
        spec: RSNNSpec | None = None,
        sampling_rate_Hz: float | None = None,
        *,
        backend: Backend = "auto",
        generator: torch.Generator | None = None,
        dtype: torch.dtype = torch.float32,
        returns: Returns = "counts",
        **keys: Any,
    ) -> None:
        super().__init__()
        if sampling_rate_Hz is None:
            raise InputError("sampling_rate_Hz: the time constants need a clock; pass RSNN(..., sampling_rate_Hz=2000)")
        check_sampling_rate(sampling_rate_Hz, "RSNN")
        for name, number in (("n_inputs", n_inputs), ("n_classes", n_classes)):
            at_least(name, number, 1, whole=True)
        table = {} if spec is None else spec.model_dump(mode="json")
        self.spec = spec = build(RSNNSpec, override(table, keys), source="RSNN") if keys or spec is None else spec
        _check_decided(spec)
        effects.check_keys(leaves(keys), [void_keys(spec)], "RSNN")
        one_of("returns", returns, get_args(Returns))
        if returns == "spikes" and spec.integrates:
            raise InputError(f"returns: readout = '{spec.readout}' sends no spikes; set readout = 'count', or 'scores'")
        self.returns: Returns = returns
        self.sampling_rate_Hz = sampling_rate_Hz
        self.steps_per_bin = clock.steps_per_bin(spec.step_ms, sampling_rate_Hz)
        self.clock_Hz = sampling_rate_Hz / self.steps_per_bin
        self.backend: Backend = backend
        self.neuron = CubaLIF(spec.membrane, spec.reset, spec.recurrent_delay_steps)
        self.adaptation: Adaptation | None = None
        if spec.threshold_adaptation:
            decay = decay_per_step(spec.tau_adaptation_ms, self.clock_Hz)
            self.adaptation = Adaptation(spec.threshold_adaptation, decay)
        self.spike: SpikeFunction = spec.spike

        def normal(rows: int, columns: int, deviation: float) -> nn.Parameter:
            return nn.Parameter(torch.randn(rows, columns, generator=generator).to(dtype) * deviation)

        forward, recurrent = spec.forward_weight_scale, spec.forward_weight_scale * spec.recurrent_weight_scale
        self.w_in = normal(n_inputs, spec.hidden, forward / math.sqrt(n_inputs))
        self.w_rec = None
        if spec.recurrent:
            self.w_rec = normal(spec.hidden, spec.hidden, recurrent / math.sqrt(spec.fan_among))
            if spec.recurrent_blocks > 1:
                self.w_rec.data.mul_(self.within_blocks())
        n_heard = spec.heard(n_inputs)
        self.w_out = normal(n_heard, n_classes, forward / math.sqrt(n_heard))
        self.stretches = _stretches_of(spec, self.clock_Hz)
        self.w_stretch: nn.Parameter | None = None
        if self.stretches is not None:
            shape = (self.stretches.number, n_heard, n_classes)
            self.w_stretch = nn.Parameter(torch.zeros(shape, dtype=dtype))
        self.bias = nn.Parameter(torch.zeros(n_classes, dtype=dtype)) if spec.integrates else None
        self.alpha = self._dynamics("alpha", decay_per_step(spec.tau_syn_ms, self.clock_Hz), dtype)
        self.beta = self._dynamics("beta", decay_per_step(spec.tau_mem_ms, self.clock_Hz), dtype)
        self.threshold = self._dynamics("threshold", 1.0, dtype)

    def _dynamics(self, name: str, value: float, dtype: torch.dtype) -> nn.Parameter:
        return nn.Parameter(torch.full((2,), value, dtype=dtype), requires_grad=name in self.spec.learn)

    def __repr__(self) -> str:
        blocks = self.spec.recurrent_blocks
        within = f" in {blocks} blocks" if blocks > 1 else ""
        kind = f"recurrent{within}" if self.spec.recurrent else "feed-forward"
        kind += ", and a path past them" if self.spec.direct and self.spec.hidden else ""
        absent = 0 if self.w_rec is None else self.spec.hidden * (self.spec.hidden - self.spec.fan_among)
        n_weights = sum(weights.numel() for weights in self.weights) - absent
        adapts = ""
        if self.adaptation is not None:
            adapts = (
                f"threshold_adaptation {self.spec.threshold_adaptation:g} over {self.spec.tau_adaptation_ms:g} ms, "
            )
        if not self.spec.hidden:
            sizes = f"{number_of(self.n_inputs, 'afferent')}, no hidden layer, {self.n_classes} classes"
            return f"RSNN({sizes}, clock {self.clock_Hz:g} Hz, {n_weights:,} weights)"
        return (
            f"RSNN({number_of(self.n_inputs, 'afferent')}, {self.spec.hidden} hidden ({kind}), {self.n_classes} "
            f"classes, clock {self.clock_Hz:g} Hz, tau_mem {self.spec.tau_mem_ms:g} ms, "
            f"tau_syn {self.spec.tau_syn_ms:g} ms, {adapts}{n_weights:,} weights)"
        )

    @property
    def weights(self) -> list[nn.Parameter]:
        """The weight matrices: input, recurrent (if any), readout, and its deviations (if any)."""
        return [weights for weights in (self.w_in, self.w_rec, self.w_out, self.w_stretch) if weights is not None]

    @property
    def present(self) -> tuple[Tensor, Tensor, Tensor]:
        """Whether there is a synapse, which is one whose weight is not 0, in any stretch: `(presynaptic,
        postsynaptic)` bool, into, among and out of hidden neurons, on the CPU.
        """
        among = self.w_out.new_zeros(self.spec.hidden, 0) if self.w_rec is None else self.w_rec
        out = self.readout_weights if self.stretches is None else self.readout_weights.abs().sum(dim=0)
        into, among, out = (weights.detach().cpu() != 0 for weights in (self.w_in, among, out))
        return into, among, out

    @property
    def fans(self) -> tuple[Tensor, Tensor, Tensor]:
        """Synapses into hidden neurons `(afferent,)`, among them `(hidden,)`, and of what the readout hears, int64."""
        into, among, out = (there.sum(dim=1) for there in self.present)
        return into, among, out

    @property
    def synapses(self) -> dict[str, int]:
        """Synapses of each projection, of a pruned network (`training.sparsity`): only these count; else empty."""
        if not self.spec.training.sparsity:
            return {}
        return dict(zip(SYNAPSES, (int(fan.sum()) for fan in self.fans), strict=True))

    def within_blocks(self) -> Tensor:
        """Which recurrent synapses exist, `(hidden, hidden)` bool.

        >>> RSNN(2, 2, hidden=4, recurrent_blocks=2, sampling_rate_Hz=1000.0).within_blocks().int().tolist()
        [[1, 1, 0, 0], [1, 1, 0, 0], [0, 0, 1, 1], [0, 0, 1, 1]]
        """
        size = self.spec.hidden // self.spec.recurrent_blocks
        block = torch.arange(self.spec.hidden, device=self.w_in.device) // size
        return block[:, None] == block

    @property
    def readout_weights(self) -> Tensor:
        """The weights of what the readout hears, `(heard, class)`, or of each stretch, `(K, heard, class)`."""
        return self.w_out if self.w_stretch is None else self.w_out + self.w_stretch

    @property
    def n_inputs(self) -> int:
        return self.w_in.shape[0]

    @property
    def n_classes(self) -> int:
        return self.w_out.shape[1]

    def adaptation_of(self, layer: int) -> Adaptation | None:
        """How the thresholds of the hidden layer (0) adapt; those of the readout (1) do not."""
        return self.adaptation if layer == 0 else None

    def spike_of(self, layer: int) -> SpikeFunction:
        """The spike function of the hidden layer (0) or of the readout (1), with its surrogate.

        A `spike` that replaces the one of the spec is used for both.
        """
        readout_scale = self.spec.readout_surrogate_scale
        if layer == 0 or readout_scale is None or self.spike != self.spec.spike:
            return self.spike
        return spike_function(self.spec.surrogate, readout_scale)

    def layer(self, layer: int) -> reference.Layer:
        """The neurons of the hidden layer (0) or of the readout (1)."""
        dynamics = self.alpha[layer], self.beta[layer], self.threshold[layer]
        return reference.Layer(*dynamics, self.neuron, self.spike_of(layer), self.adaptation_of(layer))

    @property
    def model(self) -> reference.Model:
        """All that this network computes with."""
        layers = self.layer(0), self.layer(1)
        weights, how = (self.w_in, self.w_rec, self.readout_weights), (self.integration, self.stretches)
        return reference.Model(*layers, *weights, *how, self.spec.hears_afferents)

    @property
    def integration(self) -> Integration | None:
        """How a readout that does not spike adds up its input; None if readout spikes are counted."""
        if self.bias is None:
            return None
        return Integration(self.bias.to(torch.float64), self.readout_decay, self.spec.readout == "max")

    @property
    def readout_decay(self) -> float:
        """The factor per step of what an integrator has added up; 1 without a leak."""
        leak_ms = self.spec.readout_leak_ms
        return 1.0 if leak_ms is None else decay_per_step(leak_ms, self.clock_Hz)

    @property
    def leaks(self) -> bool:
        """Whether the readout is an integrator whose value depends on the times of spikes."""
        return (integration := self.integration) is not None and integration.leaks

    def forward(self, spikes: Tensor, factors: Tensor | None = None) -> Counts | Tensor:
        """What `returns` says of the whole window, for training: spike counts, or a tensor.

        factors: of the input from each neuron to an integrator that leaks, `(heard,)`, or that has stretches,
            `(trial, heard)`; by default all 1.
        """
        if self.returns == "spikes":
            return self.simulate(spikes).readout
        counts = self.counts(self.binned(spikes), factors)
        return counts.readout if self.returns == "scores" else counts

    def on_own_clock(self) -> "RSNN":
        """The same network for spikes that are `binned`: its sampling rate is that of its own clock; a copy.

        >>> RSNN(2, 2, hidden=3, step_ms=5.0, sampling_rate_Hz=1000.0).on_own_clock().sampling_rate_Hz
        200.0
        """
        spec, dtype = self.spec.model_copy(update={"step_ms": None}), self.w_in.dtype
        generator = torch.Generator()  # the weights are replaced: do not advance the global generator
        sizes = self.n_inputs, self.n_classes
        own = RSNN(*sizes, spec, self.clock_Hz, backend=self.backend, generator=generator, dtype=dtype)
        own.returns = self.returns
        own.load_state_dict(self.state_dict())
        own.spike = self.spike
        return own.to(self.w_in.device)

    def counts(self, spikes: Tensor, factors: Tensor | None = None) -> Counts:
        """`forward` for spikes that are `binned`."""
        self._check(spikes)
        if not self._native():
            return Counts(*reference.counts(self.model, spikes, factors))
        integration = self.integration
        if integration is None:
            return Counts(*native.rsnn_counts(spikes, self))
        if self.stretches is not None:
            hidden, heard = self.counted(spikes, self.stretches)
            values = reference.stretched(self.stretches, heard, self.readout_weights, factors) + integration.level
            return Counts(values.to(hidden), hidden.sum(dim=1))
        if not integration.leaks:
            hidden, heard = self.counted(spikes)
            return Counts(self.sums(heard if factors is None else heard * factors), hidden)
        w_out = self.w_out if factors is None else self.w_out * factors[:, None]
        values, hidden = native.rsnn_counts(spikes, self, w_out)
        return Counts(values + integration.level.to(values), hidden)

    def heard(self, hidden: Tensor, spikes: Tensor) -> Tensor:
        """What the readout hears, `(..., heard)`: spikes of hidden neurons and, where it hears them, of afferents."""
        return torch.cat([hidden, spikes.to(hidden)], dim=-1) if self.spec.hears_afferents else hidden

    def counted(self, spikes: Tensor, stretches: Stretches | None = None) -> tuple[Tensor, Tensor]:
        """Counts of hidden spikes and of what the readout hears, of `binned` windows or of each stretch of them."""
        hidden = self._hidden_counts(spikes, stretches)
        if not self.spec.hears_afferents:
            return hidden, hidden
        return hidden, self.heard(hidden, spikes.sum(dim=1) if stretches is None else stretches.counts(spikes))

    def _hidden_counts(self, spikes: Tensor, stretches: Stretches | None = None) -> Tensor:
        if self._native() and self.spec.hidden:
            dynamics = (self.alpha[0], self.beta[0], self.threshold[0])
            scale = self.spec.surrogate_scale
            return native.layer(
                spikes, self.w_in, self.w_rec, *dynamics, self.neuron, scale, self.adaptation,
                counted=True, stretches=stretches,
            )  # fmt: skip
        sent, _ = self._layer(spikes.to(self.w_in.dtype), self.w_in, self.w_rec, 0, False)
        return sent.sum(dim=1) if stretches is None else stretches.counts(sent)

    def sums(self, heard: Tensor) -> Tensor:
        """The values of an integrator without a leak at the end of a window, from the counts of what it hears."""
        assert self.bias is not None
        return (self.added(heard) + self.bias.to(torch.float64)).to(self.w_out.dtype)

    def simulate(self, spikes: Tensor, *, ordered: bool = False) -> Rasters:
        """Every spike of every neuron; differentiable. `ordered`: by the reference, adding in the kernels' order."""
        return self._simulate(self.binned(spikes), ordered)

    def simulated(self, spikes: Tensor) -> Simulated:
        """`simulate`, with the operations of a pruned network."""
        spikes = self.binned(spikes)
        rasters = self._simulate(spikes)
        return Simulated(rasters, self._sops(spikes, rasters.hidden) if self.synapses else None)

    def operations(self, input_spikes: np.ndarray, hidden_spikes: np.ndarray, sops: np.ndarray | None) -> Synops:
        """As of `Network`; of a pruned one, by projection."""
        return super().operations(input_spikes, hidden_spikes, None) if sops is None else Synops.of(*sops.T)

    def _sops(self, spikes: Tensor, hidden: Tensor) -> Tensor:
        """Operations by projection in each step, `(trial, bin, 3)` int64; a spike is one at each of its synapses."""
        into, among, out = (fan.to(hidden.device).double() for fan in self.fans)
        hidden = hidden.detach().double()
        heard = self.heard(hidden, spikes.double())
        return torch.stack([spikes.double() @ into, hidden @ among, heard @ out], dim=2).round().long()

    def _simulate(self, spikes: Tensor, ordered: bool = False) -> Rasters:
        if not ordered and self._native() and self.spec.hidden:
            hidden = self._native_layer(spikes, self.w_in, self.w_rec, 0)
            spiking = self.bias is None
            if not spiking:
                return Rasters(hidden, self.added(self.heard(hidden, spikes)))
            return Rasters(hidden, self._native_layer(hidden, self.w_out, None, 1))
        hidden, _ = self._layer(spikes.to(self.w_in.dtype), self.w_in, self.w_rec, 0, ordered)
        if self.bias is not None:
            return Rasters(hidden, self.added(self.heard(hidden, spikes)))
        readout, _ = self._layer(hidden, self.w_out, None, 1, ordered)
        return Rasters(hidden, readout)

    def touched(self, spikes: Tensor, hidden: Tensor) -> Tensor:
        """Neurons that a spike reaches in each step, of the hidden layer and of the readout, `(trial, time, 2)` int64.

        spikes: `binned`; hidden: spikes of a window `(trial, time, hidden)`. An event-driven network updates these.
        """
        into, among, out = (there.float() for there in self.present)
        arriving = spikes.float() @ into
        if self.w_rec is not None:
            later = self.neuron.recurrent_delay_steps + (self.neuron.membrane == "immediate")
            back = hidden.float() @ among
            arriving[:, 1 + later :] += back[:, : max(0, back.shape[1] - 1 - later)]
        heard = self.heard(hidden.float(), spikes) @ out
        return torch.stack([(arriving > 0).sum(dim=2), (heard > 0).sum(dim=2)], dim=2)

    def added(self, heard: Tensor) -> Tensor:
        """The input of an integrator from what it hears in each step of a window, `(trial, time, class)`.

        Without stretches also from counts, `(..., class)`.
        """
        if self.stretches is not None:
            return self.stretches.gains(heard.double(), self.readout_weights.double())
        return heard.double() @ self.w_out.double()

    def gained(self, heard: Tensor, step: int) -> Tensor:
        """The input of an integrator from what it hears, `(..., heard)`, in one step of a window, `(..., class)`."""
        weights = self.readout_weights
        return heard.double() @ (weights if self.stretches is None else weights[self.stretches.of_step(step)]).double()

    def _infer(self, spikes: Tensor, rule: ExitRule) -> Inference:
        found = self._decided(spikes, rule)
        if not self.synapses:
            return found
        counted = CountedInference(*found)
        at_once = self._at_once(spikes)
        parts = zip(spikes.split(at_once), found.steps.split(at_once), strict=True)
        counted.sops = torch.cat([self.sops_until(part, self._simulate(part).hidden, n) for part, n in parts])
        return counted

    def sops_until(self, spikes: Tensor, hidden: Tensor, steps: Tensor) -> Tensor:
        """Operations by projection `(trial, 3)` in so many steps of each trial, from its spikes in every step."""
        sops = self._sops(spikes, hidden)
        ran = torch.arange(sops.shape[1], device=steps.device) < steps[:, None]
        return (sops * ran[..., None].to(sops.device)).sum(dim=1)

    def _at_once(self, spikes: Tensor) -> int:
        """Trials whose rasters fit in memory together."""
        n_values = spikes.shape[1] * (self.n_inputs + self.spec.hidden + self.n_classes)
        return max(1, RASTER_VALUES // max(1, n_values))

    def _decided(self, spikes: Tensor, rule: ExitRule) -> Inference:
        if self._native() and not rule.band:  # the kernels have the race of classes alone
            return Inference(*native.rsnn_infer(spikes, self, rule))
        if (integration := self.integration) is not None:
            parts = spikes.split(self._at_once(spikes))
            inferences = (self._infer_sums(part, rule, integration) for part in parts)
            return Inference(*map(torch.cat, zip(*inferences, strict=True)))
        return self._infer_by_steps(spikes, rule)

    def _infer_sums(self, spikes: Tensor, rule: ExitRule, integration: Integration) -> Inference:
        """The decisions of an integrator."""
        n_trials, n_steps, _ = spikes.shape
        steps = torch.full((n_trials,), n_steps, device=spikes.device)
        if rule.never and not integration.leaks and self.stretches is None:
            hidden, heard = self.counted(spikes)
            sums = self.added(heard) + integration.level
            n_input, n_hidden = (part.sum(dim=1).to(torch.int64) for part in (spikes.flatten(1), hidden))
            return Inference(sums.argmax(dim=1), steps, n_input, n_hidden, sums)
        found = decided(spikes, Simulated(self._simulate(spikes)), rule, integration)
        return found if self.spec.hidden else found._replace(hidden_spikes=torch.zeros_like(found.steps))

    def _infer_by_steps(self, spikes: Tensor, rule: ExitRule) -> Inference:
        n_trials, n_steps, _ = spikes.shape
        running = torch.arange(n_trials, device=spikes.device)
        hidden = cuba_lif_start(n_trials, self.spec.hidden, self.w_in)
        readout = cuba_lif_start(n_trials, self.n_classes, self.w_in)
        leader = Leader.start(n_trials, self.n_classes, spikes.device)
        labels, steps, n_input, n_hidden = (torch.zeros_like(running) for _ in range(4))
        result = Inference(labels, steps, n_input, n_hidden, leader.counts.clone())
        totals = torch.zeros(n_trials, 2, dtype=torch.int64, device=spikes.device)
        for t in range(n_steps):
            inputs = spikes[running, t : t + 1].to(self.w_in.dtype)
            hidden_spikes, hidden = self._layer(inputs, self.w_in, self.w_rec, 0, False, hidden)
            readout_spikes, readout = self._layer(hidden_spikes, self.w_out, None, 1, False, readout)
            totals += torch.stack([inputs.sum(dim=(1, 2)), hidden_spikes.sum(dim=(1, 2))], dim=1).to(torch.int64)
            leader = leader.after(readout_spikes[:, 0].to(torch.int64))
            done = leader.exits(rule) if t + 1 < n_steps else torch.ones_like(leader.index, dtype=torch.bool)
            if done.any():
                ended = running[done]
                result.labels[ended], result.steps[ended] = leader.index[done], t + 1
                result.input_spikes[ended], result.hidden_spikes[ended] = totals[done].unbind(dim=1)
                result.readout[ended] = leader.counts[done]
                left = ~done
                running, totals, leader = running[left], totals[left], leader.select(left)
                hidden, readout = (type(state)(*(part[left] for part in state)) for state in (hidden, readout))
            if running.numel() == 0:
                break
        return result

    @torch.no_grad()
    def bound(self) -> None:
        """Keep learned decays in [0, 1], where the dynamics are stable, and a learned threshold positive."""
        if self.spec.learn:
            self.alpha.clamp_(0.0, 1.0)
            self.beta.clamp_(0.0, 1.0)
            self.threshold.clamp_(min=1e-3)

    def _layer(self, x: Tensor, w: Tensor, v: Tensor | None, layer: int, ordered: bool, state=None):
        return reference.cuba_lif_layer(x, w, v, **self.layer(layer)._asdict(), state=state, ordered=ordered)

    def _native_layer(self, x: Tensor, w: Tensor, v: Tensor | None, layer: int) -> Tensor:
        dynamics = (self.alpha[layer], self.beta[layer], self.threshold[layer])
        spike = self.spike_of(layer)
        assert isinstance(spike, FastSigmoid)
        return native.layer(x, w, v, *dynamics, self.neuron, float(spike.scale), self.adaptation_of(layer))

    def _native(self) -> bool:
        # The kernels have the surrogate of the spec; one that replaces it runs in the reference.
        if self.spike != self.spec.spike or not native.use_native(self.backend, self.w_in):
            return False
        subject = executors.Subject(None, self)
        if self.backend == "native":
            executors.require("native", subject)
        lacking = executors.lacking("native", subject)
        if lacking is not None:
            reason = executors.EXECUTORS["native"].lacks[lacking]
            _say_once(f"{lacking}: the kernels do not run it: {reason}; the reference in torch runs, which is slower")
        return lacking is None


@cache
def _say_once(what: str) -> None:
    say(what)


def rsnn_of(executor: str, network: Network) -> RSNN:
    """A network that an executor, or a `chip`, takes at all; InputError for one that is no RSNN."""
    is_rsnn = isinstance(network, RSNN)
    if is_rsnn and not (executor == "chip" and network.spec.hears_afferents):
        return network
    if executor == "chip":
        lacked = _model_of(network) if not is_rsnn else executors.PAST if network.spec.hidden else executors.NO_LAYER
        instead = executors.FEATURES[lacked].instead
        raise InputError(f"{lacked}: limits of chips are known for one hidden layer; {instead}")
    raise executors.refusal(executor, _model_of(network))


def _model_of(network: Network) -> str:
    """The feature of a network that is no RSNN."""
    return executors.LAYERS if network.spec.model in executors.IN_NODES else executors.OTHER


def _of_part(spec: RSNNSpec, sizes: Sizes) -> RSNN:
    n_inputs, n_classes, rate_Hz, _, backend, generator, dtype = sizes
    return RSNN(n_inputs, n_classes, spec, rate_Hz, backend=backend, generator=generator, dtype=dtype)


RECURRENT = NetworkPart("A hidden layer of CUBA-LIF neurons that are connected to one another.", RSNNSpec, _of_part)
FEED_FORWARD = NetworkPart("A hidden layer of CUBA-LIF neurons without recurrence.", RSNNSpec, _of_part)
