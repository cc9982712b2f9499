"""The layers of a network as graphs of NIR's nodes: unchanged if NIR has them, else lowered to equal sub-graphs.

NIR's CubaLIF computes membrane `immediate` with reset `hard`, step by step. Others are lowered:

- `delayed` and `eq4` are the same neuron with its input two steps later (see `exporters.snntorch`), `eq4` with its
  current times beta: a `Delay` before every layer and in the recurrence.
- reset `subtract`: a leaky integrator and a `Threshold`, whose spike returns one step later, times -threshold.
- a readout of stretches: a counter of steps, and thresholds that let spikes pass to the weights of the present stretch.
- reset `zero`: a spike returns one step later with a force that makes the membrane fire again, for any input. This
  resets it to zero once more, and a `Threshold` removes the second spike.

A `Delay` delays by its own time. A cycle without a `Delay` returns in the next step, as in snnTorch and Norse; only
`immediate`, `hard` without a recurrent delay has such a cycle.
"""

from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import torch
from neurotact_parts.exporters.nir.nodes import FORCE, Clock, Edges, graph, linear, nir, scale, threshold

from neurotact.networks.definition.rsnn import RSNN
from neurotact.neurons import CubaLIF

Layered = tuple[dict[str, Any], Edges]


Values = float | np.ndarray
"""One for all neurons, or one of each."""


class Neuron(NamedTuple):
    """A layer's decays and threshold, its kind of reset, the delay of its input in steps, and the input's scale."""

    alpha: Values
    beta: Values
    threshold: Values
    reset: str
    late: int
    scale: Values

    @staticmethod
    def of(network: RSNN, layer: int, *, plain: bool) -> "Neuron":
        """The neuron of the hidden layer (0) or of the readout (1); plain: as in CubaLIF."""
        alpha, beta, level = (float(part[layer].detach()) for part in (network.alpha, network.beta, network.threshold))
        how = CubaLIF("immediate", "hard") if plain else network.neuron
        return Neuron.new(alpha, beta, level, how)._replace(scale=beta if network.spec.membrane == "eq4" else 1.0)

    @staticmethod
    def new(alpha: Values, beta: Values, level: Values, how: CubaLIF) -> "Neuron":
        """The neurons of these constants per step."""
        late = 0 if how.membrane == "immediate" else 2
        return Neuron(alpha, beta, level, how.reset, late, beta if how.membrane == "eq4" else 1.0)

    @staticmethod
    def constants(nodes: dict[str, Any], layer: str, clock: Clock, reset: str) -> dict[str, np.ndarray]:
        """alpha, beta and threshold of each neuron of a layer, from the flat nodes that were made of them."""
        parts = {name.rsplit("/", 1)[-1] if "/" in name else "lif": node for name, node in nodes.items()
                 if name == layer or name.startswith(f"{layer}/")}  # fmt: skip
        if reset == "hard":
            lif = parts["lif"]
            taus, level = (lif.tau_syn, lif.tau_mem), lif.v_threshold
        else:
            membrane = parts["membrane"]
            taus = parts["synapse"].tau, membrane.tau
            level = membrane.v_threshold if reset == "zero" else parts["spike"].threshold
        alpha, beta = (1 - clock.dt_s / np.asarray(tau, np.float64) for tau in taus)
        return {"alpha": alpha, "beta": beta, "threshold": np.asarray(level, np.float64)}

    def nodes(self, clock: Clock, n: int) -> tuple[dict[str, Any], Edges, str, str]:
        """Nodes and edges of `n` neurons, the node that receives the input and the node that spikes."""
        if self.reset == "hard":
            return {"lif": clock.cuba(self.alpha, self.beta, self.threshold, n, self.scale)}, [], "lif", "lif"
        nodes = {"synapse": clock.leak(self.alpha, n, "alpha", self.scale)}
        if self.reset == "subtract":
            nodes |= {
                "membrane": clock.leak(self.beta, n, "beta"),
                "spike": threshold(self.threshold, n),
                "before": clock.delay(1, n),
                "reset": scale(-self.threshold, n),
            }
            edges = [("synapse", "membrane"), ("membrane", "spike"), ("spike", "before"), ("before", "reset")]
            return nodes, [*edges, ("reset", "membrane")], "synapse", "spike"
        nodes |= {
            "membrane": clock.lif(self.beta, self.threshold, n, "beta"),
            "spike": threshold(0.5, n),
            "before": clock.delay(1, n),
            "force": scale(FORCE, n),
            "veto": scale(-1.0, n),
        }
        edges = [
            ("synapse", "membrane"), ("membrane", "spike"), ("spike", "before"), ("before", "force"),
            ("force", "membrane"), ("before", "veto"), ("veto", "spike"),
        ]  # fmt: skip
        return nodes, edges, "synapse", "spike"


def of_network(network: RSNN, clock: Clock, *, plain: bool = False) -> Layered:
    """Nodes and edges from `input` (afferents) to `output`: readout spikes, or the running values of an integrator.

    plain: each layer as only CubaLIF and Linear, which snnTorch and Norse load; see `differences` for what is lost.
    """
    hidden, n_hidden = Neuron.of(network, 0, plain=plain), network.spec.hidden
    past, beside = _past(network, clock)
    if not n_hidden:
        return past, beside + chained(["sum", "level", "output"])
    nodes: dict[str, Any] = {"w_in": linear(array(network.w_in)), **past}
    if hidden.late:
        nodes["late"] = clock.delay(hidden.late, network.n_inputs)
    w_rec = None if network.w_rec is None else array(network.w_rec)
    delay = network.spec.recurrent_delay_steps
    nodes["hidden"] = layer_of(hidden, clock, n_hidden, w_rec, delay, plain=plain)
    nodes["w_out"] = linear(_w_out(network, plain=plain))
    path = ["input", *(["late"] if hidden.late else []), "w_in", "hidden"]
    if network.bias is not None:
        path += ["w_out"]
        if not plain:
            nodes |= _integrator(network, clock)
            path += ["sum", "level"]
        if network.w_stretch is not None and not plain:
            nodes["stretched"] = _stretched(network, network.w_stretch[:, :n_hidden], clock)
            beside += chained(["hidden", "stretched", "sum"])
        return nodes, chained([*path, "output"]) + beside
    readout = Neuron.of(network, 1, plain=plain)
    if readout.late:
        nodes["late_out"] = clock.delay(readout.late, n_hidden)
    nodes["readout"] = layer_of(readout, clock, network.n_classes, None, 0)
    return nodes, chained([*path, *(["late_out"] if readout.late else []), "w_out", "readout", "output"])


def _past(network: RSNN, clock: Clock) -> Layered:
    """What leads input spikes past the hidden layer into an integrator; nothing where it does not hear them."""
    if not network.spec.hears_afferents:
        return {}, []
    n_hidden, edges = network.spec.hidden, chained(["input", "w_direct", "sum"])
    nodes: dict[str, Any] = {"w_direct": linear(array(network.w_out[n_hidden:])), **_integrator(network, clock)}
    if network.w_stretch is not None:
        nodes["stretched_direct"] = _stretched(network, network.w_stretch[:, n_hidden:], clock)
        edges += chained(["input", "stretched_direct", "sum"])
    return nodes, edges


def _w_out(network: RSNN, *, plain: bool) -> np.ndarray:
    """Weights from hidden neurons `(hidden, class)`; plain, and of stretches: `(hidden, K class)`."""
    n_hidden = network.spec.hidden
    if plain and network.w_stretch is not None:
        return array(network.readout_weights[:, :n_hidden].transpose(0, 1).flatten(1))
    return array(network.w_out[:n_hidden])


def layer_of(neuron: Neuron, clock: Clock, n: int, w_rec: np.ndarray | None, delay: int, *, plain: bool = False) -> Any:
    """A layer: one node, or a graph if it is recurrent (`w_rec`, with a further `delay` in steps) or lowered."""
    nodes, edges, receives, spikes = neuron.nodes(clock, n)
    edges = [("input", receives), *edges]
    if w_rec is not None:
        nodes["w_rec"] = linear(w_rec)
        # Simulators support a cycle of one step; a longer one, or a lowered neuron, has its own delay.
        steps = 1 if plain else max(1, neuron.late) + delay
        feedback = [spikes, "w_rec", receives]
        if steps > 1 or neuron.reset != "hard":
            nodes["back"] = clock.delay(steps, n)
            feedback.insert(1, "back")
        edges += chained(feedback)
    elif not edges[1:]:
        return nodes["lif"]
    return graph(nodes, [*edges, (spikes, "output")], n, n)


def _integrator(network: RSNN, clock: Clock) -> dict[str, Any]:
    how = network.integration
    assert network.bias is not None
    assert how is not None
    bias = array(network.bias)
    adder = clock.leak(float(how.decay), len(bias), "readout_tau_ms") if how.leaks else clock.adder(len(bias))
    return {"sum": adder, "level": nir().Affine(weight=np.eye(len(bias)), bias=bias)}


def _stretched(network: RSNN, weights: torch.Tensor, clock: Clock) -> Any:
    """What spikes add through the weights of the present stretch, `(K, heard, class)`.

    `steps` counts to t + 1. A stretch k is `open` where `begun` and not `ended`: there alone spikes pass to `w<k>`.
    """
    how = network.stretches
    assert how is not None
    k, n, n_classes = weights.shape
    begins = how.steps * np.arange(k) + 0.5
    nodes: dict[str, Any] = {
        "one": nir().Affine(weight=np.zeros((k, n)), bias=np.ones(k)),
        "steps": clock.adder(k),
        "begun": nir().Threshold(threshold=begins),
        "ended": nir().Threshold(threshold=np.append(begins[1:], FORCE)),
        "not": scale(-1.0, k),
    }
    edges = chained(["input", "one", "steps", "begun"]) + chained(["steps", "ended", "not"])
    for index in range(k):
        names = gate, is_open, w = f"gate{index}", f"open{index}", f"w{index}"
        parts = linear(np.eye(k)[:, [index]] * np.ones(n)), threshold(1.5, n), linear(array(weights[index]))
        nodes |= dict(zip(names, parts, strict=True))
        edges += [("begun", gate), ("not", gate), (gate, is_open), ("input", is_open), (is_open, w), (w, "output")]
    return graph(nodes, edges, n, n_classes)


def differences(network: RSNN) -> list[str]:
    """The differences between the plain form and the network, in words; empty if there are none."""
    spec, lines = network.spec, []
    if spec.reset == "zero":
        lines.append("reset zero is written as hard: a neuron may spike again in the step after its spike")
    if spec.reset == "subtract":
        lines.append("reset subtract is written as hard: a membrane loses its value above the threshold")
    if spec.membrane != "immediate":
        back = " and its recurrent spikes return one step earlier" if spec.recurrent else ""
        lines.append(f"membrane {spec.membrane} is written as immediate: each layer responds two steps earlier{back}")
    if spec.recurrent and spec.recurrent_delay_steps:
        lines.append("the recurrent delay of one step is left out")
    if network.stretches is not None:
        k, steps = network.stretches
        lines.append(
            f"the output has the increments of all classes for each of {k} stretches of {steps} steps, stretch by "
            "stretch: take in each step those of its stretch"
        )
    if network.bias is not None:
        leak_ms = spec.readout_leak_ms
        decays = "" if leak_ms is None else f" with a decay of {leak_ms:g} ms"
        largest = ", and take the largest value over time" if spec.readout == "max" else ""
        lines.append(
            f"the output is the increment of an integrator in each step; sum it{decays}, from the bias on{largest}"
        )
    return lines


def chained(names: list[str]) -> Edges:
    """Edges from each node to the next."""
    return list(pairwise(names))


def array(values: torch.Tensor) -> np.ndarray:
    """Values as NumPy's."""
    return values.detach().cpu().numpy()
