"""A small interpreter of NIR graphs, step by step, independent of every simulator.

Float64 and forward Euler, as in `nodes`. A `Delay` returns its input after its own time, and zeros before. An edge that
closes a cycle without a `Delay` returns the output of its node one step before.
"""

from collections import deque
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from neurotact.errors import InputError

LONGEST = 100_000
"""Maximum number of steps of a `Delay`."""
Step = Callable[[np.ndarray], np.ndarray]
Flat = tuple[dict[str, Any], list[tuple[str, str]]]


def flat(graph: Any, prefix: str = "") -> Flat:
    """Nodes and edges without inner graphs: the nodes of `hidden` are `hidden/lif` and so on."""
    nodes: dict[str, Any] = {}
    edges = [(prefix + a, prefix + b) for a, b in graph.edges]
    for name, node in graph.nodes.items():
        if type(node).__name__ != "NIRGraph":
            nodes[prefix + name] = node
            continue
        inner, within = flat(node, f"{prefix}{name}/")
        nodes |= inner
        ends = {kind: _end(inner, f"{prefix}{name}", kind) for kind in ("Input", "Output")}
        whole = prefix + name
        edges = [(ends["Output"] if a == whole else a, ends["Input"] if b == whole else b) for a, b in edges]
        edges += within
    return nodes, edges


def _end(nodes: dict[str, Any], name: str, kind: str) -> str:
    ends = [
        key for key, node in nodes.items()
        if type(node).__name__ == kind and key.startswith(f"{name}/") and key.count("/") == name.count("/") + 1
    ]  # fmt: skip
    if len(ends) != 1:
        raise InputError(f"graph: '{name}' has {len(ends)} {kind} nodes; give it one")
    return ends[0]


class Interpreter:
    """A graph that is ready to run, on a clock of `dt_s` seconds per step.

    InputError for an unknown node, a delay that is not a whole number of steps, and sizes that do not fit.
    """

    def __init__(self, graph: Any, dt_s: float) -> None:
        self.nodes, self.edges = flat(graph)
        self.dt_s = dt_s
        for name, node in self.nodes.items():
            if type(node).__name__ not in KINDS:
                raise InputError(f"graph: '{name}' is a {type(node).__name__}, which is not interpreted")
        self.inputs = {name: [a for a, b in self.edges if b == name] for name in self.nodes}
        self.delays = {name: self._steps_of(name) for name in self.nodes if type(self.nodes[name]).__name__ == "Delay"}
        self.order = self._order()

    def run(self, signal: np.ndarray, record: Sequence[str] = ("output",)) -> dict[str, np.ndarray]:
        """The outputs of nodes, `(trial, time, value)` each, for an input `(trial, time, value)` of float.

        record: names of nodes; an inner graph's own name means its output.
        """
        n_trials, n_steps, _ = signal.shape
        recorded = {name: name if name in self.nodes else _end(self.nodes, name, "Output") for name in record}
        before: dict[str, np.ndarray] = {}
        histories = {
            name: deque([np.zeros((n_trials, len(steps)))] * int(steps.max()), maxlen=int(steps.max()))
            for name, steps in self.delays.items()
        }  # fmt: skip
        state: dict[str, Step] = {
            name: KINDS[type(node).__name__](node, self.dt_s, n_trials) for name, node in self.nodes.items()
            if name not in self.delays
        }  # fmt: skip
        outputs: dict[str, list[np.ndarray]] = {name: [] for name in recorded}
        for t in range(n_steps):
            now = {name: _delayed_output(histories[name], steps) for name, steps in self.delays.items()}
            for name in self.order:
                inputs = [now.get(a, before.get(a)) for a in self.inputs[name]] or [signal[:, t]]
                now[name] = state[name](_sum(inputs, n_trials, self.nodes[name], name))
            for name in self.delays:
                inputs = [now[a] for a in self.inputs[name]]
                histories[name].append(_sum(inputs, n_trials, self.nodes[name], name))
            for name, node in recorded.items():
                outputs[name].append(now[node])
            before = now
        shape = {name: _width(self.nodes[node]) for name, node in recorded.items()}
        return {
            name: np.stack(rows, axis=1) if rows else np.zeros((n_trials, 0, shape[name]))
            for name, rows in outputs.items()
        }

    def _steps_of(self, name: str) -> np.ndarray:
        steps = np.asarray(self.nodes[name].delay, np.float64) / self.dt_s
        whole = np.rint(steps)
        if not (np.isfinite(steps).all() and (np.abs(steps - whole) < 1e-6).all() and (whole >= 1).all()):
            raise InputError(f"graph: the delay of '{name}' is not a whole number of {self.dt_s:g} s steps, from 1 on")
        if (whole > LONGEST).any():
            raise InputError(f"graph: the delay of '{name}' is {whole.max():g} steps; at most {LONGEST:,} are possible")
        return whole.astype(np.int64)

    def _order(self) -> list[str]:
        """Nodes in the order of computation in a step: depth first from the inputs, with cycles cut."""
        following = {name: [b for a, b in self.edges if a == name] for name in self.nodes}
        begins = [name for name in self.nodes if not self.inputs[name]] + [*self.delays]
        seen: set[str] = set()
        finished: list[str] = []
        for begin in begins:
            stack: list[tuple[str, Iterable[str]]] = []
            if begin not in seen:
                seen.add(begin)
                stack.append((begin, iter(following[begin])))
            while stack:
                name, rest = stack[-1]
                after = next((key for key in rest if key not in seen and key not in self.delays), None)
                if after is None:
                    stack.pop()
                    finished.append(name)
                else:
                    seen.add(after)
                    stack.append((after, iter(following[after])))
        return [name for name in reversed(finished) if name not in self.delays]


def _delayed_output(history: Sequence[np.ndarray], steps: np.ndarray) -> np.ndarray:
    """The present output of a delay of `steps`, one for each value; `history` ends with the last step."""
    now = np.empty_like(history[-1])
    for n in np.unique(steps):
        now[:, steps == n] = history[-n][:, steps == n]
    return now


def _sum(inputs: Sequence[np.ndarray | None], n_trials: int, node: Any, name: str) -> np.ndarray:
    width = int(np.prod(next(iter(node.input_type.values()))))
    total = np.zeros((n_trials, width))
    for values in inputs:
        if values is None:  # a cycle, before its first step
            continue
        if values.shape[1] != width:
            raise InputError(f"graph: '{name}' takes {width} values and receives {values.shape[1]}")
        total = total + values
    return total


def _width(node: Any) -> int:
    return int(np.prod(next(iter(node.output_type.values()))))


def _same(node: Any, dt_s: float, n_trials: int) -> Step:
    return lambda x: x


def _linear(node: Any, dt_s: float, n_trials: int) -> Step:
    weight = np.asarray(node.weight, np.float64).T
    bias = np.asarray(getattr(node, "bias", 0.0), np.float64)
    return lambda x: x @ weight + bias


def _scale(node: Any, dt_s: float, n_trials: int) -> Step:
    return lambda x: x * node.scale


def _threshold(node: Any, dt_s: float, n_trials: int) -> Step:
    return lambda x: (x > node.threshold).astype(np.float64)


class _Leaky:
    """`v += dt/tau (v_leak - v + r x)`; with a threshold, spikes, and v_reset after them."""

    def __init__(
        self, dt_s: float, tau: np.ndarray, r: np.ndarray, v_leak: np.ndarray, n_trials: int, node: Any = None
    ):
        self.decay = 1.0 - dt_s / np.asarray(tau, np.float64)
        self.gain = dt_s / np.asarray(tau, np.float64) * np.asarray(r, np.float64)
        self.leaked = dt_s / np.asarray(tau, np.float64) * np.asarray(v_leak, np.float64)
        self.v = np.zeros((n_trials, len(self.decay)))
        self.node = node

    def __call__(self, x: np.ndarray) -> np.ndarray:
        self.v = self.decay * self.v + self.leaked + self.gain * x
        if self.node is None:
            return self.v
        fired = self.v > self.node.v_threshold
        self.v = np.where(fired, self.node.v_reset, self.v)
        return fired.astype(np.float64)


def _leak(node: Any, dt_s: float, n_trials: int) -> Step:
    spiking = node if hasattr(node, "v_threshold") else None
    return _Leaky(dt_s, node.tau, node.r, node.v_leak, n_trials, spiking)


def _current_based(node: Any, dt_s: float, n_trials: int) -> Step:
    synapse = _Leaky(dt_s, node.tau_syn, node.w_in, np.zeros_like(node.tau_syn), n_trials)
    spiking = node if hasattr(node, "v_threshold") else None
    membrane = _Leaky(dt_s, node.tau_mem, node.r, node.v_leak, n_trials, spiking)
    return lambda x: membrane(synapse(x))


def _integrate(node: Any, dt_s: float, n_trials: int) -> Step:
    r = np.asarray(node.r, np.float64)
    spiking = node if hasattr(node, "v_threshold") else None
    adder = _Leaky(dt_s, np.full(r.shape, np.inf), r, np.zeros(r.shape), n_trials, spiking)
    adder.gain = dt_s * r
    return adder


KINDS: dict[str, Callable[[Any, float, int], Step]] = {
    "Input": _same, "Output": _same, "Linear": _linear, "Affine": _linear, "Scale": _scale, "Threshold": _threshold,
    "Delay": _same, "LI": _leak, "LIF": _leak, "CubaLI": _current_based, "CubaLIF": _current_based, "I": _integrate,
    "IF": _integrate,
}  # fmt: skip
"""The supported nodes."""
