"""Networks of several layers, and of a graph, as NIR's nodes and back."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from neurotact_parts.exporters.nir import execute
from neurotact_parts.exporters.nir.layers import Layered, Neuron, array, chained, layer_of
from neurotact_parts.exporters.nir.nodes import Clock, graph, linear, nir
from neurotact_parts.networks.graph import GraphNetwork
from neurotact_parts.networks.layered import Layered as LayeredNetwork
from torch import Tensor, nn

from neurotact.errors import InputError
from neurotact.networks.definition.module import ModuleNetwork


def of_module(network: ModuleNetwork, clock: Clock) -> Layered:
    """Nodes and edges from `input` to `output`."""
    module = network.module
    if isinstance(module, GraphNetwork):
        return _of_graph(module, clock)
    assert isinstance(module, LayeredNetwork)  # others are refused before
    return _of_layers(module, clock)


def load(network: ModuleNetwork, nodes: dict[str, Any], dt_s: float) -> None:
    """Set the values of a network of several layers to those of the flat nodes that were made of them."""
    module = network.module
    assert isinstance(module, LayeredNetwork)
    for name, value in _values_of_layers(module, nodes, Clock(dt_s)):
        own = module.get_parameter(name)
        own.data = execute.tensor(value, own)


# --- several layers ---------------------------------------------------------------------------------


def _of_layers(module: LayeredNetwork, clock: Clock) -> Layered:
    """Each layer: `w0`, `late0` where its neurons respond late, and `layer0`; a bias passes the delay, too."""
    nodes: dict[str, Any] = {}
    path, hidden = ["input"], list[Any](module.layers)
    for k, layer in enumerate(hidden):
        neuron, n = _neuron(layer), layer.w.shape[1]
        nodes[f"w{k}"] = _weights(layer)
        path.append(f"w{k}")
        if neuron.late:
            nodes[f"late{k}"] = clock.delay(neuron.late, n)
            path.append(f"late{k}")
        recurrent = None if layer.v is None else array(layer.v)
        nodes[f"layer{k}"] = layer_of(neuron, clock, n, recurrent, layer.neuron.recurrent_delay_steps)
        path.append(f"layer{k}")
    readout = module.readout
    nodes["w_out"] = _weights(readout)
    path.append("w_out")
    if module.level is not None:
        n = len(module.level)
        nodes |= {"sum": clock.adder(n), "level": nir().Affine(weight=np.eye(n), bias=array(module.level))}
        path += ["sum", "level"]
    else:
        neuron, n = _neuron(readout), readout.w.shape[1]
        if neuron.late:
            nodes["late_out"] = clock.delay(neuron.late, n)
            path.append("late_out")
        nodes["readout"] = layer_of(neuron, clock, n, None, 0)
        path.append("readout")
    return nodes, chained([*path, "output"])


def _neuron(layer: Any) -> Neuron:
    alpha, beta, threshold = (array(value).astype(np.float64) for value in (layer.alpha, layer.beta, layer.threshold))
    return Neuron.new(alpha, beta, threshold, layer.neuron)


def _weights(layer: Any) -> Any:
    if layer.bias is None:
        return linear(array(layer.w))
    return nir().Affine(weight=np.ascontiguousarray(array(layer.w).T), bias=array(layer.bias))


def _values_of_layers(module: LayeredNetwork, nodes: dict[str, Any], clock: Clock) -> Iterator[tuple[str, np.ndarray]]:
    """The parameters of each layer, by their names in the module."""
    if module.level is not None:
        yield "level", nodes["level"].bias
    names = [(f"layers.{k}", f"w{k}", f"layer{k}") for k in range(len(module.layers))]
    for name, w, layer in [*names, ("readout", "w_out", "readout")]:
        own = module.get_submodule(name)
        yield f"{name}.w", nodes[w].weight.T
        if getattr(own, "bias", None) is not None:
            yield f"{name}.bias", nodes[w].bias
        if getattr(own, "v", None) is not None:
            yield f"{name}.v", nodes[f"{layer}/w_rec"].weight.T
        if name == "readout" and module.level is not None:
            continue  # an integrator uses no constants of neurons
        for key, value in Neuron.constants(nodes, layer, clock, module.keys.reset).items():
            yield f"{name}.{key}", value[: getattr(own, key).numel()]


# --- graphs -----------------------------------------------------------------------------------------


def _of_graph(module: GraphNetwork, clock: Clock) -> Layered:
    keys = module.keys
    if keys.reset == "subtract":
        raise InputError("reset: NIR's neurons are reset to a value; a graph cannot say 'subtract'")
    ends = {keys.of_kind("Input")[0]: "input", keys.of_kind("Output")[0]: "output"}
    names = {name: ends.get(name, name.replace("/", ".")) for name in keys.names}  # a file has groups by name
    nodes = {names[name]: _node(kind, module.of_name[name], clock)
             for name, kind in zip(keys.names, keys.kinds, strict=True) if name not in ends}  # fmt: skip
    edges = [(names[a], names[b]) for a, b in keys.edges]
    made = execute.arranged(graph(nodes, edges, module.sizes.n_inputs, module.sizes.n_classes))
    return {name: node for name, node in made.nodes.items() if name not in ends.values()}, made.edges


def _node(kind: str, node: nn.Module, clock: Clock) -> Any:
    values = {name: array(value).astype(np.float64 if value.is_floating_point() else np.int64)
              for name, value in _named(node)}  # fmt: skip
    make = getattr(nir(), kind)
    if kind in ("Linear", "Affine", "Threshold"):
        return make(**{name: array(value) for name, value in _named(node)})
    if kind == "Scale":
        return make(scale=values["factor"])
    if kind == "Delay":
        return clock.delay(values["steps"], len(values["steps"]))
    adds = kind in ("I", "IF")
    tau = clock.dt_s if adds else clock.tau(values["beta"], "beta")
    made = {"r": values["h"] / clock.dt_s if adds else values["h"] * tau / clock.dt_s}
    if not adds:
        made |= {"tau_mem" if "alpha" in values else "tau": tau, "v_leak": values["leaked"] * tau / clock.dt_s}
    if "alpha" in values:
        made["tau_syn"] = clock.tau(values["alpha"], "alpha")
        made["w_in"] = values["g"] * made["tau_syn"] / clock.dt_s
    if "threshold" in values:
        made |= {"v_threshold": values["threshold"], "v_reset": values["v_reset"]}
    return make(**made)


def _named(node: nn.Module) -> Iterator[tuple[str, Tensor]]:
    yield from node.named_parameters()
    yield from node.named_buffers()
