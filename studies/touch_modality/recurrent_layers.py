"""LSTM and GRU layers of many small networks at once: forward pass, and backward pass derived by hand.

The networks are small and many, so calls dominate the cost, not arithmetic: a step of all networks is one batched
matrix product and a few in-place operations, on buffers that every batch reuses. Input, state and a one for the bias
are stacked, `v[t] = (x[t], h[t-1], 1)`, so that one product gives all gates; gates are rows and trials are columns, so
that a gate is contiguous in memory. `tanh(a)` is `2 sigmoid(2a) - 1`, because torch's sigmoid takes a tenth of the
time of its tanh on a CPU; the 2 inside is a factor on rows of the weights.
"""

from typing import ClassVar, NamedTuple, Protocol

import torch
from torch import Tensor

_sigmoid_backward = torch.ops.aten.sigmoid_backward.grad_input
_tanh_backward = torch.ops.aten.tanh_backward.grad_input


class Shape(NamedTuple):
    """The sizes of a computation."""

    networks: int
    trials: int
    steps: int
    channels: int
    hidden: int

    @property
    def stacked(self) -> int:
        """Length of `(x, h, 1)`."""
        return self.channels + self.hidden + 1

    @property
    def state(self) -> slice:
        """Position of `h` in `(x, h, 1)`."""
        return slice(self.channels, self.channels + self.hidden)


class Layers(Protocol):
    """Buffers for one shape; run forward and backward alternately."""

    n_gates: ClassVar[int]

    x: Tensor
    """The signals, `(step, network, channel, trial)`; write them before each `forward`."""

    def __init__(self, shape: Shape, dtype: torch.dtype = torch.float32): ...

    def forward(self, weights: Tensor) -> Tensor:
        """`(h, 1)` after the last step, `(network, hidden+1, trial)`; weights `(network, gates, channel+hidden+1)`."""
        ...

    def backward(self, d_state: Tensor) -> Tensor:
        """Gradient of the weights, from that of the last `h`, `(network, hidden, trial)`."""
        ...


def _stack(shape: Shape, dtype: torch.dtype) -> Tensor:
    """`v` for every step and after the last one, `(step + 1, network, channel+hidden+1, trial)`; h[-1] = 0."""
    v = torch.zeros(shape.steps + 1, shape.networks, shape.stacked, shape.trials, dtype=dtype)
    v[:, :, -1] = 1
    return v


class LSTMLayers:
    """Gates in the rows, in the order input i, forget f, candidate g, output o; one bias each.

    `c[t] = f c[t-1] + i g`, `h[t] = o tanh(c[t])` (touch-modality paper, Sec. III.A, after Hochreiter and Schmidhuber).
    """

    n_gates: ClassVar[int] = 4

    def __init__(self, shape: Shape, dtype: torch.dtype = torch.float32):
        self.shape = shape
        n_networks, n_trials, n_steps, n_channels, hidden = shape
        self.v = _stack(shape, dtype)
        self.x = self.v[:-1, :, :n_channels]
        self.gates = torch.empty(n_steps, n_networks, 4 * hidden, n_trials, dtype=dtype)
        self.cells = torch.zeros(n_steps + 1, n_networks, hidden, n_trials, dtype=dtype)
        self.squashed = torch.empty(n_steps, n_networks, hidden, n_trials, dtype=dtype)
        self.row_factors = torch.ones(4 * hidden, 1, dtype=dtype)
        self.row_factors[2 * hidden : 3 * hidden] = 2
        self.weights = torch.empty(n_networks, 4 * hidden, shape.stacked, dtype=dtype)
        self.d_gates = torch.empty_like(self.gates[0])
        self.d_cell, self.doubled, self.spare = (torch.empty_like(self.cells[0]) for _ in range(3))

    def forward(self, weights: Tensor) -> Tensor:
        torch.mul(weights, self.row_factors, out=self.weights)
        for t in range(self.shape.steps):
            gates, cell, squashed = self.gates[t], self.cells[t + 1], self.squashed[t]
            torch.bmm(self.weights, self.v[t], out=gates)
            i, f, s, o = gates.sigmoid_().chunk(4, dim=1)  # g = 2s - 1
            torch.mul(f, self.cells[t], out=cell)
            cell.addcmul_(i, s, value=2).sub_(i)
            torch.mul(cell, 2, out=squashed).sigmoid_()  # tanh(c) = 2 squashed - 1
            state = self.v[t + 1][:, self.shape.state]
            torch.neg(o, out=state).addcmul_(o, squashed, value=2)
        return self.v[-1][:, self.shape.channels :]

    def backward(self, d_state: Tensor) -> Tensor:
        recurrent = self.weights[:, :, self.shape.state].transpose(1, 2)
        d_weights = torch.zeros_like(self.weights)
        d_cell, doubled, spare = self.d_cell.zero_(), self.doubled, self.spare
        d_i, d_f, d_s, d_o = self.d_gates.chunk(4, dim=1)
        for t in reversed(range(self.shape.steps)):
            gates, squashed = self.gates[t], self.squashed[t]
            i, f, s, o = gates.chunk(4, dim=1)
            torch.neg(d_state, out=d_o).addcmul_(d_state, squashed, value=2)
            torch.mul(d_state, o, out=spare)
            _sigmoid_backward(spare, squashed, grad_input=spare)
            d_cell.add_(spare, alpha=4)
            torch.mul(d_cell, 2, out=doubled)
            torch.mul(doubled, s, out=d_i).sub_(d_cell)
            torch.mul(d_cell, self.cells[t], out=d_f)
            torch.mul(doubled, i, out=d_s)
            d_cell.mul_(f)
            _sigmoid_backward(self.d_gates, gates, grad_input=self.d_gates)
            d_weights.baddbmm_(self.d_gates, self.v[t].transpose(1, 2))
            d_state = torch.bmm(recurrent, self.d_gates)
        return d_weights.mul_(self.row_factors)


class GRULayers:
    """Gates in the rows, in the order update z, reset r, candidate n; one bias each.

    The reset is applied before the recurrent product, hence one bias per gate:
    `n = tanh(W x + U (r h[t-1]) + b)`, `h[t] = z h[t-1] + (1 - z) n` (touch-modality paper, Sec. III.B, after Cho
    et al.).
    """

    n_gates: ClassVar[int] = 3

    def __init__(self, shape: Shape, dtype: torch.dtype = torch.float32):
        self.shape = shape
        n_networks, n_trials, n_steps, n_channels, hidden = shape
        self.v = _stack(shape, dtype)
        self.x = self.v[:-1, :, :n_channels]
        self.gates = torch.empty(n_steps, n_networks, 3 * hidden, n_trials, dtype=dtype)
        self.kept = torch.empty(n_steps, n_networks, hidden, n_trials, dtype=dtype)  # r h
        # The candidate's row multiplies `r h`, in a separate product; the other rows multiply `h`.
        self.factors = torch.ones(3 * hidden, shape.stacked, dtype=dtype)
        self.factors[2 * hidden :] = 2
        self.factors[2 * hidden :, shape.state] = 0
        self.weights = torch.empty(n_networks, 3 * hidden, shape.stacked, dtype=dtype)
        self.candidate = torch.empty(n_networks, hidden, hidden, dtype=dtype)
        self.d_gates = torch.empty_like(self.gates[0])
        self.d_kept = torch.empty_like(self.kept[0])

    def forward(self, weights: Tensor) -> Tensor:
        hidden = self.shape.hidden
        torch.mul(weights, self.factors, out=self.weights)
        torch.mul(weights[:, 2 * hidden :, self.shape.state], 2, out=self.candidate)
        for t in range(self.shape.steps):
            gates, kept, before = self.gates[t], self.kept[t], self.v[t][:, self.shape.state]
            torch.bmm(self.weights, self.v[t], out=gates)
            z, r, n = gates.chunk(3, dim=1)
            gates[:, : 2 * hidden].sigmoid_()
            torch.mul(r, before, out=kept)
            n.baddbmm_(self.candidate, kept).sigmoid_().mul_(2).sub_(1)
            torch.lerp(n, before, z, out=self.v[t + 1][:, self.shape.state])
        return self.v[-1][:, self.shape.channels :]

    def backward(self, d_state: Tensor) -> Tensor:
        hidden = self.shape.hidden
        recurrent = self.weights[:, : 2 * hidden, self.shape.state].transpose(1, 2)
        d_weights, d_candidate = torch.zeros_like(self.weights), torch.zeros_like(self.candidate)
        d_z, d_r, d_n = self.d_gates.chunk(3, dim=1)
        d_both, d_kept = self.d_gates[:, : 2 * hidden], self.d_kept
        for t in reversed(range(self.shape.steps)):
            gates, before = self.gates[t], self.v[t][:, self.shape.state]
            z, r, n = gates.chunk(3, dim=1)
            torch.sub(before, n, out=d_z).mul_(d_state)
            torch.mul(d_state, z, out=d_kept)
            torch.sub(d_state, d_kept, out=d_n).mul_(0.5)  # derivative by 2a, since tanh is of half of it
            _tanh_backward(d_n, n, grad_input=d_n)
            d_next = d_kept.clone()
            torch.bmm(self.candidate.transpose(1, 2), d_n, out=d_kept)
            torch.mul(d_kept, before, out=d_r)
            _sigmoid_backward(d_both, gates[:, : 2 * hidden], grad_input=d_both)
            d_weights.baddbmm_(self.d_gates, self.v[t].transpose(1, 2))
            d_candidate.baddbmm_(d_n, self.kept[t].transpose(1, 2))
            d_state = d_next.addcmul_(d_kept, r).baddbmm_(recurrent, d_both)
        d_weights.mul_(self.factors)
        d_weights[:, 2 * hidden :, self.shape.state] = 2 * d_candidate
        return d_weights
