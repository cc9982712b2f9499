"""The definition of the networks: plain PyTorch over a time loop, any device, float32 or float64."""

import torch
from torch import Tensor

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
    n_trials = x.shape[0]
    if state is None:
        state = cuba_lif_start(n_trials, w.shape[1], w)
    transmitted = []
    # unbind, not indexing: its gradient is one stack; an index per step would cost steps squared.
    for arriving in (x if ordered else x @ w).unbind(dim=1):
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
        return x.new_zeros(n_trials, 0, w.shape[1]), state
    return torch.stack(transmitted, dim=1), state


def _add_ascending(total: Tensor, spikes: Tensor, weights: Tensor) -> Tensor:
    for j in range(weights.shape[0]):
        total = total + spikes[:, j : j + 1] * weights[j]
    return total
