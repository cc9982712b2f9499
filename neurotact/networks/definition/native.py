"""The native kernels as autograd functions; what they compute is defined in `reference.py`.

Tensors are passed to the extension as named addresses, which are checked here (`_at`): passing them as objects costs
more than a small network's step.
"""

from functools import lru_cache
from typing import Any, Protocol, get_args

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from neurotact import backend
from neurotact.backend import Backend, n_threads, native
from neurotact.errors import InputError
from neurotact.networks.definition.readouts import Integration, Stretches
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.networks.exit.rule import ExitRule
from neurotact.neurons import Adaptation, CubaLIF, Decay, Membrane, Reset

_KINDS = {torch.uint8: 1, torch.bool: 1, torch.float32: 4, torch.float64: 8}
Weights = tuple[Tensor, Tensor | None, Tensor | None]
"""Input, recurrent and readout weights; a single layer has no readout."""
_GRADED = (
    "spikes: hold values other than 0 and 1, which the native kernels do not take; "
    "use backend='reference' for graded input"
)


class Network(Protocol):
    """What the kernels require of a network, such as `rsnn.RSNN`."""

    @property
    def spec(self) -> RSNNSpec: ...
    @property
    def neuron(self) -> CubaLIF: ...
    @property
    def adaptation(self) -> Adaptation | None: ...
    @property
    def steps_per_bin(self) -> int: ...
    @property
    def w_in(self) -> Tensor: ...
    @property
    def w_rec(self) -> Tensor | None: ...
    @property
    def w_out(self) -> Tensor: ...
    @property
    def readout_weights(self) -> Tensor: ...
    @property
    def stretches(self) -> Stretches | None: ...
    @property
    def alpha(self) -> Tensor: ...
    @property
    def beta(self) -> Tensor: ...
    @property
    def threshold(self) -> Tensor: ...
    @property
    def n_classes(self) -> int: ...
    @property
    def integration(self) -> Integration | None: ...


def rsnn_counts(spikes: Tensor, network: Network, w_out: Tensor | None = None) -> tuple[Tensor, Tensor]:
    """Spike counts of a window, `(trial, class)` and `(trial, hidden)`, in the weights' float type.

    For a readout that leaks, the first are its values without the bias. w_out: replaces the network's own.

    Differentiable in the three weights, and in alpha, beta, threshold and the input spikes if these require a gradient.
    Raises InputError for input spikes other than 0 and 1.
    """
    weights = _weights(network, w_out)
    dynamics = _same_kind(network.alpha, network.beta, network.threshold, like=network.w_in)
    spikes = _readable(spikes, network.w_in)
    learns = [t is not None and t.requires_grad for t in (*weights, *dynamics, spikes)]
    training = torch.is_grad_enabled() and any(learns)
    shape = _shape_of(network, keep_currents=training and any(learns[3:6]), with_inputs=training and learns[6])
    if training:
        return _Counts.apply(spikes, *weights, *dynamics, shape)  # pyright: ignore[reportReturnType]
    return _counts(spikes, weights, dynamics, shape, tape=None)


def _counts(
    spikes: Tensor, weights: Weights, dynamics: tuple[Tensor, ...], shape: Any, tape: Tensor | None
) -> tuple[Tensor, Tensor]:
    w_in, _, w_out = weights
    assert w_out is not None  # only a single layer has no readout, and `_layer` runs it
    n_trials = spikes.shape[0]
    readout, hidden = w_out.new_empty(n_trials, w_out.shape[1]), w_in.new_empty(n_trials, w_in.shape[1])
    _forward(spikes, weights, dynamics, shape, tape, readout=readout.data_ptr(), hidden=hidden.data_ptr(), raster=0)
    return readout, hidden


class _Counts(torch.autograd.Function):
    @staticmethod
    def forward(ctx, spikes, w_in, w_rec, w_out, alpha, beta, threshold, shape):  # pyright: ignore
        n_trials, n_steps, _ = spikes.shape
        # Saved as a tensor: autograd returns its memory to the pool as soon as backward ends.
        tape = native.new_tape(shape, trials=n_trials, steps=n_steps)
        readout, hidden = _counts(spikes, (w_in, w_rec, w_out), (alpha, beta, threshold), shape, tape)
        ctx.save_for_backward(tape, w_in, w_rec, w_out, alpha, beta, threshold)
        ctx.shape, ctx.window = shape, (n_trials, n_steps)
        ctx.set_materialize_grads(False)
        return readout, hidden

    @staticmethod
    @once_differentiable
    def backward(ctx, g_readout, g_hidden):  # pyright: ignore[reportIncompatibleMethodOverride]
        tape, w_in, w_rec, w_out, *dynamics = ctx.saved_tensors
        n_trials, _ = ctx.window
        n_hidden, n_classes = w_out.shape
        g_out = torch.empty_like(w_out)
        g_readout, g_hidden = _dense(g_readout), _dense(g_hidden)  # kept alive here: an address keeps no tensor
        g_dynamics = w_in.new_empty(3 * (n_hidden + n_classes)) if any(ctx.needs_input_grad[4:7]) else None
        g_spikes, g_in, g_rec = _backward(
            ctx, tape, (w_in, w_rec, w_out), tuple(dynamics),
            g_readout=_at(g_readout, n_trials, n_classes), g_hidden=_at(g_hidden, n_trials, n_hidden),
            g_raster=0, g_w_out=g_out.data_ptr(), g_dynamics=_at(g_dynamics),
        )  # fmt: skip
        if g_dynamics is None:
            return g_spikes, g_in, g_rec, g_out, None, None, None, None
        hidden, readout = g_dynamics[: 3 * n_hidden].view(3, -1), g_dynamics[3 * n_hidden :].view(3, -1)
        g_alpha, g_beta, g_threshold = torch.stack([hidden.sum(dim=1), readout.sum(dim=1)], dim=1)
        return g_spikes, g_in, g_rec, g_out, g_alpha, g_beta, g_threshold, None


def _forward(
    spikes: Tensor, weights: Weights, dynamics: tuple[Tensor, ...], shape: Any, tape: Tensor | None, **outputs: int
) -> None:
    """Run a window; `outputs` are addresses."""
    n_trials, n_steps, _ = spikes.shape
    window = {"trials": n_trials, "steps": n_steps}
    binary = native.forward(
        shape, **window, **_spikes_at(spikes, weights), **_parameters(weights, dynamics),
        tape=0 if tape is None else _at(tape, native.tape_bytes(shape, **window)),
        **outputs, threads=n_threads(n_trials * weights[0].shape[1]),
    )  # fmt: skip
    if not binary:
        raise InputError(_GRADED)


def _backward(
    ctx: Any, tape: Tensor, weights: Weights, dynamics: tuple[Tensor, ...], **gradients: int
) -> tuple[Tensor | None, Tensor, Tensor | None]:
    """dL/d of the spikes (if required), w_in and w_rec; `gradients` are the addresses of the others."""
    w_in, w_rec, _ = weights
    n_trials, n_steps = ctx.window
    window = {"trials": n_trials, "steps": n_steps}
    g_in, g_rec = torch.empty_like(w_in), None if w_rec is None else torch.empty_like(w_rec)
    g_spikes = w_in.new_empty(n_trials, n_steps, w_in.shape[0]) if ctx.needs_input_grad[0] else None
    native.backward(
        ctx.shape, **window, **_parameters(weights, dynamics), tape=_at(tape, native.tape_bytes(ctx.shape, **window)),
        **gradients, g_w_in=g_in.data_ptr(), g_w_rec=_at(g_rec), g_spikes=_at(g_spikes),
        threads=n_threads(n_trials * w_in.shape[1]),
    )  # fmt: skip
    return g_spikes, g_in, g_rec


def rsnn_infer(spikes: Tensor, network: Network, rule: ExitRule) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """Labels, steps, input spikes, hidden spikes and readout of each trial, as in `rsnn.Inference`.

    A trial stops where `rule` says so; memory does not grow with the window.
    """
    weights = _weights(network, network.readout_weights)
    dynamics = _same_kind(network.alpha, network.beta, network.threshold, like=network.w_in)
    spikes = _readable(spikes, weights[0])
    n_trials, n_steps, _ = spikes.shape
    n_classes, integration = network.n_classes, network.integration
    level = None if integration is None else integration.level
    labels, steps, input_spikes, hidden_spikes = torch.empty(4, n_trials, dtype=torch.int64).unbind()
    readout = torch.empty(n_trials, n_classes, dtype=torch.int64 if level is None else torch.float64)
    integrates = level is not None
    binary = native.infer(
        _shape_of(network, keep_currents=False, with_inputs=False), trials=n_trials, steps=n_steps,
        **_spikes_at(spikes, weights), **_parameters(weights, dynamics, network.spec), bias=_at(level, n_classes),
        **exits_at(rule),
        labels=labels.data_ptr(), steps_run=steps.data_ptr(),
        input_spikes=input_spikes.data_ptr(), hidden_spikes=hidden_spikes.data_ptr(),
        counts=0 if integrates else readout.data_ptr(), sums=readout.data_ptr() if integrates else 0,
        threads=n_threads(n_trials * weights[0].shape[1]),
    )  # fmt: skip
    if not binary:
        raise InputError(_GRADED)
    return labels, steps, input_spikes, hidden_spikes, readout


def layer(
    x: Tensor,
    w: Tensor,
    v: Tensor | None,
    alpha: Decay,
    beta: Decay,
    threshold: Decay,
    neuron: CubaLIF,
    scale: float,
    adaptation: Adaptation | None = None,
    *,
    counted: bool = False,
    stretches: Stretches | None = None,
) -> Tensor:
    """Spikes of one layer, `(trial, time, postsynaptic)`, in the float type of the weights.

    Arguments are those of `reference.cuba_lif_layer`.

    counted: their counts over the window instead, `(trial, postsynaptic)`, or with `stretches` over each of them,
        `(trial, K, postsynaptic)`.
    """
    values = (alpha, beta, threshold)
    w, *rest = _same_kind(w) if v is None else _same_kind(w, v)
    v = rest[0] if rest else None
    dynamics = tuple(torch.as_tensor(value, dtype=w.dtype, device=w.device).reshape(-1) for value in values)
    per_neuron = any(len(value) > 1 for value in dynamics)
    # Autograd adds the gradients of the neurons that share a value.
    dynamics = tuple(value.expand(w.shape[1] if per_neuron else 1).contiguous() for value in dynamics)
    x = _readable(x, w)
    learns = [t.requires_grad for t in (x, *dynamics)]
    training = torch.is_grad_enabled() and (any(learns) or any(t.requires_grad for t in (w, *rest)))
    shape = _shape(
        w.shape[0], w.shape[1], 0, neuron, adaptation, scale, scale, is_double=w.dtype is torch.float64,
        recurrent=v is not None,
        per_neuron=per_neuron, keep_currents=training and any(learns[1:]), with_inputs=training and learns[0],
        with_raster=not counted, stretches=stretches,
    )  # fmt: skip
    size = (x.shape[1] if not counted else 1 if stretches is None else stretches.number, w.shape[1])
    if training:
        output = _Layer.apply(x, w, v, *dynamics, shape, size, counted)
    else:
        output = _layer(x, (w, v, None), dynamics, shape, size, None, counted)
    return output.squeeze(1) if counted and stretches is None else output  # pyright: ignore[reportAttributeAccessIssue]


def _layer(
    x: Tensor, weights: Weights, dynamics: tuple[Tensor, ...], shape: Any, size: tuple[int, int],
    tape: Tensor | None, counted: bool,
) -> Tensor:  # fmt: skip
    """size: of the output for a trial: steps or stretches, and neurons."""
    output = (weights[0].new_zeros if counted else weights[0].new_empty)(len(x), *size)
    hidden, raster = (output.data_ptr(), 0) if counted else (0, output.data_ptr())
    _forward(x, weights, dynamics, shape, tape, readout=0, hidden=hidden, raster=raster)
    return output


class _Layer(torch.autograd.Function):
    @staticmethod
    def forward(ctx, x, w, v, alpha, beta, threshold, shape, size, counted):  # pyright: ignore
        n_trials, n_steps, _ = x.shape
        tape = native.new_tape(shape, trials=n_trials, steps=n_steps)
        output = _layer(x, (w, v, None), (alpha, beta, threshold), shape, size, tape, counted)
        ctx.save_for_backward(tape, w, v, alpha, beta, threshold)
        ctx.shape, ctx.window, ctx.size, ctx.counted = shape, (n_trials, n_steps), size, counted
        return output

    @staticmethod
    @once_differentiable
    def backward(ctx, g_output):  # pyright: ignore[reportIncompatibleMethodOverride]
        tape, w, v, *dynamics = ctx.saved_tensors
        n_hidden = w.shape[1]
        g_dynamics = w.new_empty(3, n_hidden) if any(ctx.needs_input_grad[3:6]) else None
        g_output = g_output.contiguous()
        address = _at(g_output, ctx.window[0], *ctx.size)
        g_hidden, g_raster = (address, 0) if ctx.counted else (0, address)
        g_x, g_w, g_v = _backward(
            ctx, tape, (w, v, None), tuple(dynamics),
            g_readout=0, g_hidden=g_hidden, g_raster=g_raster, g_w_out=0, g_dynamics=_at(g_dynamics),
        )  # fmt: skip
        if g_dynamics is None:
            return g_x, g_w, g_v, None, None, None, None, None, None
        if len(dynamics[0]) < n_hidden:  # all neurons share a value
            g_dynamics = g_dynamics.sum(dim=1, keepdim=True)
        return g_x, g_w, g_v, *g_dynamics, None, None, None


def set_isa(name: str) -> None:
    """Use the kernels compiled for `plain`, `avx2` or `avx512`, for tests; the default is the widest one."""
    native.set_isa(name)


def isas() -> tuple[str, ...]:
    """The instruction sets that this processor has, narrowest first."""
    known = ("plain", "avx2", "avx512")
    return known[: known.index(native.widest_isa()) + 1]


def _shape_of(network: Network, *, keep_currents: bool, with_inputs: bool) -> Any:
    spec = network.spec
    readout = network.integration
    decay, peak = (None, False) if readout is None or not readout.leaks else (readout.decay, readout.peak)
    return _shape(
        *network.w_in.shape, network.n_classes, network.neuron, network.adaptation,
        spec.surrogate_scale, spec.readout_surrogate_scale or spec.surrogate_scale, decay, peak,
        is_double=network.w_in.dtype is torch.float64, recurrent=network.w_rec is not None, per_neuron=False,
        keep_currents=keep_currents, with_inputs=with_inputs, with_raster=False,
        stretches=network.stretches, direct=spec.hears_afferents,
    )  # fmt: skip


def exits_at(rule: ExitRule) -> dict[str, Any]:
    """An exit rule as arguments of the kernels."""
    return {"patience": -1 if rule.patience is None else rule.patience, "from_first_spike": rule.from_first_spike}


def shape_of(network: Network) -> Any:
    """The shape of a network that only infers."""
    return _shape_of(network, keep_currents=False, with_inputs=False)


def addresses_of(network: Network, readout_weights: Tensor) -> dict[str, int]:
    """Addresses of weights and dynamics, valid while the network and its `readout_weights` exist and do not change."""
    dynamics = (network.alpha.detach(), network.beta.detach(), network.threshold.detach())
    return _parameters(_weights(network, readout_weights), dynamics, network.spec)


@lru_cache(maxsize=256)
def _shape(
    n_inputs: int,
    n_hidden: int,
    n_classes: int,
    neuron: CubaLIF,
    adaptation: Adaptation | None,
    scale: float,
    readout_scale: float,
    decay: float | None = None,
    peak: bool = False,
    stretches: Stretches | None = None,
    **more: bool,
) -> Any:
    return native.make_shape(
        inputs=n_inputs, hidden=n_hidden, classes=n_classes,
        membrane=get_args(Membrane).index(neuron.membrane), reset=get_args(Reset).index(neuron.reset),
        recurrent_delay=neuron.recurrent_delay_steps,
        adaptation=0.0 if adaptation is None else float(adaptation.strength),
        adaptation_decay=0.0 if adaptation is None else float(adaptation.decay),
        scale=scale, readout_scale=readout_scale,
        leaks=decay is not None, peak=peak, decay=1.0 if decay is None else decay,
        stretches=1 if stretches is None else stretches.number,
        stretch_steps=1 if stretches is None else stretches.steps, **more,
    )  # fmt: skip


def _spikes_at(spikes: Tensor, weights: Weights) -> dict[str, int]:
    if spikes.shape[2] != weights[0].shape[0]:
        raise InputError(f"spikes: have {spikes.shape[2]} neurons where the weights have {weights[0].shape[0]}")
    return {
        "spikes": spikes.data_ptr(), "spike_kind": _KINDS[spikes.dtype],
        "trial_stride": spikes.stride(0), "time_stride": spikes.stride(1),
    }  # fmt: skip


def _parameters(weights: Weights, dynamics: tuple[Tensor, ...], spec: RSNNSpec | None = None) -> dict[str, int]:
    """Addresses of weights and dynamics; shapes are checked against `w_in` and `w_out`.

    spec: of a network whose readout may hear the afferents, too; None: it hears the hidden neurons alone.
    """
    w_in, w_rec, w_out = weights
    n_inputs, n_hidden = w_in.shape
    n_heard = n_hidden if spec is None else spec.heard(n_inputs)
    # A network has one value per layer; a single layer has one for all its neurons, or one per neuron.
    n_values = 2 if w_out is not None else 1 if len(dynamics[0]) == 1 else n_hidden
    alpha, beta, threshold = (_at(values, n_values) for values in dynamics)
    return {
        "w_in": _at(w_in, n_inputs, n_hidden), "w_rec": _at(w_rec, n_hidden, n_hidden),
        "w_out": 0 if w_out is None else _at(w_out, *w_out.shape[:-2], n_heard, w_out.shape[-1]),
        "alpha": alpha, "beta": beta, "threshold": threshold,
    }  # fmt: skip


def _readable(spikes: Tensor, like: Tensor) -> Tensor:
    """Spikes of a type that the kernels read, on the CPU, contiguous over neurons."""
    if spikes.device.type != "cpu":
        raise InputError(f"spikes: are on {spikes.device} but the weights are on the CPU; move one of them")
    if spikes.dtype not in _KINDS:
        spikes = spikes.to(like.dtype)
    return spikes if spikes.stride(2) == 1 else spikes.contiguous()


def _weights(network: Network, w_out: Tensor | None = None) -> Weights:
    """The three projections, with another `w_out` if given; a feed-forward network has no recurrent one."""
    w_out = network.w_out if w_out is None else w_out
    if network.w_rec is None:
        w_in, w_out = _same_kind(network.w_in, w_out)
        return w_in, None, w_out
    w_in, w_rec, w_out = _same_kind(network.w_in, network.w_rec, w_out)
    return w_in, w_rec, w_out


def _same_kind(*tensors: Tensor, like: Tensor | None = None) -> tuple[Tensor, ...]:
    """The tensors, contiguous; InputError unless all have one float type on one device."""
    like = tensors[0] if like is None else like
    for tensor in tensors:
        if tensor.dtype != like.dtype or tensor.device != like.device:
            raise InputError(f"weights: are {tensor.dtype} on {tensor.device} and {like.dtype} on {like.device}")
    return tuple(tensor if tensor.is_contiguous() else tensor.contiguous() for tensor in tensors)


def _dense(grad: Tensor | None) -> Tensor | None:
    return None if grad is None else grad.contiguous()


def _at(tensor: Tensor | None, *shape: int) -> int:
    """The address of a contiguous tensor, 0 for None; InputError unless it has the shape that the kernels expect."""
    if tensor is None:
        return 0
    if shape and tensor.shape != shape:
        raise InputError(f"weights: have shape {tuple(tensor.shape)} where {shape} is expected")
    return tensor.data_ptr()


def use_native(chosen: Backend, like: torch.Tensor) -> bool:
    """Whether the compiled kernels run for weights like `like`: on the CPU, in float32 or float64."""
    applies = like.device.type == "cpu" and like.dtype in (torch.float32, torch.float64)
    return backend.use_native(chosen, applies, "weights on the CPU in float32 or float64")


def device_of(name: str) -> torch.device:
    """The torch device of this name; InputError if torch cannot use it."""
    try:
        torch.zeros(1, device=name).item()
        return torch.device(name)
    except (RuntimeError, AssertionError, TypeError) as error:
        why = str(error).splitlines()[0]
        raise InputError(f"`device={name!r}`: torch cannot use it here ({why}); try cpu") from error
