"""One layer of current-based LIF neurons, to build deeper networks from; native if possible, else the reference."""

from torch import Tensor

from neurotact.errors import InputError
from neurotact.networks.definition import kernels, native, reference
from neurotact.networks.definition.kernels import Backend
from neurotact.networks.definition.surrogate import FastSigmoid
from neurotact.neurons import Adaptation, CubaLIF, Decay


def cuba_lif_layer(
    x: Tensor,
    w: Tensor,
    v: Tensor | None = None,
    *,
    alpha: Decay,
    beta: Decay,
    threshold: Decay = 1.0,
    neuron: CubaLIF = CubaLIF(),
    adaptation: Adaptation | None = None,
    surrogate_scale: float = 10.0,
    backend: Backend = "auto",
) -> Tensor:
    """Spikes `(trial, time, postsynaptic)` of a layer over a window (texture paper, Eqs. 4 to 7).

    x: spikes into the layer, `(trial, time, presynaptic)`, 0 and 1 (`backend="reference"` takes any value).
    w: weights `(presynaptic, postsynaptic)`, float32 or float64.
    v: recurrent weights `(postsynaptic, postsynaptic)`; None: no recurrence.
    alpha, beta, threshold: synaptic and membrane decay per step, and the threshold; one value, or one per neuron.
    neuron: membrane, reset and recurrent delay. adaptation: of the thresholds; None: they are fixed.

    Differentiable in x, w, v, alpha, beta and threshold, so layers stack:

    >>> import torch
    >>> generator = torch.Generator().manual_seed(0)
    >>> x = (torch.rand(2, 50, 16, generator=generator) < 0.2).float()
    >>> w1, w2 = (torch.randn(n, 10, generator=generator, requires_grad=True) for n in (16, 10))
    >>> hidden = cuba_lif_layer(x, w1, alpha=0.9, beta=0.95)
    >>> out = cuba_lif_layer(hidden, w2, alpha=0.9, beta=0.95)
    >>> out.sum().backward()
    >>> out.shape, w1.grad.shape
    (torch.Size([2, 50, 10]), torch.Size([16, 10]))
    """
    _check(x, w, v, {"alpha": alpha, "beta": beta, "threshold": threshold})
    if kernels.use_native(backend, w):
        return native.layer(x, w, v, alpha, beta, threshold, neuron, surrogate_scale, adaptation)
    spikes, _ = reference.cuba_lif_layer(
        x.to(w.dtype), w, v, alpha=alpha, beta=beta, threshold=threshold, neuron=neuron,
        spike=FastSigmoid(surrogate_scale), adaptation=adaptation,
    )  # fmt: skip
    return spikes


def _check(x: Tensor, w: Tensor, v: Tensor | None, dynamics: dict[str, Decay]) -> None:
    if w.ndim != 2:
        raise InputError(f"w: has shape {tuple(w.shape)} where (presynaptic, postsynaptic) is expected")
    n_in, n_out = w.shape
    if x.ndim != 3 or x.shape[2] != n_in:
        raise InputError(f"x: has shape {tuple(x.shape)} where (trial, time, {n_in}) is expected")
    if v is not None and tuple(v.shape) != (n_out, n_out):
        raise InputError(f"v: has shape {tuple(v.shape)} where {(n_out, n_out)} is expected")
    for name, value in dynamics.items():
        if isinstance(value, Tensor) and value.numel() != 1 and tuple(value.shape) != (n_out,):
            raise InputError(f"{name}: has shape {tuple(value.shape)} where one value or {(n_out,)} is expected")
