"""The native kernels as autograd functions; what they compute is defined in `reference.py`.

Tensors go to the extension as addresses, checked here, because handing them over as objects costs more than a small
network's step.
"""

from functools import lru_cache
from typing import Any, Protocol, get_args

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from neurotact.errors import InputError
from neurotact.networks.early_exit import ExitRule
from neurotact.networks.kernels import native
from neurotact.networks.specs import RSNNSpec
from neurotact.neurons import CubaLIF, Decay, Membrane, Reset

_KINDS = {torch.uint8: 1, torch.bool: 1, torch.float32: 4, torch.float64: 8}
Weights = tuple[Tensor, Tensor | None, Tensor]
"""Into, among and out of the hidden neurons."""
_GRADED = (
    "spikes: hold values other than 0 and 1, which the native kernels do not take; "
    "use backend='reference' for graded input"
)


class Network(Protocol):
    """What the kernels need of a network, as `rsnn.RSNN` has it."""

    @property
    def spec(self) -> RSNNSpec: ...
    @property
    def neuron(self) -> CubaLIF: ...
    @property
    def w_in(self) -> Tensor: ...
    @property
    def w_rec(self) -> Tensor | None: ...
    @property
    def w_out(self) -> Tensor: ...
    @property
    def alpha(self) -> Tensor: ...
    @property
    def beta(self) -> Tensor: ...
    @property
    def threshold(self) -> Tensor: ...
    @property
    def n_inputs(self) -> int: ...
    @property
    def n_classes(self) -> int: ...


def rsnn_counts(spikes: Tensor, network: Network) -> tuple[Tensor, Tensor]:
    """Spike counts of a window, `(trial, class)` and `(trial, hidden)`, in the weights' float type.

    Differentiable in the three weights, in alpha, beta and threshold where they require it, and in the input spikes
    where they do. Those hold 0 and 1 only; InputError otherwise.
    """
    weights = _weights(network)
    dynamics = _same_kind(network.alpha, network.beta, network.threshold, like=network.w_in)
    spikes = _readable(spikes, network.w_in)
    learns = [t is not None and t.requires_grad for t in (*weights, *dynamics, spikes)]
    training = torch.is_grad_enabled() and any(learns)
    shape = _shape(
        network.n_inputs, network.spec.hidden, network.n_classes, network.neuron, network.spec.surrogate_scale,
        recurrent=network.spec.recurrent, per_neuron=False,
        keep_currents=training and any(learns[3:6]), with_inputs=training and learns[6],
    )  # fmt: skip
    if training:
        return _Counts.apply(spikes, *weights, *dynamics, shape)  # pyright: ignore[reportReturnType]
    return _counts(spikes, weights, dynamics, shape, tape=None)


def _counts(
    spikes: Tensor, weights: Weights, dynamics: tuple[Tensor, ...], shape: Any, tape: Tensor | None
) -> tuple[Tensor, Tensor]:
    w_in, w_rec, w_out = weights
    alpha, beta, threshold = dynamics
    n_trials, n_steps, _ = spikes.shape
    readout, hidden = w_out.new_empty(n_trials, w_out.shape[1]), w_in.new_empty(n_trials, w_in.shape[1])
    binary = native.forward(
        shape, w_in.dtype is torch.float64, n_trials, n_steps,
        spikes.data_ptr(), _KINDS[spikes.dtype], spikes.stride(0), spikes.stride(1),
        w_in.data_ptr(), _at(w_rec), w_out.data_ptr(),
        alpha.data_ptr(), beta.data_ptr(), threshold.data_ptr(),
        0 if tape is None else tape.data_ptr(), readout.data_ptr(), hidden.data_ptr(), 0, torch.get_num_threads(),
    )  # fmt: skip
    if not binary:
        raise InputError(_GRADED)
    return readout, hidden


class _Counts(torch.autograd.Function):
    @staticmethod
    def forward(ctx, spikes, w_in, w_rec, w_out, alpha, beta, threshold, shape):  # pyright: ignore
        n_trials, n_steps, _ = spikes.shape
        # Saved as a tensor, so that autograd gives the memory back to the pool the moment backward is through.
        tape = native.new_tape(shape, w_in.dtype is torch.float64, n_trials, n_steps)
        readout, hidden = _counts(spikes, (w_in, w_rec, w_out), (alpha, beta, threshold), shape, tape)
        ctx.save_for_backward(tape, w_in, w_rec, w_out, alpha, beta, threshold)
        ctx.shape, ctx.window = shape, (n_trials, n_steps)
        ctx.set_materialize_grads(False)
        return readout, hidden

    @staticmethod
    @once_differentiable
    def backward(ctx, g_readout, g_hidden):  # pyright: ignore[reportIncompatibleMethodOverride]
        tape, w_in, w_rec, w_out, alpha, beta, threshold = ctx.saved_tensors
        n_trials, n_steps = ctx.window
        g_in, g_out = torch.empty_like(w_in), torch.empty_like(w_out)
        g_rec = None if w_rec is None else torch.empty_like(w_rec)
        learned = any(ctx.needs_input_grad[4:7])
        n_hidden, n_classes = w_out.shape
        g_spikes = w_in.new_empty(n_trials, n_steps, w_in.shape[0]) if ctx.needs_input_grad[0] else None
        g_dynamics = w_in.new_empty(3 * (n_hidden + n_classes)) if learned else None
        g_readout, g_hidden = _dense(g_readout), _dense(g_hidden)
        native.backward(
            ctx.shape, w_in.dtype is torch.float64, n_trials, n_steps, tape.data_ptr(),
            w_in.data_ptr(), _at(w_rec), w_out.data_ptr(),
            alpha.data_ptr(), beta.data_ptr(), threshold.data_ptr(),
            _at(g_readout), _at(g_hidden), 0, g_in.data_ptr(), _at(g_rec), g_out.data_ptr(),
            _at(g_spikes), _at(g_dynamics), torch.get_num_threads(),
        )  # fmt: skip
        if g_dynamics is None:
            return g_spikes, g_in, g_rec, g_out, None, None, None, None
        hidden, readout = g_dynamics[: 3 * n_hidden].view(3, -1), g_dynamics[3 * n_hidden :].view(3, -1)
        g_alpha, g_beta, g_threshold = torch.stack([hidden.sum(dim=1), readout.sum(dim=1)], dim=1)
        return g_spikes, g_in, g_rec, g_out, g_alpha, g_beta, g_threshold, None


def rsnn_infer(spikes: Tensor, network: Network, rule: ExitRule) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """Labels, steps, input spikes, hidden spikes and readout spikes of each trial, as `rsnn.Inference` says.

    A trial stops where `rule` says so; memory does not grow with the window.
    """
    w_in, w_rec, w_out = _weights(network)
    if w_rec is None:  # the kernel that infers reads recurrent weights; without recurrence they add nothing
        w_rec = w_in.new_zeros(network.spec.hidden, network.spec.hidden)
    alpha, beta, threshold = _same_kind(network.alpha, network.beta, network.threshold, like=network.w_in)
    spikes = _readable(spikes, w_in)
    n_trials, n_steps, _ = spikes.shape
    shape = _shape(
        network.n_inputs, network.spec.hidden, network.n_classes, network.neuron, network.spec.surrogate_scale,
        recurrent=True, per_neuron=False, keep_currents=False, with_inputs=False,
    )  # fmt: skip
    labels, steps, input_spikes, hidden_spikes = torch.empty(4, n_trials, dtype=torch.int64).unbind()
    readout = torch.empty(n_trials, network.n_classes, dtype=torch.int64)
    binary = native.infer(
        shape, w_in.dtype is torch.float64, n_trials, n_steps,
        spikes.data_ptr(), _KINDS[spikes.dtype], spikes.stride(0), spikes.stride(1),
        w_in.data_ptr(), w_rec.data_ptr(), w_out.data_ptr(),
        alpha.data_ptr(), beta.data_ptr(), threshold.data_ptr(),
        -1 if rule.patience is None else rule.patience, rule.from_first_spike,
        labels.data_ptr(), steps.data_ptr(), input_spikes.data_ptr(), hidden_spikes.data_ptr(), readout.data_ptr(),
        torch.get_num_threads(),
    )  # fmt: skip
    if not binary:
        raise InputError(_GRADED)
    return labels, steps, input_spikes, hidden_spikes, readout


def layer_spikes(
    x: Tensor, w: Tensor, v: Tensor | None, alpha: Decay, beta: Decay, threshold: Decay, neuron: CubaLIF, scale: float
) -> Tensor:
    """Spikes of one layer, `(trial, time, postsynaptic)`, in the weights' float type; see `layer.cuba_lif_layer`."""
    x, weights, dynamics, shape, training = _prepared(x, w, v, alpha, beta, threshold, neuron, scale)
    if training:
        return _Layer.apply(x, *weights, *dynamics, shape, False)  # pyright: ignore[reportReturnType]
    return _layer(x, *weights, dynamics, shape, tape=None, counted=False)


def layer_counts(
    x: Tensor, w: Tensor, v: Tensor | None, alpha: Decay, beta: Decay, threshold: Decay, neuron: CubaLIF, scale: float
) -> Tensor:
    """Spike counts of one layer over the window, `(trial, postsynaptic)`; otherwise as `layer_spikes`."""
    x, weights, dynamics, shape, training = _prepared(x, w, v, alpha, beta, threshold, neuron, scale)
    if training:
        return _Layer.apply(x, *weights, *dynamics, shape, True)  # pyright: ignore[reportReturnType]
    return _layer(x, *weights, dynamics, shape, tape=None, counted=True)


def _prepared(
    x: Tensor, w: Tensor, v: Tensor | None, alpha: Decay, beta: Decay, threshold: Decay, neuron: CubaLIF, scale: float
) -> tuple[Tensor, tuple[Tensor, Tensor | None], tuple[Tensor, ...], Any, bool]:
    """Spikes, weights and dynamics as the kernels read them, the layer's shape, and whether a gradient is wanted."""
    weights = _same_kind(w) if v is None else _same_kind(w, v)
    dynamics = tuple(
        # Autograd adds the gradients of the neurons that share a value.
        torch.as_tensor(value, dtype=w.dtype, device=w.device).reshape(-1).expand(w.shape[1]).contiguous()
        for value in (alpha, beta, threshold)
    )
    x = _readable(x, w)
    learns = [t.requires_grad for t in (x, *dynamics)]
    training = torch.is_grad_enabled() and (any(learns) or any(t.requires_grad for t in weights))
    shape = _shape(
        w.shape[0], w.shape[1], 0, neuron, scale, recurrent=v is not None, per_neuron=True,
        keep_currents=training and any(learns[1:]), with_inputs=training and learns[0],
    )  # fmt: skip
    return x, (weights[0], weights[1] if len(weights) == 2 else None), dynamics, shape, training


def _layer(
    x: Tensor, w: Tensor, v: Tensor | None, dynamics: tuple[Tensor, ...], shape: Any, tape: Tensor | None, counted: bool
) -> Tensor:
    """The raster of a layer or, where they are `counted`, its spikes per window."""
    alpha, beta, threshold = dynamics
    n_trials, n_steps, _ = x.shape
    sent = w.new_empty(n_trials, w.shape[1]) if counted else w.new_empty(n_trials, n_steps, w.shape[1])
    hidden, raster = (sent.data_ptr(), 0) if counted else (0, sent.data_ptr())
    binary = native.forward(
        shape, w.dtype is torch.float64, n_trials, n_steps,
        x.data_ptr(), _KINDS[x.dtype], x.stride(0), x.stride(1), w.data_ptr(), _at(v), 0,
        alpha.data_ptr(), beta.data_ptr(), threshold.data_ptr(),
        _at(tape), 0, hidden, raster, torch.get_num_threads(),
    )  # fmt: skip
    if not binary:
        raise InputError(_GRADED)
    return sent


class _Layer(torch.autograd.Function):
    @staticmethod
    def forward(ctx, x, w, v, alpha, beta, threshold, shape, counted):  # pyright: ignore
        n_trials, n_steps, _ = x.shape
        tape = native.new_tape(shape, w.dtype is torch.float64, n_trials, n_steps)
        sent = _layer(x, w, v, (alpha, beta, threshold), shape, tape, counted)
        ctx.save_for_backward(tape, w, v, alpha, beta, threshold)
        ctx.shape, ctx.window, ctx.counted = shape, (n_trials, n_steps), counted
        return sent

    @staticmethod
    @once_differentiable
    def backward(ctx, g_sent):  # pyright: ignore[reportIncompatibleMethodOverride]
        tape, w, v, alpha, beta, threshold = ctx.saved_tensors
        n_trials, n_steps = ctx.window
        g_w, g_v = torch.empty_like(w), None if v is None else torch.empty_like(v)
        g_x = w.new_empty(n_trials, n_steps, w.shape[0]) if ctx.needs_input_grad[0] else None
        g_dynamics = w.new_empty(3, w.shape[1]) if any(ctx.needs_input_grad[3:6]) else None
        g_sent = g_sent.contiguous()
        g_hidden, g_raster = (g_sent.data_ptr(), 0) if ctx.counted else (0, g_sent.data_ptr())
        native.backward(
            ctx.shape, w.dtype is torch.float64, n_trials, n_steps, tape.data_ptr(),
            w.data_ptr(), _at(v), 0, alpha.data_ptr(), beta.data_ptr(), threshold.data_ptr(),
            0, g_hidden, g_raster, g_w.data_ptr(), _at(g_v), 0, _at(g_x), _at(g_dynamics), torch.get_num_threads(),
        )  # fmt: skip
        return g_x, g_w, g_v, *((None,) * 3 if g_dynamics is None else g_dynamics), None, None


def set_isa(name: str) -> None:
    """Use the kernels compiled for `plain`, `avx2` or `avx512`, for tests; the widest one is the default."""
    native.set_isa(name)


def isas() -> tuple[str, ...]:
    """The instruction sets that this processor has, narrowest first."""
    known = ("plain", "avx2", "avx512")
    return known[: known.index(native.widest_isa()) + 1]


@lru_cache(maxsize=256)
def _shape(
    n_inputs: int, n_hidden: int, n_classes: int, neuron: CubaLIF, scale: float,
    *, recurrent: bool, per_neuron: bool, keep_currents: bool, with_inputs: bool,
) -> Any:  # fmt: skip
    return native.make_shape(
        n_inputs, n_hidden, n_classes, get_args(Membrane).index(neuron.membrane), get_args(Reset).index(neuron.reset),
        neuron.recurrent_delay_steps, scale, recurrent, per_neuron, keep_currents, with_inputs,
    )  # fmt: skip


def _readable(spikes: Tensor, like: Tensor) -> Tensor:
    """Spikes of a type that the kernels read, on the CPU, neighbouring neurons side by side."""
    if spikes.device.type != "cpu":
        raise InputError(f"spikes: lie on {spikes.device} while the weights lie on the CPU; move one of them")
    if spikes.dtype not in _KINDS:
        spikes = spikes.to(like.dtype)
    return spikes if spikes.stride(2) == 1 else spikes.contiguous()


def _weights(network: Network) -> Weights:
    """The three projections; none among the hidden neurons of a feed-forward network."""
    if network.w_rec is None:
        w_in, w_out = _same_kind(network.w_in, network.w_out)
        return w_in, None, w_out
    w_in, w_rec, w_out = _same_kind(network.w_in, network.w_rec, network.w_out)
    return w_in, w_rec, w_out


def _same_kind(*tensors: Tensor, like: Tensor | None = None) -> tuple[Tensor, ...]:
    """The tensors without gaps, all of one float type on the CPU."""
    like = tensors[0] if like is None else like
    for tensor in tensors:
        if tensor.dtype != like.dtype or tensor.device != like.device:
            raise InputError(f"weights: are {tensor.dtype} on {tensor.device} beside {like.dtype} on {like.device}")
    return tuple(tensor if tensor.is_contiguous() else tensor.contiguous() for tensor in tensors)


def _dense(grad: Tensor | None) -> Tensor | None:
    return None if grad is None else grad.contiguous()


def _at(tensor: Tensor | None) -> int:
    return 0 if tensor is None else tensor.data_ptr()
