"""Several hidden layers of CUBA-LIF neurons, with biases and a time constant of each neuron where they are asked for.

A layer computes `I[t+1] = alpha I[t] + W x[t] + V s[t] + b`; x are the spikes of the layer before in the same step. All
else is as in an `rsnn`, which has one layer (`neurotact.networks.definition.reference`), and the same kernel runs it.
Drawn time constants: Perez-Nieves et al. 2021 (doi 10.1038/s41467-021-26022-3); learned ones: Fang et al. 2021 (arXiv
2007.05785).
"""

import math
from collections.abc import Mapping
from functools import partial
from itertools import pairwise
from typing import Annotated, Literal

import torch
from pydantic import AfterValidator, BeforeValidator, Field
from torch import Tensor, nn

from neurotact import plugins
from neurotact.metrics.flops import Cost, Integrator, SpikingLayer, cost
from neurotact.networks.definition import initial, native, reference
from neurotact.networks.definition.parts import Counted, NetworkPart, Sizes
from neurotact.networks.definition.specs import MOST_HIDDEN
from neurotact.networks.definition.surrogate import FastSigmoid, spike_function
from neurotact.neurons import FAST_SIGMOID, CubaLIF, Membrane, Reset, decay_per_step
from neurotact.spec import Spec

MOST_LAYERS = 8
"""The most hidden layers."""


class Layers(Spec):
    """The keys of a network of several layers; those of an `rsnn` have the same meaning.

    >>> Layers(hidden=(20, 10)).n_hidden
    30
    """

    hidden: Annotated[
        tuple[Annotated[int, Field(ge=1, le=MOST_HIDDEN)], ...],
        BeforeValidator(lambda value: [value] if isinstance(value, int) else value),
        Field(min_length=1, max_length=MOST_LAYERS),
    ] = (20, 10)
    """Neurons of each hidden layer, from the input to the readout."""
    recurrent: bool = False
    """Whether the neurons of a layer are connected to one another."""
    bias: bool = False
    """Whether each hidden neuron has a constant current, learned from 0 on. An integrator has a bias anyway."""
    membrane: Membrane = "eq4"
    reset: Reset = "zero"
    recurrent_delay_steps: int = Field(default=0, ge=0, le=1, strict=True)
    tau_mem_ms: float = Field(default=20.0, gt=0)
    """Time constant of the membranes; the median one, if they are spread."""
    tau_syn_ms: float = Field(default=10.0, gt=0)
    """Time constant of the synaptic currents; the median one, if they are spread."""
    tau_spread: float = Field(default=0.0, ge=0, le=3)
    """Standard deviation of the natural logarithm of the time constants, which are drawn for each hidden neuron.
    0: all are alike."""
    learn: tuple[Literal["alpha", "beta", "threshold"], ...] = ()
    """Which constants are learned with the weights, each hidden neuron its own: the decays of current and membrane per
    step, and thresholds."""
    surrogate: Annotated[str, AfterValidator(partial(plugins.known, "surrogates"))] = FAST_SIGMOID
    surrogate_scale: float = Field(default=10.0, gt=0)
    forward_weight_scale: float = Field(default=1.0, gt=0)
    """g: w ~ N(0, (g / sqrt(fan-in))^2)."""
    recurrent_weight_scale: float = Field(default=0.1, ge=0)
    """r: v ~ N(0, (g r / sqrt(neurons of the layer))^2)."""
    readout: Literal["count", "integrator"] = "integrator"
    input_deviation: float | None = Field(default=None, gt=0)
    """As of an `rsnn`, in each layer from the first to the last."""

    @property
    def n_hidden(self) -> int:
        """Neurons of all hidden layers."""
        return sum(self.hidden)


class _Layer(nn.Module):
    """A layer: weights `w` `(presynaptic, neuron)` and `v`, a `bias`, and a value of each neuron or one for all."""

    v: nn.Parameter | None
    bias: nn.Parameter | None

    def __init__(self, keys: Layers, sizes: Sizes, fan_in: int, n: int, *, is_hidden: bool) -> None:
        super().__init__()
        self.keys, self.sizes = keys, sizes
        self.neuron = CubaLIF(keys.membrane, keys.reset, keys.recurrent_delay_steps)
        self.spike = spike_function(keys.surrogate, keys.surrogate_scale)
        g = keys.forward_weight_scale
        self.w = self._normal(fan_in, n, g / math.sqrt(fan_in))
        recurs = is_hidden and keys.recurrent
        self.v = self._normal(n, n, g * keys.recurrent_weight_scale / math.sqrt(n)) if recurs else None
        self.bias = nn.Parameter(torch.zeros(n)) if is_hidden and keys.bias else None
        self.alpha, self.beta = (
            self._constant(name, self._decays(tau_ms, n, is_hidden=is_hidden), is_hidden=is_hidden)
            for name, tau_ms in (("alpha", keys.tau_syn_ms), ("beta", keys.tau_mem_ms))
        )
        self.threshold = self._constant("threshold", torch.ones(n if is_hidden else 1), is_hidden=is_hidden)

    def _normal(self, rows: int, columns: int, deviation: float) -> nn.Parameter:
        return nn.Parameter(torch.randn(rows, columns, generator=self.sizes.generator) * deviation)

    def _decays(self, tau_ms: float, n: int, *, is_hidden: bool) -> Tensor:
        clock_Hz, spread = self.sizes.clock_Hz, self.keys.tau_spread
        if not is_hidden or not spread:
            return torch.full((n if is_hidden else 1,), decay_per_step(tau_ms, clock_Hz))
        drawn = tau_ms * torch.exp(spread * torch.randn(n, generator=self.sizes.generator))
        return torch.exp(-1e3 / clock_Hz / drawn)

    def _constant(self, name: str, values: Tensor, *, is_hidden: bool) -> nn.Parameter:
        return nn.Parameter(values, requires_grad=is_hidden and name in self.keys.learn)

    def forward(self, x: Tensor) -> Tensor:
        """Spikes `(batch, time, neuron)` from those of the layer before."""
        w = self.w
        if self.bias is not None:  # a constant current is that of an input which always spikes
            x = torch.cat([x, x.new_ones(*x.shape[:-1], 1)], dim=-1)
            w = torch.cat([w, self.bias[None]])
        dynamics = self.alpha, self.beta, self.threshold
        if isinstance(self.spike, FastSigmoid) and native.use_native(self.sizes.backend, w):
            return native.layer(x, w, self.v, *dynamics, self.neuron, float(self.spike.scale))
        names = dict(zip(("alpha", "beta", "threshold"), dynamics, strict=True))
        return reference.cuba_lif_layer(x, w, self.v, **names, neuron=self.neuron, spike=self.spike)[0]


class Layered(nn.Module):
    """The network: `layers`, and a readout that adds up `w_out`, from `level` on, or one that spikes.

    >>> sizes = Sizes(3, 2, 1000.0, 1000.0, generator=torch.Generator().manual_seed(0))
    >>> Layered(Layers(hidden=(4, 2)), sizes)(torch.ones(1, 9, 3)).shape
    torch.Size([1, 9, 2])
    """

    level: nn.Parameter | None

    def __init__(self, keys: Layers, sizes: Sizes) -> None:
        super().__init__()
        self.keys, self.sizes = keys, sizes
        widths = [sizes.n_inputs, *keys.hidden]
        self.layers = nn.ModuleList(_Layer(keys, sizes, *pair, is_hidden=True) for pair in pairwise(widths))
        self.readout = _Layer(keys, sizes, widths[-1], sizes.n_classes, is_hidden=False)
        self.level = nn.Parameter(torch.zeros(sizes.n_classes)) if keys.readout == "integrator" else None

    def forward(self, spikes: Tensor) -> Tensor:
        """Scores in each step: readout spikes, or what an integrator adds, in float64."""
        return self._scores(self._sent(spikes)[-1])

    def counted(self, spikes: Tensor) -> Counted:
        """Scores, the spikes of all hidden neurons, and each spike as an operation at every neuron that it reaches."""
        sent = self._sent(spikes)
        layers = [layer for layer in self.layers if isinstance(layer, _Layer)]
        sops = {"input": _operations(spikes, layers[0].w), "readout": _operations(sent[-1], self.readout.w)}
        sops["between"] = torch.zeros_like(sops["input"])
        for one, layer, following in zip(sent, layers, (*layers[1:], None), strict=True):
            if following is not None:
                sops["between"] += _operations(one, following.w)
            if layer.v is not None:
                sops["recurrent"] = sops.get("recurrent", 0) + _operations(one, layer.v)
        return Counted(self._scores(sent[-1]), torch.cat(sent, dim=2), sops)

    def cost(self, measured: Mapping[str, float], steps: float, signal_ms: float) -> Cost:
        """The cost of a decision of so many steps of its clock; measured: mean SOPs and spikes, as in results.

        Of three hidden layers or more only sums are measured: the first layer bears the recurrence of all but the last,
        and the second all that passes between layers.
        """
        n_classes, keys, into_readout = self.sizes.n_classes, self.keys, measured["sops_readout"]
        n, from_input = len(keys.hidden), measured["sops_input"]
        between = max(0.0, measured["sops_total_feedforward"] - from_input - into_readout)  # means are rounded
        inside = measured["sops_total"] - measured["sops_total_feedforward"]
        of_last = into_readout / n_classes
        inner, own = measured["hidden_spikes"] - of_last, inside if n == 1 else min(inside, keys.hidden[-1] * of_last)
        into = [(from_input, 0.0, measured["input_spikes"]), (between, between, inner), *[(0.0, 0.0, 0.0)] * n][:n]
        among = [(inside - own, inner), *[(0.0, 0.0)] * (n - 2), (own, of_last)][-n:]
        hidden = [
            SpikingLayer(
                *pair, steps=steps, sops=sops + back, recurrent=keys.recurrent, spikes=spikes, sent=again,
                sops_sent=sent + back,
            )
            for pair, (sops, sent, spikes), (back, again) in zip(
                pairwise([self.sizes.n_inputs, *keys.hidden]), into, among, strict=True
            )
        ]  # fmt: skip
        last = keys.hidden[-1]
        readout = (
            Integrator(last, n_classes, sops=into_readout, steps=steps)
            if keys.readout == "integrator"
            else SpikingLayer(last, n_classes, steps=steps, sops=into_readout, recurrent=False, sops_sent=into_readout)
        )
        n, total = keys.n_hidden, cost(*hidden, readout, signal_ms=signal_ms)
        constants = n * (int(keys.bias) + (2 if keys.tau_spread else 0) + len({*keys.learn} - self._spread()))
        return total + Cost(acs=n * steps if keys.bias else 0, parameters=constants, bytes=4 * constants)

    def _spread(self) -> set[str]:
        return {"alpha", "beta"} if self.keys.tau_spread else set()

    @torch.no_grad()
    def begin(self, spikes: Tensor, generator: torch.Generator) -> None:
        """Scale initial weights on training windows, layer by layer, as the recipe does those of an `rsnn`."""
        if self.keys.input_deviation is None or not spikes.any():
            return
        sent = spikes
        for layer in self.layers:
            assert isinstance(layer, _Layer)
            constants = (one.detach().double().cpu() for one in (layer.alpha, layer.beta))
            deviation = initial.free_deviation(sent.cpu(), layer.w.cpu(), layer.neuron, *constants).to(layer.w)
            layer.w.mul_(torch.where(deviation > 0, self.keys.input_deviation * layer.threshold / deviation, 1.0))
            sent = layer(sent)
        if self.level is not None:
            deviation = self._scores(sent).sum(dim=1).std(dim=0, correction=0).mean()
            if deviation > 0:
                self.readout.w.div_(deviation)

    def bound(self) -> None:
        """Keep learned decays in [0, 1], where the dynamics are stable, and learned thresholds positive."""
        for layer in self.layers:
            assert isinstance(layer, _Layer)
            layer.alpha.clamp_(0.0, 1.0)
            layer.beta.clamp_(0.0, 1.0)
            layer.threshold.clamp_(min=1e-3)

    def _sent(self, spikes: Tensor) -> list[Tensor]:
        """Spikes of each hidden layer."""
        sent: list[Tensor] = []
        for layer in self.layers:
            sent.append(layer(sent[-1] if sent else spikes))
        return sent

    def _scores(self, sent: Tensor) -> Tensor:
        return self.readout(sent) if self.level is None else sent.double() @ self.readout.w.double()


def _operations(spikes: Tensor, weights: Tensor) -> Tensor:
    """Operations of spikes in each step, `(batch, time)` float64: one for each of their weights that are not 0."""
    return spikes.detach().double() @ (weights.detach() != 0).sum(dim=1).double()


LAYERED = NetworkPart(
    "Hidden layers of CUBA-LIF neurons, with biases and time constants of each neuron.", Layers, Layered
)
