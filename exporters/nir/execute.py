"""NIR graphs as networks of `networks/graph.py`, and an interpreter of them in float64, independent of every simulator.

A `Delay` returns its input after its own time, and zeros before.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch
from neurotact_parts.exporters.nir.nodes import graph as graph_of
from neurotact_parts.networks.graph import SPIKING, Graph, GraphNetwork, Kind, order

from neurotact.errors import InputError
from neurotact.networks.definition.parts import Sizes

LONGEST = 100_000
"""Maximum number of steps of a `Delay`."""
KINDS: tuple[str, ...] = Kind.__args__
"""The supported nodes."""
ROUNDED = 1e-6
"""Relative difference of a factor from 1 that comes from values written in float32."""
Flat = tuple[dict[str, Any], list[tuple[str, str]]]
Values = dict[str, np.ndarray]


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


def joined(nodes: dict[str, Any], edges: list[tuple[str, str]]) -> Flat:
    """A flat graph without the ends of inner graphs, which only pass on what they get."""
    inner = {name for name, node in nodes.items() if "/" in name and type(node).__name__ in ("Input", "Output")}
    for end in inner:
        before, after = [a for a, b in edges if b == end], [b for a, b in edges if a == end]
        edges = [edge for edge in edges if end not in edge] + [(a, b) for a in before for b in after]
    return {name: node for name, node in nodes.items() if name not in inner}, edges


def keys_of(nodes: dict[str, Any], edges: list[tuple[str, str]], dt_s: float) -> tuple[Graph, dict[str, Values]]:
    """A flat graph as the keys of a network and the values of each node, on a clock of `dt_s` seconds per step.

    InputError for an unknown node, a delay that is not a whole number of steps, and sizes that do not fit.
    """
    for name, node in nodes.items():
        if type(node).__name__ not in KINDS:
            raise InputError(f"graph: '{name}' is a {type(node).__name__}, which is not interpreted")
    widths = {name: (width(node.input_type), width(node.output_type)) for name, node in nodes.items()}
    for a, b in edges:
        if widths[a][1] != widths[b][0]:
            raise InputError(f"graph: '{b}' takes {widths[b][0]} values and receives {widths[a][1]}")
    keys = Graph(
        names=tuple(nodes), kinds=tuple(type(node).__name__ for node in nodes.values()),  # pyright: ignore
        widths=tuple(widths.values()), edges=tuple(dict.fromkeys(edges)),
    )  # fmt: skip
    return keys, {name: _VALUES[type(node).__name__](node, dt_s, name) for name, node in nodes.items()}


def load(network: GraphNetwork, values: dict[str, Values]) -> None:
    """Set the values of the nodes of a network."""
    for name, node in network.of_name.items():
        for key, value in values[name].items():
            own = getattr(node, key)
            own.data = tensor(value, own)


def tensor(value: np.ndarray, like: torch.Tensor) -> torch.Tensor:
    """Values in the shape and type of a tensor."""
    return torch.from_numpy(np.array(np.broadcast_to(value, like.shape))).to(like.dtype)


def arranged(graph: Any) -> Any:
    """The same network as snnTorch 1.0.0 loads it: nodes in the order of computation, recurrences as inner graphs.

    It fails for an inner graph before the nodes that lead to it, and connects a flat recurrence wrongly, with the input
    through the recurrent weights.
    """
    own, edges = dict(graph.nodes), list(dict.fromkeys(graph.edges))
    is_inner = {"Input", "Output"} <= {type(node).__name__ for node in own.values()} and len(own) == 4
    for back in [name for name, node in own.items() if hasattr(node, "weight")]:
        before, after = [a for a, b in edges if b == back], [b for a, b in edges if a == back]
        if len(before) == 1 and before == after and hasattr(own[before[0]], "v_threshold") and not is_inner:
            edges = [edge for edge in edges if back not in edge]
            own[before[0]] = _recurrent(own[before[0]], own.pop(back))
    sequence = order([*own], edges, [])
    inner = {name: arranged(node) if hasattr(node, "nodes") else node for name, node in own.items()}
    return type(graph)({name: inner[name] for name in sequence}, edges, graph.metadata)


def _recurrent(neurons: Any, weights: Any) -> Any:
    n = len(neurons.v_threshold)
    edges = [("input", "lif"), ("lif", "w_rec"), ("w_rec", "lif"), ("lif", "output")]
    return graph_of({"lif": neurons, "w_rec": weights}, edges, n, n)


class Interpreter:
    """A graph that is ready to run, on a clock of `dt_s` seconds per step; errors as of `keys_of`."""

    def __init__(self, graph: Any, dt_s: float) -> None:
        self.nodes, edges = flat(graph)
        keys, values = keys_of(self.nodes, edges, dt_s)
        self.network = GraphNetwork(keys, Sizes(1, 1, 1.0, 1.0)).double()
        load(self.network, values)

    @torch.no_grad()
    def run(self, signal: np.ndarray, record: Sequence[str] = ("output",)) -> dict[str, np.ndarray]:
        """The outputs of nodes, `(trial, time, value)` each, for an input `(trial, time, value)` of float.

        record: names of nodes; an inner graph's own name means its output.
        """
        recorded = {name: name if name in self.nodes else _end(self.nodes, name, "Output") for name in record}
        found = self.network.run(torch.from_numpy(np.asarray(signal, np.float64)), [*recorded.values()])
        return {name: found[node].numpy() for name, node in recorded.items()}


def width(type_: dict[str, Any]) -> int:
    """Values of a node's input or output."""
    return int(np.prod(next(iter(type_.values()))))


# --- the values of nodes ----------------------------------------------------------------------------


def _none(node: Any, dt_s: float, name: str) -> Values:
    return {}


def _weights(node: Any, dt_s: float, name: str) -> Values:
    if np.ndim(node.weight) != 2:
        raise InputError(f"graph: the weights of '{name}' are not a matrix, which is not supported")
    weight = {"weight": np.asarray(node.weight, np.float64)}
    return weight | ({"bias": np.asarray(node.bias, np.float64)} if hasattr(node, "bias") else {})


def _steps(node: Any, dt_s: float, name: str) -> Values:
    steps = np.asarray(node.delay, np.float64).ravel() / dt_s
    whole = np.rint(steps)
    if not (np.isfinite(steps).all() and (np.abs(steps - whole) < 1e-6).all() and (whole >= 1).all()):
        raise InputError(f"graph: the delay of '{name}' is not a whole number of {dt_s:g} s steps, from 1 on")
    if (whole > LONGEST).any():
        raise InputError(f"graph: the delay of '{name}' is {whole.max():g} steps; at most {LONGEST:,} are possible")
    return {"steps": whole.astype(np.int64)}


def neurons(node: Any, dt_s: float, name: str) -> Values:
    """Constants per step. Factors of a spiking neuron's input are merged into its thresholds, as in snnTorch."""
    given = {
        key: np.asarray(value, np.float64).ravel()
        for key in ("tau", "tau_syn", "tau_mem", "r", "w_in", "v_leak", "v_threshold", "v_reset")
        if (value := getattr(node, key, None)) is not None
    }
    adds = not {"tau", "tau_mem"} & given.keys()
    rate = dt_s if adds else dt_s / given["tau" if "tau" in given else "tau_mem"]
    values = {
        "beta": np.ones_like(given["r"]) if adds else 1.0 - rate,
        "leaked": np.zeros_like(given["r"]) if adds else rate * given["v_leak"],
        "h": _rounded(given["r"] * rate),
    }
    if "tau_syn" in given:
        values |= {
            "alpha": 1.0 - dt_s / given["tau_syn"],
            "g": _rounded(given["w_in"] * (dt_s / given["tau_syn"])),
        }
    for key in {"alpha", "beta"} & values.keys():
        if not ((values[key] > -CLOSE) & (values[key] <= 1)).all():
            raise InputError(f"graph: '{name}' has a time constant below the step of {dt_s:g} s; give another dt_s")
        values[key] = values[key].clip(min=0.0)
    if type(node).__name__ not in SPIKING:
        return values
    factor = values["h"] * values.get("g", 1.0)
    factor = factor if (factor > 0).all() else np.ones_like(factor)
    if (factor != 1).any():
        values |= {key: np.ones_like(factor) for key in {"g", "h"} & values.keys()}
        values["leaked"] = values["leaked"] / factor
    return values | {"threshold": given["v_threshold"] / factor, "v_reset": given["v_reset"] / factor}


CLOSE = 1e-9
"""What rounding may take a decay below 0."""


def _rounded(factor: np.ndarray) -> np.ndarray:
    """A factor, as 1 where it differs by what float32 rounds."""
    return np.where(np.abs(factor - 1.0) < ROUNDED, 1.0, factor)


_VALUES: dict[str, Callable[[Any, float, str], Values]] = {
    **dict.fromkeys(KINDS, neurons), **dict.fromkeys(("Input", "Output"), _none),
    **dict.fromkeys(("Linear", "Affine"), _weights), "Delay": _steps,
    "Scale": lambda node, dt_s, name: {"factor": np.asarray(node.scale, np.float64)},
    "Threshold": lambda node, dt_s, name: {"threshold": np.asarray(node.threshold, np.float64)},
}  # fmt: skip
