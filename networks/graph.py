"""A network as a graph of weights, delays and neurons in any connection: what a NIR file of another program holds.

Forward Euler with constants per step: `I <- alpha I + g x`, `U <- beta U + leaked + h I`; a neuron spikes where
U > threshold, and then U is v_reset. Where `reset` is `subtract`, U loses the threshold, and while it is still above,
the next spike takes another threshold (snnTorch's reset by subtraction without a delay). An edge that closes a cycle
without a delay returns what its node sent one step before, which is 0 at first. The operations and their order are
those of snnTorch 1.0.0, which a network in float32 equals to the last bit.
"""

import math
from collections import deque
from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import Annotated, Any, Literal

import torch
from pydantic import AfterValidator, Field
from torch import Tensor, nn
from torch.nn import functional

from neurotact.networks.definition.parts import Counted, NetworkPart, Sizes
from neurotact.networks.definition.surrogate import spike_function
from neurotact.neurons import FAST_SIGMOID, decay_per_step
from neurotact.spec import Spec

Kind = Literal[
    "Input", "Output", "Linear", "Affine", "Scale", "Threshold", "Delay", "LI", "LIF", "CubaLI", "CubaLIF", "I", "IF"
]
"""The names that NIR gives to its nodes."""
OwnReset = Literal["to-value", "subtract"]
SPIKING = ("LIF", "CubaLIF", "IF")
WITH_CURRENT = ("CubaLI", "CubaLIF")
MOST_NODES = 1000


def _unique(names: tuple[str, ...]) -> tuple[str, ...]:
    if len(set(names)) != len(names):
        raise ValueError("two nodes have one name; give each its own")
    return names


class Graph(Spec):
    """The nodes of a network and the edges between them. Without nodes: weights and a layer of spiking neurons.

    >>> Graph().n_hidden
    0
    """

    names: Annotated[tuple[str, ...], AfterValidator(_unique), Field(max_length=MOST_NODES)] = ()
    """Of each node."""
    kinds: tuple[Kind, ...] = ()
    """Of each node."""
    widths: tuple[tuple[Annotated[int, Field(ge=1)], Annotated[int, Field(ge=1)]], ...] = ()
    """Values that each node takes and gives."""
    edges: tuple[tuple[str, str], ...] = ()
    """From which node to which."""
    reset: OwnReset = "to-value"
    """What a spike does to its membrane, in the same step."""

    def of_kind(self, *kinds: str) -> list[str]:
        """The names of the nodes of some kinds."""
        return [name for name, kind in zip(self.names, self.kinds, strict=True) if kind in kinds]

    def into(self, name: str) -> list[str]:
        """The nodes with an edge to this one."""
        return [a for a, b in self.edges if b == name]

    @property
    def hidden(self) -> list[str]:
        """The spiking nodes that are not the output."""
        last = {a for a, b in self.edges if b in self.of_kind("Output")}
        return [name for name in self.of_kind(*SPIKING) if name not in last]

    @property
    def n_hidden(self) -> int:
        """Neurons of those."""
        return sum(self.widths[self.names.index(name)][1] for name in self.hidden)


def order(names: Sequence[str], edges: Sequence[tuple[str, str]], delays: Iterable[str]) -> list[str]:
    """Nodes in the order of computation in a step, without `delays`: depth first from the inputs, with cycles cut.

    >>> order(["in", "cell", "back"], [("in", "cell"), ("cell", "back"), ("back", "cell")], [])
    ['in', 'cell', 'back']
    """
    following: dict[str, list[str]] = {name: [] for name in names}
    for a, b in edges:
        following[a].append(b)
    begins = [name for name in names if all(b != name for _, b in edges)] + [*delays]
    seen, finished, late = set[str](), list[str](), {*delays}
    for begin in begins:
        stack = [(begin, iter(following[begin]))] if begin not in seen else []
        seen.add(begin)
        while stack:
            name, rest = stack[-1]
            after = next((key for key in rest if key not in seen and key not in late), None)
            if after is None:
                stack.pop()
                finished.append(name)
            else:
                seen.add(after)
                stack.append((after, iter(following[after])))
    return [name for name in reversed(finished) if name not in late]


class _Node(nn.Module):
    """The values of a node, each of which has its name in `VALUES`; only weights and biases are trained."""

    VALUES = {
        "Linear": ("weight",), "Affine": ("weight", "bias"), "Scale": ("factor",), "Threshold": ("threshold",),
        "Delay": ("steps",), "LI": ("beta", "leaked", "h"), "I": ("beta", "leaked", "h"),
        "LIF": ("beta", "leaked", "h", "threshold", "v_reset"), "IF": ("beta", "leaked", "h", "threshold", "v_reset"),
        "CubaLI": ("alpha", "g", "beta", "leaked", "h"),
        "CubaLIF": ("alpha", "g", "beta", "leaked", "h", "threshold", "v_reset"),
    }  # fmt: skip

    weight: Tensor
    factor: Tensor
    steps: Tensor
    alpha: Tensor
    g: Tensor
    beta: Tensor
    leaked: Tensor
    h: Tensor
    threshold: Tensor
    v_reset: Tensor

    def __init__(self, kind: str, n_in: int, n_out: int, *, subtracts: bool) -> None:
        super().__init__()
        self.kind, self.n_out, self.subtracts = kind, n_out, subtracts
        self.spike = spike_function(FAST_SIGMOID, 10.0)
        for name in self.VALUES.get(kind, ()):
            shape = (n_out, n_in) if name == "weight" else (n_out,)
            if name == "steps":
                self.register_buffer(name, torch.ones(shape, dtype=torch.int64))
            else:
                value = torch.zeros(shape)
                self.register_parameter(name, nn.Parameter(value, requires_grad=name in ("weight", "bias")))

    def start(self, x: Tensor) -> Any:
        """The state before the first step, for as many trials as `x` has rows."""
        zero = x.new_zeros(len(x), self.n_out)
        if self.kind != "Delay":
            return zero, zero
        most = int(self.steps.max())
        return deque([zero] * most, maxlen=most)

    def forward(self, x: Tensor, state: Any) -> tuple[Tensor, Any]:
        """What the node sends in a step, and its state after it."""
        if self.kind in ("Linear", "Affine"):
            return functional.linear(x, self.weight, getattr(self, "bias", None)), state
        if self.kind == "Scale":
            return x * self.factor, state
        if self.kind == "Threshold":
            return self.spike(x - self.threshold).to(x), state
        if self.kind in ("Input", "Output"):
            return x, state
        return self._neurons(x, *state)

    def _neurons(self, x: Tensor, current: Tensor, membrane: Tensor) -> tuple[Tensor, tuple[Tensor, Tensor]]:
        if self.kind in WITH_CURRENT:
            x = current = self.alpha * current + self.g * x
        before, membrane = membrane.detach(), self.beta * membrane + self.leaked + self.h * x
        if self.kind not in SPIKING:
            return membrane, (current, membrane)
        above = (before > self.threshold).to(membrane)  # never after a reset to a value below the threshold
        if self.subtracts:
            membrane = membrane - above * self.threshold
        fired = membrane.detach() > self.threshold
        sent = self.spike(membrane - self.threshold).to(membrane)
        if self.subtracts:
            return sent, (current, membrane - (fired.to(membrane) - above) * self.threshold)
        return sent, (current, torch.where(fired, self.v_reset, membrane))

    def delayed(self, history: Sequence[Tensor]) -> Tensor:
        """What a delay sends now; `history` ends with its last input."""
        now = torch.empty_like(history[-1])
        for n in self.steps.unique().tolist():
            now[:, self.steps == n] = history[-n][:, self.steps == n]
        return now


class GraphNetwork(nn.Module):
    """The network: one module for each node, in the order of the keys.

    >>> net = GraphNetwork(Graph(), Sizes(3, 2, 1000.0, 1000.0, generator=torch.Generator().manual_seed(0)))
    >>> net(torch.ones(1, 9, 3)).shape
    torch.Size([1, 9, 2])
    """

    def __init__(self, keys: Graph, sizes: Sizes) -> None:
        super().__init__()
        drawn, self.sizes = not keys.names, sizes
        self.keys = keys = _simple(sizes) if drawn else keys
        subtracts = keys.reset == "subtract"
        nodes = zip(keys.kinds, keys.widths, strict=True)
        self.nodes = nn.ModuleList(_Node(kind, *width, subtracts=subtracts) for kind, width in nodes)
        self.of_name: dict[str, _Node] = dict(zip(keys.names, self.nodes, strict=True))  # pyright: ignore
        self.late = keys.of_kind("Delay")
        self.in_order = order(keys.names, keys.edges, self.late)
        self.inputs = {name: keys.into(name) for name in keys.names}
        if drawn:
            self._draw()

    def forward(self, spikes: Tensor) -> Tensor:
        """What the output sends in each step, `(batch, time, class)`."""
        (output,) = self.keys.of_kind("Output")
        return self.run(spikes, [output])[output]

    def run(self, spikes: Tensor, record: Sequence[str]) -> dict[str, Tensor]:
        """What some nodes send, `(batch, time, value)` each."""
        before: dict[str, Tensor] = {}
        states = {name: node.start(spikes[:, 0] if spikes.shape[1] else spikes.new_zeros(len(spikes), 1))
                  for name, node in self.of_name.items()}  # fmt: skip
        sent: dict[str, list[Tensor]] = {name: [] for name in record}
        for arriving in spikes.unbind(dim=1):
            now = {name: self.of_name[name].delayed(states[name]) for name in self.late}
            for name in self.in_order:
                x = self._sum(name, now, before, arriving)
                now[name], states[name] = self.of_name[name](x, states[name])
            for name in self.late:
                states[name].append(self._sum(name, now, before, arriving))
            for name, rows in sent.items():
                rows.append(now[name])
            before = now
        return {
            name: torch.stack(rows, dim=1) if rows else spikes.new_zeros(len(spikes), 0, self.of_name[name].n_out)
            for name, rows in sent.items()
        }

    def _sum(self, name: str, now: dict[str, Tensor], before: dict[str, Tensor], arriving: Tensor) -> Tensor:
        if not self.inputs[name]:
            return arriving
        found = [now.get(a, before.get(a)) for a in self.inputs[name]]
        there = [values for values in found if values is not None]  # none of a cycle, before its first step
        if not there:
            width = self.keys.widths[self.keys.names.index(name)][0]
            return arriving.new_zeros(len(arriving), width)
        total = there[0]
        for values in there[1:]:
            total = total + values
        return total

    def counted(self, spikes: Tensor) -> Counted:
        """Scores, the spikes of all hidden neurons, and each spike as an operation at every weight it has."""
        (output,), keys = self.keys.of_kind("Output"), self.keys
        weights = keys.of_kind("Linear", "Affine")
        heard = {name: keys.into(name) for name in weights}
        wanted = {output, *keys.hidden, *(a for them in heard.values() for a in them)}
        found = self.run(spikes, [*wanted])
        sops: dict[str, Tensor] = {}
        for name in weights:
            fan = (self.of_name[name].weight.detach() != 0).sum(dim=0).double()
            at = self._projection(name)
            for a in heard[name]:
                sops[at] = sops.get(at, 0) + (found[a].detach() != 0).double() @ fan
        hidden = [found[name] for name in keys.hidden] or [spikes.new_zeros(*spikes.shape[:2], 0)]
        return Counted(found[output], torch.cat(hidden, dim=2), sops)

    def _projection(self, name: str) -> str:
        """Which of the kinds of projection a node of weights is."""
        keys = self.keys
        reached, following = set[str](), [name]
        while following:
            after = [b for a, b in keys.edges if a in following and b not in reached]
            reached.update(after)
            following = after
        if name in reached:
            return "recurrent"
        if not {*keys.into(name)}.isdisjoint(keys.of_kind("Input")):
            return "input"
        return "between" if reached & {*keys.hidden} else "readout"

    @torch.no_grad()
    def _draw(self) -> None:
        """Weights and constants of an untrained network."""
        weights, neurons, clock_Hz = self.of_name["weights"].weight, self.of_name["neurons"], self.sizes.clock_Hz
        drawn = torch.randn(weights.shape, generator=self.sizes.generator)
        weights.copy_(drawn / math.sqrt(self.sizes.n_inputs))
        for name, value in (("alpha", decay_per_step(10.0, clock_Hz)), ("beta", decay_per_step(20.0, clock_Hz))):
            getattr(neurons, name).fill_(value)
        for name in ("g", "h", "threshold"):
            getattr(neurons, name).fill_(1.0)


def _simple(sizes: Sizes) -> Graph:
    """Weights and a layer of spiking neurons."""
    names = "input", "weights", "neurons", "output"
    n, m = sizes.n_inputs, sizes.n_classes
    return Graph(
        names=names, kinds=("Input", "Linear", "CubaLIF", "Output"), widths=((n, n), (n, m), (m, m), (m, m)),
        edges=tuple(pairwise(names)),
    )  # fmt: skip


GRAPH = NetworkPart("Weights, delays and neurons in any connection, as a NIR file holds them.", Graph, GraphNetwork)
