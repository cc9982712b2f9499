"""The definition of the networks: plain PyTorch over a time loop, any device, float32 or float64."""

from typing import NamedTuple

import torch
from torch import Tensor

from neurotact.networks.definition.readouts import Integration, Stretches
from neurotact.neurons import (
    Adaptation,
    CubaLIF,
    CubaLIFState,
    Decay,
    SpikeFunction,
    cuba_lif_start,
    cuba_lif_step,
    recurrent_spikes,
)


class Layer(NamedTuple):
    """The neurons of a layer, as `cuba_lif_layer` takes them."""

    alpha: Decay
    beta: Decay
    threshold: Decay
    neuron: CubaLIF
    spike: SpikeFunction
    adaptation: Adaptation | None = None


class Model(NamedTuple):
    """All that a network computes with: layers, weights, and the integration of a readout that does not spike.

    stretches: of its window, if the integrator has weights of its own in each; w_out is then `(K, heard, class)`.
    direct: whether the integrator hears the input spikes, too, through rows of w_out behind those of hidden neurons.
    """

    hidden: Layer
    readout: Layer
    w_in: Tensor
    w_rec: Tensor | None
    w_out: Tensor
    integration: Integration | None
    stretches: Stretches | None = None
    direct: bool = False


def counts(model: Model, spikes: Tensor, factors: Tensor | None = None) -> tuple[Tensor, Tensor]:
    """Readout counts or values `(trial, class)` and hidden counts `(trial, hidden)` over a window.

    factors: of the input from each neuron to an integrator that leaks, `(heard,)`, or `(trial, heard)` if it has
        stretches or hears the input; by default all 1.
    """
    sent, _ = cuba_lif_layer(spikes.to(model.w_in.dtype), model.w_in, model.w_rec, **model.hidden._asdict())
    hidden, integration = sent.sum(dim=-2), model.integration
    if integration is None:
        decided, _ = cuba_lif_layer(sent, model.w_out, None, **model.readout._asdict())
        return decided.sum(dim=-2), hidden
    heard = torch.cat([sent, spikes.to(sent)], dim=-1) if model.direct else sent
    if model.stretches is not None:
        values = stretched(model.stretches, model.stretches.counts(heard), model.w_out, factors) + integration.level
    elif integration.leaks:
        w_out = model.w_out if factors is None else model.w_out * factors[..., None]
        values = integration.of(heard.double() @ w_out.double())
    else:
        counted = heard.sum(dim=-2) if factors is None else heard.sum(dim=-2) * factors
        values = counted.double() @ model.w_out.double() + integration.level
    return values.to(model.w_out.dtype), hidden


def stretched(stretches: Stretches, counts: Tensor, w_out: Tensor, factors: Tensor | None) -> Tensor:
    """What spikes that are heard in each stretch, `(trial, K, heard)`, add to the classes, `(trial, class)` float64."""
    counts = counts if factors is None else counts * factors[..., None, :]
    return stretches.sums(counts.double(), w_out.double())


def cuba_lif_layer(
    x: Tensor,
    w: Tensor,
    v: Tensor | None,
    *,
    alpha: Decay,
    beta: Decay,
    threshold: Decay,
    neuron: CubaLIF,
    spike: SpikeFunction,
    adaptation: Adaptation | None = None,
    state: CubaLIFState | None = None,
    ordered: bool = False,
) -> tuple[Tensor, CubaLIFState]:
    """Run one layer over a window: `I[t+1] = alpha I[t] + x[t] w + s[t-d] v` (texture paper, Eq. 5, has d = 0).

    x: spikes into the layer, `(trial, time, presynaptic)`, of the weights' float type.
    w, v: weights `(presynaptic, postsynaptic)`; v is None without recurrence.
    alpha, beta, threshold: numbers or tensors that broadcast over `(postsynaptic,)`.
    neuron: membrane, reset and d, the recurrent delay. adaptation: of the thresholds; None: they are fixed.
    ordered: add decay, then inputs, then recurrence in ascending order, as the native kernels do. The last
        bits of a matrix product depend on the batch; these do not.

    Returns the transmitted spikes `(trial, time, postsynaptic)` and the state after the last step.
    """
    shape = x.shape[:-2]
    if state is None:
        state = cuba_lif_start(shape, w.shape[-1], w)
    if not w.shape[-1]:
        return x.new_zeros(*shape, x.shape[-2], 0), state
    transmitted = []
    # unbind, not indexing: its gradient is one stack; an index per step would cost steps squared.
    for arriving in (x if ordered else x @ w).unbind(dim=-2):
        current, returning = alpha * state.current, recurrent_spikes(neuron, state)
        if ordered:
            current = _add_ascending(current, arriving, w)
            current = current if v is None else _add_ascending(current, returning, v)
        else:
            current = current + arriving
            current = current if v is None else torch.addmm(current, returning, v)
        spikes, state = cuba_lif_step(neuron, current, state, beta, threshold, spike, adaptation)
        transmitted.append(spikes)
    if not transmitted:
        return x.new_zeros(*shape, 0, w.shape[-1]), state
    return torch.stack(transmitted, dim=-2), state


def _add_ascending(total: Tensor, spikes: Tensor, weights: Tensor) -> Tensor:
    for j in range(weights.shape[0]):
        total = total + spikes[:, j : j + 1] * weights[j]
    return total
