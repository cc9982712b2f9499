"""Exchange of networks with snnTorch: Linear, RSynaptic, Linear, Synaptic, stepped over time.

snnTorch's neurons are those with membrane `immediate`, reset `zero` or `subtract`; they clamp alpha and beta to [0, 1]
and have a bias in every projection, which must be zero here. Weights are transposed, because torch.nn.Linear stores
them as (postsynaptic, presynaptic).

The membranes `eq4` and `delayed` are the same neurons one step behind their input: with mem[k] = U[k+1], snnTorch's
mem[k] = beta mem[k-1] + syn[k] is `delayed` where syn[k] = I[k], and `eq4` where syn[k] = beta I[k]. Hence layers
respond to input and hidden spikes two steps later, and for `eq4` all weights are multiplied by beta. The spikes are
equal except for rounding.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple, cast

import snntorch
import torch
from snntorch import surrogate
from torch import Tensor, nn

from neurotact.backend import Backend
from neurotact.data.recordings import check_sampling_rate
from neurotact.errors import InputError
from neurotact.networks.definition import clock
from neurotact.networks.definition.executors import Subject, require
from neurotact.networks.definition.network import Network
from neurotact.networks.definition.readouts import Integration, Stretches
from neurotact.networks.definition.rsnn import RSNN, rsnn_of
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.networks.definition.surrogate import FastSigmoid
from neurotact.networks.use import fitted
from neurotact.networks.use.fitted import Fitted
from neurotact.neurons import Reset
from neurotact.spec import build

RESETS: tuple[Reset, ...] = ("zero", "subtract")
DYNAMICS = ("alpha", "beta", "threshold")


class SnnTorchNetwork(nn.Module):
    """A network of snnTorch's neurons: `(trial, time, afferent)` to the rasters of both layers.

    time_first: whether the axes are `(time, trial, ...)`, of what it takes and returns.

    fc_in, hidden, fc_out, readout: Linear, RSynaptic (Synaptic of a feed-forward network), Linear, Synaptic. If the
        readout does not spike, the last is None: the output of `fc_out` is added up from `level`, with `decay` per
        step; with `peak`, the value is the largest over time.
    per_bin: steps of the input in one of the network: spikes are put into bins first, and rasters have one step a bin.
    stretches, w_stretch: of an integrator with weights of its own in each stretch of a window, what it adds to those of
        `fc_out`, `(K, heard, class)`.
    direct: whether an integrator hears the input spikes, too, behind those of the hidden neurons.
    late: steps by which layers respond late: 0 for `immediate`, 2 for `eq4` and `delayed`.
    recurrent_delay: additional delay of recurrent spikes, in steps.
    """

    def __init__(
        self,
        fc_in: nn.Linear,
        hidden: snntorch.RSynaptic | snntorch.Synaptic,
        fc_out: nn.Linear,
        readout: snntorch.Synaptic | None,
        late: int = 0,
        recurrent_delay: int = 0,
        level: nn.Parameter | None = None,
        decay: float = 1.0,
        peak: bool = False,
        time_first: bool = False,
        per_bin: int = 1,
        stretches: Stretches | None = None,
        w_stretch: nn.Parameter | None = None,
        direct: bool = False,
    ) -> None:
        super().__init__()
        self.time_first = time_first
        self.fc_in, self.hidden, self.fc_out, self.readout = fc_in, hidden, fc_out, readout
        self.level, self.decay, self.peak = level, decay, peak
        self.late, self.recurrent_delay = late, recurrent_delay
        self.per_bin, self.stretches, self.w_stretch, self.direct = per_bin, stretches, w_stretch, direct

    def forward(self, spikes: Tensor) -> tuple[Tensor, Tensor]:
        """`hidden` `(trial, time, hidden)` and `readout` `(trial, time, class)` spikes, from a state of zero.

        `readout` of an integrator is its value after each step.
        """
        self._check(spikes)
        if not self.time_first:
            return self._run(spikes)
        hidden, readout = self._run(spikes.transpose(0, 1))
        return hidden.transpose(0, 1), readout.transpose(0, 1)

    def _check(self, spikes: Tensor) -> None:
        axes = "(time, trial, {})" if self.time_first else "(trial, time, {})"
        if spikes.ndim != 3 or spikes.shape[2] != self.fc_in.in_features:
            raise InputError(
                f"spikes: have shape {tuple(spikes.shape)} where {axes.format(self.fc_in.in_features)} is expected"
            )

    def _run(self, spikes: Tensor) -> tuple[Tensor, Tensor]:
        # Layers receive `(trial, 1, ...)`, and the same tensor objects that other layers return: snnTorch's export to
        # NIR finds the connections by them, and sees one shape.
        arriving = clock.binned(spikes, self.per_bin).float()
        hidden_spikes = self._hidden(arriving)
        hidden = torch.cat(hidden_spikes, dim=1)
        if self.readout is None:
            assert self.level is not None
            heard = hidden_spikes
            if self.direct:
                heard = [torch.cat(both, dim=2) for both in zip(heard, arriving.split(1, dim=1), strict=True)]
            gained = torch.cat([self.fc_out(step) for step in heard], dim=1)
            if self.stretches is not None and self.w_stretch is not None:
                gained = gained + self.stretches.gains(torch.cat(heard, dim=1), self.w_stretch)
            return hidden, torch.stack([*Integration(self.level, self.decay, self.peak).over(gained)], dim=1)
        zero = hidden.new_zeros(len(hidden), 1, self.fc_out.out_features)
        syn, mem, readout = zero, zero, [zero] * self.late
        for step in hidden_spikes[: len(hidden_spikes) - self.late]:
            spike, syn, mem = self.readout(self.fc_out(step), syn, mem)
            readout.append(spike)
        return hidden, torch.cat(readout[: len(hidden_spikes)], dim=1)

    def _hidden(self, spikes: Tensor) -> list[Tensor]:
        """The hidden spikes of each step, `(trial, 1, hidden)`."""
        rows, n_steps, _ = spikes.shape
        zero = spikes.new_zeros(rows, 1, self.fc_in.out_features)
        syn, mem, hidden_spikes = zero, zero, [zero] * self.late
        for k, arriving in enumerate(spikes.split(1, dim=1)[: n_steps - self.late]):
            current = self.fc_in(arriving)
            if isinstance(self.hidden, snntorch.RSynaptic):
                # The step of the recurrent spikes; step k + late is computed.
                back = k + self.late - max(1, self.late) - self.recurrent_delay
                spike, syn, mem = self.hidden(current, hidden_spikes[back] if back >= 0 else zero, syn, mem)
            else:
                spike, syn, mem = self.hidden(current, syn, mem)
            hidden_spikes.append(spike)
        return hidden_spikes[:n_steps]


def to_snntorch(source: Fitted | Network, *, time_first: bool = False) -> SnnTorchNetwork:
    """The same network in snnTorch's neurons, as a `torch.nn.Module` with its own copy of the weights.

    source: a network, a run folder that `train` wrote, or a fitted `SpikingClassifier` or a pipeline that ends in one.
    The module takes spikes `(trial, time, afferent)` and returns the spikes of the hidden layer `(trial, time, hidden)`
    and of the readout `(trial, time, class)`, from a state of zero; of an integrator, its value after each step.
    time_first: take and return `(time, trial, ...)`, as most of snnTorch's examples do.
    Raises InputError unless the network is float32, its reset is `zero` or `subtract`, its decays lie in [0, 1], and
    its thresholds do not adapt.
    `snntorch.export_nir.export_to_nir(net, torch.ones(1, 9, afferents), ignore_dims=[0, 1])` writes its layers if
    `spec.learn` is empty, without the delays of the wrapper; `nt.to_nir` writes all.
    In snnTorch a learned threshold also gets a gradient through a `subtract` reset; here no reset has a gradient.

    >>> net = RSNN(16, 8, hidden=20, sampling_rate_Hz=2000.0)
    >>> hidden, readout = to_snntorch(net, time_first=True)(torch.ones(10, 2, 16))
    >>> hidden.shape, readout.shape
    (torch.Size([10, 2, 20]), torch.Size([10, 2, 8]))
    """
    network = rsnn_of("snntorch", source if isinstance(source, Network) else fitted.restore(source).network)
    require("snntorch", Subject(None, network))
    _check_decays(network.alpha, network.beta)
    factors = network.beta.detach() if network.spec.membrane == "eq4" else torch.ones_like(network.beta)
    hidden = _hidden_neurons(network, factors[0])
    if network.bias is None:
        readout, fc_out = snntorch.Synaptic(**_dynamics(network, 1)), _linear(factors[1] * network.w_out)
        _forget(readout)
    else:
        readout, fc_out = None, _linear(network.w_out)
    _forget(hidden)
    late = 0 if network.spec.membrane == "immediate" else 2
    level, w_stretch = (
        None if value is None else nn.Parameter(value.detach().clone()) for value in (network.bias, network.w_stretch)
    )
    integration = network.integration
    exported = SnnTorchNetwork(
        _linear(factors[0] * network.w_in), hidden, fc_out, readout, late, network.spec.recurrent_delay_steps, level,
        network.readout_decay, integration is not None and integration.peak, time_first, network.steps_per_bin,
        network.stretches, w_stretch, network.spec.hears_afferents,
    )  # fmt: skip
    return exported.to(network.w_in.device)


def _dynamics(network: RSNN, layer: int) -> dict[str, Any]:
    """Arguments of a snnTorch neuron of the hidden layer (0) or of the readout (1)."""
    spike = network.spike_of(layer)
    slope = surrogate.fast_sigmoid(cast(int, spike.scale)) if isinstance(spike, FastSigmoid) else spike
    n_neurons = (network.spec.hidden, network.n_classes)[layer]
    # Learned parameters have one value per layer. The others have one per neuron: snnTorch's own export to NIR takes
    # the size of a layer from them.
    values = {name: getattr(network, name)[layer].detach().clone() for name in DYNAMICS}
    values = {name: value if name in network.spec.learn else value.repeat(n_neurons) for name, value in values.items()}
    learned = {f"learn_{name}": name in network.spec.learn for name in values}
    return {**values, **learned, "spike_grad": slope, "reset_mechanism": network.spec.reset}


def _hidden_neurons(network: RSNN, factor: Tensor) -> snntorch.RSynaptic | snntorch.Synaptic:
    """The hidden layer, its recurrent weights times `factor`."""
    if network.w_rec is None:
        return snntorch.Synaptic(**_dynamics(network, 0))
    # RSynaptic draws recurrent weights that are replaced: do not advance the global generator.
    with torch.random.fork_rng(devices=[]):
        hidden = snntorch.RSynaptic(linear_features=network.spec.hidden, **_dynamics(network, 0))
    recurrent = cast(nn.Linear, hidden.recurrent)
    recurrent.bias = None  # pyright: ignore[reportAttributeAccessIssue]
    recurrent.weight = nn.Parameter((factor * network.w_rec.detach()).t().contiguous())
    return hidden


class _Layers(NamedTuple):
    """The parts of an RSNN, as snnTorch's modules."""

    fc_in: nn.Linear
    hidden: Any
    recurrent: nn.Linear
    fc_out: nn.Linear
    readout: Any


def from_snntorch(
    parts: nn.Module | Sequence[nn.Module], sampling_rate_Hz: float, *, backend: Backend = "auto"
) -> RSNN:
    """The RSNN with a copy of the weights of snnTorch's layers.

    parts: Linear, RSynaptic, Linear, Synaptic in this order, or a module that contains them, assigned in this order.
    sampling_rate_Hz: the clock on which alpha and beta were chosen: snnTorch has none.

    Raises InputError for what neurotact's network does not have: a bias that is not zero, decays that differ from
    neuron to neuron or are outside [0, 1], another reset, inhibition, quantised states, graded spikes.
    Surrogates that are fast sigmoids become those of the spec; any other is used unchanged, by the reference.
    The spec's time constants are the hidden layer's; `alpha` and `beta` hold the exact values of both layers. If one
    layer learns a parameter, both layers learn it.

    >>> net = RSNN(16, 8, RSNNSpec(hidden=20, membrane="immediate"), sampling_rate_Hz=2000.0)
    >>> torch.equal(from_snntorch(to_snntorch(net), 2000.0).w_rec, net.w_rec)
    True
    """
    check_sampling_rate(sampling_rate_Hz, "from_snntorch")
    layers = _checked_layers(parts)
    alpha, beta, threshold = (
        torch.stack([_one(getattr(neuron, name), name) for neuron in (layers.hidden, layers.readout)])
        for name in DYNAMICS
    )
    _check_decays(alpha, beta)
    scales = _surrogate_scales(layers)
    table = {
        "hidden": layers.fc_in.out_features,
        "membrane": "immediate",
        "reset": layers.hidden.reset_mechanism,
        "tau_mem_ms": tau_ms(float(beta[0]), sampling_rate_Hz),
        "tau_syn_ms": tau_ms(float(alpha[0]), sampling_rate_Hz),
        "learn": [name for name in DYNAMICS if _learned(name, layers.hidden, layers.readout)],
        **scales,
    }
    spec = build(RSNNSpec, table, source="snnTorch network")
    sizes = layers.fc_in.in_features, layers.fc_out.out_features
    network = RSNN(*sizes, spec, sampling_rate_Hz, backend=backend, generator=torch.Generator())
    weights = (layer.weight.t() for layer in (layers.fc_in, layers.recurrent, layers.fc_out))
    names = ("w_in", "w_rec", "w_out", *DYNAMICS)
    values = (*weights, alpha, beta, threshold)
    network.load_state_dict({name: value.detach() for name, value in zip(names, values, strict=True)})
    if not scales:
        network.spike = layers.hidden.spike_grad
    return network.to(layers.fc_in.weight.device)


def _checked_layers(parts: nn.Module | Sequence[nn.Module]) -> _Layers:
    """The layers of a snnTorch network; InputError for what an RSNN does not have."""
    if isinstance(parts, SnnTorchNetwork) and (parts.late or parts.recurrent_delay):
        raise InputError("parts: these neurons receive input later than snnTorch's own; give an 'immediate' network")
    if isinstance(parts, SnnTorchNetwork) and parts.per_bin > 1:
        raise InputError("parts: this network puts spikes into bins first; give a network without step_ms")
    fc_in, hidden, fc_out, readout = _four(parts)
    recurrent = getattr(hidden, "recurrent", None)
    if not isinstance(recurrent, nn.Linear):
        raise InputError("hidden: its recurrence is not all-to-all over a vector; build it with linear_features")
    _check_projections(fc_in, recurrent, fc_out)
    for name, neuron in (("hidden", hidden), ("readout", readout)):
        _check_neuron(name, neuron)
    if hidden.reset_mechanism != readout.reset_mechanism:
        raise InputError("reset: the hidden layer and the readout reset differently; give both the same")
    return _Layers(fc_in, hidden, recurrent, fc_out, readout)


def _surrogate_scales(layers: _Layers) -> dict[str, float | None]:
    """The keys of the spec for fast sigmoids; none if both layers have one other surrogate."""
    scale, readout_scale = (_fast_sigmoid_scale(neuron.spike_grad) for neuron in (layers.hidden, layers.readout))
    if (scale is None) != (readout_scale is None):
        raise InputError(
            "spike_grad: the hidden layer and the readout have different surrogates, and only one is a fast sigmoid; "
            "give both the same"
        )
    scales: dict[str, float | None] = {} if scale is None else {"surrogate_scale": scale}
    return scales if scale == readout_scale else {**scales, "readout_surrogate_scale": readout_scale}


def _linear(weight: Tensor) -> nn.Linear:
    layer = nn.Linear(*weight.shape, bias=False, device="meta")
    layer.weight = nn.Parameter(weight.detach().t().contiguous())
    return layer


def _forget(*neurons: nn.Module) -> None:
    """Remove neurons from the class-level list in which snnTorch keeps every neuron."""
    listed = snntorch.SpikingNeuron.instances
    listed[:] = [neuron for neuron in listed if not any(neuron is mine for mine in neurons)]


def _four(
    parts: nn.Module | Sequence[nn.Module],
) -> tuple[nn.Linear, snntorch.RSynaptic, nn.Linear, snntorch.Synaptic]:
    four = list(_layers(parts)) if isinstance(parts, nn.Module) else list(parts)
    kinds = (nn.Linear, snntorch.RSynaptic, nn.Linear, snntorch.Synaptic)
    if len(four) != 4 or not all(type(part) is kind for part, kind in zip(four, kinds, strict=True)):
        names = ", ".join(type(part).__name__ for part in four) or "nothing"
        raise InputError(f"network: must be Linear, RSynaptic, Linear, Synaptic; found {names}")
    return tuple(four)  # pyright: ignore[reportReturnType]


def _layers(module: nn.Module) -> Iterator[nn.Module]:
    """The modules that compute, in order; a neuron's own recurrent projection belongs to it."""
    children = list(module.children())
    if isinstance(module, snntorch.SpikingNeuron) or not children:
        yield module
        return
    for child in children:
        yield from _layers(child)


def _check_projections(fc_in: nn.Linear, recurrent: nn.Linear, fc_out: nn.Linear) -> None:
    for name, linear in (("input", fc_in), ("recurrent", recurrent), ("readout", fc_out)):
        if linear.bias is not None and linear.bias.any():
            raise InputError(f"{name}: the projection has a bias that is not zero; train it with bias=False")
        if linear.weight.dtype != torch.float32:
            raise InputError(f"{name}: weights must be float32; got {linear.weight.dtype}")
    n_hidden = fc_in.out_features
    if (recurrent.in_features, recurrent.out_features, fc_out.in_features) != (n_hidden,) * 3:
        raise InputError(
            f"network: the input projection has {n_hidden} outputs, the recurrent one {recurrent.in_features} inputs "
            f"and {recurrent.out_features} outputs, the readout one {fc_out.in_features} inputs; all must be equal"
        )


def _check_neuron(name: str, neuron: snntorch.RSynaptic | snntorch.Synaptic) -> None:
    if neuron.reset_mechanism not in RESETS:
        raise InputError(f"{name}: reset '{neuron.reset_mechanism}' is unknown here; known: {', '.join(RESETS)}")
    unsupported = {
        "inhibition": neuron.inhibition,
        "state_quant": neuron.state_quant,
        "reset_delay=False": not neuron.reset_delay,
        "graded_spikes_factor": bool((neuron.graded_spikes_factor != 1).any()),
    }
    for setting, is_set in unsupported.items():
        if is_set:
            raise InputError(f"{name}: {setting} has no equivalent here; build the neuron without it")


def _check_decays(alpha: Tensor, beta: Tensor) -> None:
    for name, value in (("alpha", alpha), ("beta", beta)):
        if not ((value >= 0) & (value <= 1)).all():
            raise InputError(f"{name}: must lie in [0, 1], to which snnTorch clamps it; got {value.detach().tolist()}")


def _one(value: Tensor, name: str) -> Tensor:
    flat = value.detach().flatten().to(torch.float32)
    if flat.numel() == 0 or not torch.isfinite(flat).all() or (flat != flat[0]).any():
        raise InputError(f"{name}: must be one finite number per layer; got {value.detach().tolist()}")
    return flat[0]


def _learned(name: str, *neurons: nn.Module) -> bool:
    return any(isinstance(getattr(neuron, name), nn.Parameter) for neuron in neurons)


def tau_ms(decay: float, sampling_rate_Hz: float) -> float:
    """The time constant of a decay; for 0 and 1, one whose decay rounds to them."""
    steps = 1e-17 if decay >= 1 else 800.0 if decay <= 0 else -math.log(decay)
    return 1e3 / (steps * sampling_rate_Hz)


def _fast_sigmoid_scale(spike: Callable[[Tensor], Tensor]) -> float | None:
    """The scale of a surrogate, from its slopes, if it is a fast sigmoid; else None."""
    x = torch.tensor([-2.0, -0.3, 0.1, 1.0], dtype=torch.float64, requires_grad=True)
    with torch.enable_grad():
        total = spike(x).sum()
        if not total.requires_grad:
            return None
        (slope,) = torch.autograd.grad(total, x)
    if not (torch.isfinite(slope) & (slope > 0)).all():
        return None
    scales = (slope**-0.5 - 1) / x.detach().abs()
    scale = float(f"{scales[3]:.12g}")
    # A scale of 0 is the straight-through estimator.
    return scale if scale > 0 and torch.allclose(scales, scales[3].expand(4), rtol=1e-6, atol=0) else None
