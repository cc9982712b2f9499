"""From a NIR graph to a network: a graph of neurotact, or of another simulator.

A graph of neurotact is marked in its metadata. The network is built from the nodes' values and written to a graph
again, and both graphs are compared node by node: metadata never override the nodes.
"""

import logging
import math
from typing import Any, NamedTuple

import numpy as np
import torch
from neurotact_parts.exporters.nir import modules, note
from neurotact_parts.exporters.nir.execute import flat, joined, keys_of, load, neurons, width
from neurotact_parts.exporters.nir.layers import Neuron
from neurotact_parts.exporters.nir.nodes import Clock
from neurotact_parts.exporters.nir.note import REFRACTORY, Note
from neurotact_parts.exporters.snntorch import tau_ms
from neurotact_parts.networks.graph import GraphNetwork, OwnReset
from neurotact_parts.streams.chain import encoder_of

from neurotact.backend import Backend
from neurotact.encoders.afferents import AfferentSpec
from neurotact.encoders.model import EncoderSpec
from neurotact.errors import InputError
from neurotact.networks.definition import module
from neurotact.networks.definition.network import Network
from neurotact.networks.definition.rsnn import RSNN
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.networks.exit.rule import ExitRule
from neurotact.networks.training.run_folder import shapes_of
from neurotact.spec import build

log = logging.getLogger("neurotact")
CLOSE = 1e-9
"""Relative tolerance, for rounding, between a value in a file of neurotact and the value that it writes again."""


class FromNIR(NamedTuple):
    """The content of a NIR file: a network; in files of neurotact also the encoder, the exit rule and the classes."""

    network: Network
    encoder: EncoderSpec | None
    rule: ExitRule
    classes: tuple[str, ...]


def parsed(
    graph: Any,
    dt_s: float | None,
    source: str,
    sampling_rate_Hz: float | None = None,
    backend: Backend = "auto",
    reset: OwnReset = "to-value",
) -> FromNIR:
    """The network of a graph; `dt_s`: its step, if its metadata have none. `source`: for messages."""
    try:
        written = note.of(graph, source)
        if written is not None:
            _check_stated("dt_s", dt_s, written.dt_s, source)
            _check_stated("sampling_rate_Hz", sampling_rate_Hz, written.sampling_rate_Hz, source)
            if reset != "to-value":
                raise InputError(f"reset: {source} states that of its network; leave reset out")
            return _from_neurotact(graph, written, source, backend)
        step_s = _step(graph, dt_s, source)
        network = _from_other(graph, step_s, sampling_rate_Hz or 1.0 / step_s, source, backend, reset)
    except (KeyError, AttributeError, IndexError, TypeError, ValueError, OverflowError) as error:
        if isinstance(error, InputError):
            raise
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(f"{source}: is not a network of neurotact's kind ({reason[:200]!a})") from error
    return FromNIR(network, None, ExitRule(), tuple(str(index) for index in range(network.n_classes)))


def _step(graph: Any, dt_s: float | None, source: str) -> float:
    stated = graph.metadata.get("dt") if isinstance(graph.metadata, dict) else None
    step_s = dt_s if stated is None else float(stated)
    if stated is not None:
        _check_stated("dt_s", dt_s, float(stated), source)
    if step_s is None:
        raise InputError(
            f"{source}: does not contain its step, on which the decays depend; give dt_s (snnTorch's files have 1e-4)"
        )
    if not 1e-12 < step_s < 1e6:
        raise InputError(f"{source}: a step of {step_s:g} s is not possible; give dt_s")
    return step_s


def _check_stated(name: str, given: float | None, stated: float, source: str) -> None:
    """Refuse an argument that differs from what the file says of itself."""
    if given is not None and not math.isclose(given, stated, rel_tol=CLOSE):
        raise InputError(f"{name}: {given:g} is given, but {source} states {stated:g}; leave {name} out")


# --- neurotact's own --------------------------------------------------------------------------------


def _from_neurotact(graph: Any, written: Note, source: str, backend: Backend) -> FromNIR:
    from neurotact_parts.exporters.nir import graph as writing

    if written.form != "exact":
        raise InputError(
            f"{source}: is the plain form of a network, with {len(written.differences)} differences from it; read "
            "a file without `plain`, or remove the note 'neurotact' from its metadata to read the plain network"
        )
    spec = build(RSNNSpec, written.network, source=f"{source}, network")
    checked = True
    if spec.own is not None:
        network, checked = _module_of(graph, spec, written, source, backend)
    else:
        network = _rsnn_of(flat(graph)[0], spec, written, source, backend)
    encoder = None
    if written.encoder is not None:
        encoder = build(AfferentSpec, written.encoder, source=f"{source}, encoder")
    if checked:
        again = writing.of(
            network, encoder, rule=written.rule, classes=written.classes, dt_s=written.dt_s,
            lower_refractory=written.lowered,
        )  # fmt: skip
        _check_same(graph, again, source)
    whole = encoder if written.encoder_outside is None else encoder_of(written.encoder_outside, source)
    return FromNIR(_on_input_clock(network, written), whole, written.rule, written.classes)


def _module_of(
    graph: Any, spec: RSNNSpec, written: Note, source: str, backend: Backend
) -> tuple[module.ModuleNetwork, bool]:
    """A network of several layers or of a graph, and whether it can differ from its file."""
    nodes, edges = flat(graph)
    is_double = any(node.weight.dtype == np.float64 for node in nodes.values() if hasattr(node, "weight"))
    dtype = torch.float64 if is_double else torch.float32
    if spec.model == "graph":
        if written.encoder is not None:
            raise InputError(f"{source}: a network of model 'graph' behind afferents is not read; export it alone")
        return _as_graph(
            *joined(nodes, edges), written.dt_s, written.sampling_rate_Hz, source, backend, dtype=dtype
        ), False
    n_inputs, n_classes = width(nodes["w0"].input_type), width(nodes["output"].input_type)
    network = module.new(n_inputs, n_classes, spec, written.sampling_rate_Hz, backend=backend, dtype=dtype)
    assert isinstance(network, module.ModuleNetwork)
    modules.load(network, nodes, written.dt_s)
    return network, True


def _rsnn_of(nodes: dict[str, Any], spec: RSNNSpec, written: Note, source: str, backend: Backend) -> RSNN:
    into, *out = (
        nodes[name].weight.T
        for name, is_there in (("w_in", spec.hidden), ("w_out", spec.hidden), ("w_direct", spec.hears_afferents))
        if is_there
    )
    if not spec.hidden:
        into, out = into[:, :0], [into]
    dtype = torch.float64 if into.dtype == np.float64 else torch.float32
    n_inputs, n_classes = into.shape[0], out[0].shape[1]
    if (spec.hidden, n_classes) != (into.shape[1], len(written.classes)):
        raise InputError(f"{source}: its weights do not match its note; write it again")
    clock = Clock(written.dt_s)
    hidden, readout = _dynamics(nodes, "hidden", clock, spec), _dynamics(nodes, "readout", clock, spec)
    values = {
        "w_in": into, "w_out": np.concatenate(out),
        **({"w_rec": nodes["hidden/w_rec"].weight.T} if spec.recurrent else {}),
        **({"bias": nodes["level"].bias} if spec.integrates else {}),
        **({"w_stretch": _stretches(nodes, spec.readout_stretches)} if spec.readout_stretches > 1 else {}),
        **{
            name: np.array([a if a is not None else c, b if b is not None else c])
            for name, a, b, c in zip(("alpha", "beta", "threshold"), hidden, readout, written.unused, strict=True)
        },
    }  # fmt: skip
    return _network(spec, n_inputs, n_classes, written.sampling_rate_Hz, values, dtype, backend, source)


def _on_input_clock(network: Network, written: Note) -> Network:
    """The network for spikes that it puts into bins itself, if a file was written of such a one."""
    if written.step_ms is None or written.input_Hz is None:
        return network
    spec = network.spec.model_copy(update={"step_ms": written.step_ms})
    sizes, how = (network.n_inputs, network.n_classes), {"backend": network.backend, "dtype": network.dtype}
    binning = module.new(*sizes, spec, written.input_Hz, **how, generator=torch.Generator())
    binning.load_state_dict(network.state_dict())
    return binning


def _stretches(nodes: dict[str, Any], k: int) -> np.ndarray:
    """The weights of each stretch, `(K, heard, class)`."""
    parts = [name for name in ("stretched", "stretched_direct") if f"{name}/w0" in nodes]
    return np.stack([np.concatenate([nodes[f"{name}/w{i}"].weight.T for name in parts]) for i in range(k)])


def _dynamics(nodes: dict[str, Any], layer: str, clock: Clock, spec: RSNNSpec) -> tuple[Any, Any, Any]:
    """alpha, beta and threshold of a layer; None for an integrator, and without a hidden layer."""
    if spec.integrates if layer == "readout" else not spec.hidden:
        return None, None, None
    alpha, beta, level = (float(each[0]) for each in Neuron.constants(nodes, layer, clock, spec.reset).values())
    return alpha, beta, level


def _check_same(graph: Any, rewritten: Any, source: str) -> None:
    """Refuse a graph that differs from the one that neurotact writes for its network."""
    (nodes, edges), (expected, expected_edges) = flat(graph), flat(rewritten)
    changed = sorted(set(nodes) ^ set(expected)) or sorted({str(e) for e in set(edges) ^ set(expected_edges)})
    for name in [] if changed else expected:
        wanted, read = expected[name].to_dict(), nodes[name].to_dict()
        for key, value in wanted.items():
            if key == "metadata":
                continue
            changed += [] if _is_same(value, read.get(key)) else [f"{name}.{key}"]
    if changed:
        raise InputError(
            f"{source}: was changed since neurotact wrote it ({changed[0][:80]!a}); remove the note 'neurotact' from "
            "its metadata to read it as a graph of another simulator"
        )


def _is_same(value: Any, other: Any) -> bool:
    a, b = np.asarray(value), np.asarray(other)
    if a.dtype.kind in "fiu" and b.dtype.kind in "fiu":
        return a.shape == b.shape and np.allclose(a, b, rtol=CLOSE, atol=0)
    return str(a) == str(b)


# --- others' ----------------------------------------------------------------------------------------


def _from_other(graph: Any, dt_s: float, rate_Hz: float, source: str, backend: Backend, reset: OwnReset) -> Network:
    """An RSNN of Linear, CubaLIF (or a graph of it with a recurrent Linear), Linear, CubaLIF; else a `GraphNetwork`."""
    nodes, edges = joined(*flat(graph))
    _check_whole(nodes, source)
    try:
        if reset == "to-value":
            return _as_rsnn(nodes, edges, dt_s, rate_Hz, source, backend)
    except _UnlikeError as why:
        log.info("%s: is read as a network of model 'graph': %s", source, why)
    return _as_graph(nodes, edges, dt_s, rate_Hz, source, backend, reset)


def _as_graph(
    nodes: dict[str, Any], edges: list[tuple[str, str]], dt_s: float, rate_Hz: float, source: str, backend: Backend,
    reset: OwnReset = "to-value", dtype: torch.dtype = torch.float32,
) -> module.ModuleNetwork:  # fmt: skip
    keys, values = keys_of(nodes, edges, dt_s)
    if not all(np.isfinite(value).all() for those in values.values() for value in those.values()):
        raise InputError(f"{source}: has values that are not finite")
    table = {"model": "graph", **keys.model_dump(mode="json", exclude_defaults=True), "reset": reset}
    spec = build(RSNNSpec, table, source=source)
    (begin,), (end,) = (keys.of_kind(kind) for kind in ("Input", "Output"))
    sizes = keys.widths[keys.names.index(begin)][0], keys.widths[keys.names.index(end)][1]
    network = module.new(*sizes, spec, rate_Hz, backend=backend, dtype=dtype)
    assert isinstance(network, module.ModuleNetwork)
    assert isinstance(network.module, GraphNetwork)
    load(network.module, values)
    return network


def _check_whole(nodes: dict[str, Any], source: str) -> None:
    """Refuse a graph without one input and one output, and what metadata say that would be lost."""
    for kind in ("Input", "Output"):
        n = sum(type(node).__name__ == kind for node in nodes.values())
        if n != 1:
            raise InputError(f"{source}: has {n} {kind} nodes; a network has one")
    for name, node in nodes.items():
        if np.any((getattr(node, "metadata", None) or {}).get(REFRACTORY, 0)):
            raise InputError(
                f"{source}: '{name}' has a {REFRACTORY} in its metadata, which the nodes do not have; take it out, or "
                "write it as nodes (`lower_refractory`)"
            )


class _UnlikeError(Exception):
    """Why a graph is no RSNN."""


def _as_rsnn(
    nodes: dict[str, Any], edges: list[tuple[str, str]], dt_s: float, rate_Hz: float, source: str, backend: Backend
) -> RSNN:
    endpoints = {name for name, node in nodes.items() if type(node).__name__ in ("Input", "Output")}
    path = _path(nodes, edges, endpoints)
    if len(path.chain) != 4:
        raise _UnlikeError(f"its chain has {len(path.chain)} nodes, not Linear, CubaLIF, Linear, CubaLIF")
    fc_in, hidden, fc_out, readout = (nodes[name] for name in path.chain)
    recurrent = None if path.recurrent is None else nodes[path.recurrent]
    layers = [_layer(node, name, dt_s) for name, node in zip(path.chain[1::2], (hidden, readout), strict=True)]
    w_in, w_out = (_weights(node) * layer.scale[:, None] for node, layer in zip((fc_in, fc_out), layers, strict=True))
    values = {
        "w_in": w_in.T, "w_out": w_out.T,
        "alpha": np.array([layer.alpha for layer in layers]), "beta": np.array([layer.beta for layer in layers]),
        "threshold": np.ones(2),
    }  # fmt: skip
    if recurrent is not None:
        values["w_rec"] = (_weights(recurrent) * layers[0].scale[:, None]).T
    spec = build(
        RSNNSpec,
        {
            "model": "snn" if recurrent is None else "rsnn", "hidden": len(w_in), "membrane": "immediate",
            "reset": "hard", "tau_mem_ms": tau_ms(layers[0].beta, rate_Hz),
            "tau_syn_ms": tau_ms(layers[0].alpha, rate_Hz),
        },
        source=source,
    )  # fmt: skip
    return _network(spec, w_in.shape[1], len(w_out), rate_Hz, values, torch.float32, backend, source)


class _Path(NamedTuple):
    chain: list[str]
    recurrent: str | None


def _path(nodes: dict[str, Any], edges: list[tuple[str, str]], endpoints: set[str]) -> _Path:
    """The computing nodes from input to output, and the recurrent one of the first neurons."""
    following: dict[str, list[str]] = {name: [b for a, b in edges if a == name] for name in nodes}
    node, chain, recurrent = (
        next(name for name in nodes if type(nodes[name]).__name__ == "Input"),
        [],
        None,
    )
    while True:
        after = following[node]
        back = [key for key in after if node in following[key] and type(nodes[key]).__name__ in ("Linear", "Affine")]
        if back and recurrent is None and type(nodes[node]).__name__ == "CubaLIF":
            recurrent = back[0]
            if following[recurrent] != [node]:
                raise _UnlikeError(f"'{recurrent}' leads to more than one node")
        after = [key for key in after if key != recurrent]
        if not after:
            break
        if len(after) != 1 or len(chain) > 8:
            raise _UnlikeError(f"'{node}' leads to {len(after)} nodes")
        node = after[0]
        chain += [] if node in endpoints else [node]
    if len(nodes) != len(chain) + len(endpoints) + (recurrent is not None):
        raise _UnlikeError("it has nodes outside its chain of layers")
    if recurrent is not None and recurrent in chain[2:]:
        raise _UnlikeError("its readout is recurrent")
    return _Path(chain, recurrent)


class _Layer(NamedTuple):
    alpha: float
    beta: float
    scale: np.ndarray


def _layer(node: Any, name: str, dt_s: float) -> _Layer:
    """Decays, and the factor of the weights into each neuron that makes its threshold 1."""
    if type(node).__name__ != "CubaLIF":
        raise _UnlikeError(f"'{name}' is a {type(node).__name__}")
    values = neurons(node, dt_s, name)
    for key in ("leaked", "v_reset"):
        if values[key].any():
            raise _UnlikeError(f"'{name}' has a v_leak or a v_reset other than 0")
    for key in ("alpha", "beta"):
        if (values[key] != values[key][0]).any():
            raise _UnlikeError(f"'{name}' has a different {key} for each neuron")
    if not (values["threshold"] > 0).all() or (values["g"] != 1).any() or (values["h"] != 1).any():
        raise _UnlikeError(f"'{name}' has a threshold or a weight that is not positive")
    return _Layer(values["alpha"][0], values["beta"][0], 1.0 / values["threshold"])


def _weights(node: Any) -> np.ndarray:
    if type(node).__name__ not in ("Linear", "Affine") or node.weight.ndim != 2:
        raise _UnlikeError(f"it has a {type(node).__name__} where a Linear is expected")
    if np.any(getattr(node, "bias", 0)):
        raise _UnlikeError("a projection has a bias")
    return np.asarray(node.weight, np.float64)


def _network(
    spec: RSNNSpec, n_inputs: int, n_classes: int, rate_Hz: float, values: dict[str, np.ndarray], dtype: torch.dtype,
    backend: Backend, source: str,
) -> RSNN:  # fmt: skip
    network = RSNN(n_inputs, n_classes, spec, rate_Hz, backend=backend, generator=torch.Generator(), dtype=dtype)
    tensors = {}
    for name, shape in shapes_of(spec, n_inputs, n_classes).items():
        tensor = torch.from_numpy(np.array(values[name], np.float64)).to(dtype)
        if tuple(tensor.shape) != shape or not tensor.isfinite().all():
            raise InputError(f"{source}: '{name}' is {tuple(tensor.shape)} where finite {shape} is expected")
        tensors[name] = tensor
    network.load_state_dict(tensors)
    return network
