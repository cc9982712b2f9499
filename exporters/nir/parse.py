"""From a NIR graph to a network: a graph of neurotact, or of another simulator.

A graph of neurotact is marked in its metadata. The network is built from the nodes' values and written to a graph
again, and both graphs are compared node by node: metadata never override the nodes.
"""

import math
from typing import Any, NamedTuple

import numpy as np
import torch
from neurotact_parts.exporters.nir import note
from neurotact_parts.exporters.nir.execute import flat
from neurotact_parts.exporters.nir.nodes import Clock
from neurotact_parts.exporters.nir.note import Note
from neurotact_parts.exporters.snntorch import tau_ms

from neurotact.backend import Backend
from neurotact.encoders.afferents import AfferentSpec
from neurotact.errors import InputError
from neurotact.networks.definition.rsnn import RSNN
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.networks.exit.rule import ExitRule
from neurotact.networks.training.run_folder import shapes_of
from neurotact.spec import build

CLOSE = 1e-9
"""Relative tolerance, for rounding, between a value in a file of neurotact and the value that it writes again."""


class FromNIR(NamedTuple):
    """The content of a NIR file: a network; in files of neurotact also the encoder, the exit rule and the classes."""

    network: RSNN
    encoder: AfferentSpec | None
    rule: ExitRule
    classes: tuple[str, ...]


def parsed(
    graph: Any,
    dt_s: float | None,
    source: str,
    sampling_rate_Hz: float | None = None,
    backend: Backend = "auto",
) -> FromNIR:
    """The network of a graph; `dt_s`: its step, if its metadata have none. `source`: for messages."""
    try:
        written = note.of(graph, source)
        if written is not None:
            _check_stated("dt_s", dt_s, written.dt_s, source)
            _check_stated("sampling_rate_Hz", sampling_rate_Hz, written.sampling_rate_Hz, source)
            return _from_neurotact(graph, written, source, backend)
        step_s = _step(graph, dt_s, source)
        network = _from_other(graph, step_s, sampling_rate_Hz or 1.0 / step_s, source, backend)
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
    nodes, _ = flat(graph)
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
        **{
            name: np.array([a if a is not None else c, b if b is not None else c])
            for name, a, b, c in zip(("alpha", "beta", "threshold"), hidden, readout, written.unused, strict=True)
        },
    }  # fmt: skip
    network = _network(spec, n_inputs, n_classes, written.sampling_rate_Hz, values, dtype, backend, source)
    encoder = None
    if written.encoder is not None:
        encoder = build(AfferentSpec, written.encoder, source=f"{source}, encoder")
    again = writing.of(
        network, encoder, rule=written.rule, classes=written.classes, dt_s=written.dt_s,
        lower_refractory=written.lowered,
    )  # fmt: skip
    _check_same(graph, again, source)
    return FromNIR(network, encoder, written.rule, written.classes)


def _dynamics(nodes: dict[str, Any], layer: str, clock: Clock, spec: RSNNSpec) -> tuple[Any, Any, Any]:
    """alpha, beta and threshold of a layer; None for an integrator, and without a hidden layer."""
    if spec.integrates if layer == "readout" else not spec.hidden:
        return None, None, None
    parts = {name.rsplit("/", 1)[-1] if "/" in name else "lif": node for name, node in nodes.items()
             if name == layer or name.startswith(f"{layer}/")}  # fmt: skip
    if spec.reset == "hard":
        lif = parts["lif"]
        alpha, beta = (1 - clock.dt_s / float(tau[0]) for tau in (lif.tau_syn, lif.tau_mem))
        return alpha, beta, float(lif.v_threshold[0])
    synapse, membrane = parts["synapse"], parts["membrane"]
    level = membrane.v_threshold if spec.reset == "zero" else parts["spike"].threshold
    return 1 - clock.dt_s / float(synapse.tau[0]), 1 - clock.dt_s / float(membrane.tau[0]), float(level[0])


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


def _from_other(graph: Any, dt_s: float, rate_Hz: float, source: str, backend: Backend) -> RSNN:
    """Input, Linear, CubaLIF (or a graph of it with a recurrent Linear), Linear, CubaLIF, Output."""
    nodes, edges = flat(graph)
    endpoints = {name for name, node in nodes.items() if type(node).__name__ in ("Input", "Output")}
    path = _path(nodes, edges, endpoints, source)
    if len(path.chain) != 4:
        kinds = ", ".join(type(nodes[name]).__name__ for name in path.chain)
        raise InputError(f"{source}: must be Linear, CubaLIF, Linear, CubaLIF; found {kinds or 'nothing'}")
    fc_in, hidden, fc_out, readout = (nodes[name] for name in path.chain)
    recurrent = None if path.recurrent is None else nodes[path.recurrent]
    layers = [_layer(node, name, dt_s, source) for name, node in zip(path.chain[1::2], (hidden, readout), strict=True)]
    w_in, w_out = (
        _weights(node, source) * layer.scale[:, None] for node, layer in zip((fc_in, fc_out), layers, strict=True)
    )
    values = {
        "w_in": w_in.T, "w_out": w_out.T,
        "alpha": np.array([layer.alpha for layer in layers]), "beta": np.array([layer.beta for layer in layers]),
        "threshold": np.ones(2),
    }  # fmt: skip
    if recurrent is not None:
        values["w_rec"] = (_weights(recurrent, source) * layers[0].scale[:, None]).T
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


def _path(nodes: dict[str, Any], edges: list[tuple[str, str]], endpoints: set[str], source: str) -> _Path:
    """The computing nodes from input to output, and the recurrent one of the first neurons."""
    following: dict[str, list[str]] = {name: [b for a, b in edges if a == name] for name in nodes}
    node, chain, recurrent = (
        next(name for name in nodes if type(nodes[name]).__name__ == "Input" and "/" not in name),
        [],
        None,
    )
    while True:
        after = following[node]
        back = [key for key in after if node in following[key] and type(nodes[key]).__name__ in ("Linear", "Affine")]
        if back and recurrent is None and type(nodes[node]).__name__ == "CubaLIF":
            recurrent = back[0]
            if following[recurrent] != [node]:
                raise InputError(f"{source}: '{recurrent}' leads to more than one node, which is not a recurrence")
        after = [key for key in after if key != recurrent]
        if not after:
            break
        if len(after) != 1 or len(chain) > 8:
            raise InputError(f"{source}: '{node}' leads to {len(after)} nodes where a chain of layers is expected")
        node = after[0]
        chain += [] if node in endpoints else [node]
    if len(nodes) != len(chain) + len(endpoints) + (recurrent is not None):
        raise InputError(f"{source}: has nodes outside its chain of layers")
    if recurrent is not None and recurrent in chain[2:]:
        raise InputError(f"{source}: the readout is recurrent, which is not supported")
    return _Path(chain, recurrent)


class _Layer(NamedTuple):
    alpha: float
    beta: float
    scale: np.ndarray


def _layer(node: Any, name: str, dt_s: float, source: str) -> _Layer:
    """Decays, and the factor of the weights into each neuron that makes its threshold 1."""
    if type(node).__name__ != "CubaLIF":
        raise InputError(f"{source}: '{name}' is a {type(node).__name__} where a CubaLIF is expected")
    values = {
        key: np.asarray(getattr(node, key), np.float64).ravel()
        for key in ("tau_syn", "tau_mem", "r", "w_in", "v_threshold", "v_leak", "v_reset")
    }
    for key in ("v_leak", "v_reset"):
        if values[key].any():
            raise InputError(f"{source}: '{name}' has a {key} other than 0, which is not supported")
    for key in ("tau_syn", "tau_mem"):
        if (values[key] != values[key][0]).any():
            raise InputError(f"{source}: '{name}' has a different {key} for each neuron; neurotact's layers have one")
    if not all((values[key] > 0).all() for key in ("tau_syn", "tau_mem", "v_threshold")):
        raise InputError(f"{source}: '{name}' has a time constant or threshold that is not positive")
    alpha, beta = (1.0 - dt_s / values[key][0] for key in ("tau_syn", "tau_mem"))
    if min(alpha, beta) < -1e-9:
        raise InputError(f"{source}: '{name}' has a time constant below the step of {dt_s:g} s; give another dt_s")
    scale = dt_s / values["tau_syn"] * values["w_in"] * dt_s / values["tau_mem"] * values["r"] / values["v_threshold"]
    return _Layer(max(alpha, 0.0), max(beta, 0.0), scale)


def _weights(node: Any, source: str) -> np.ndarray:
    if type(node).__name__ not in ("Linear", "Affine") or node.weight.ndim != 2:
        raise InputError(f"{source}: has a {type(node).__name__} where a Linear is expected")
    if np.any(getattr(node, "bias", 0)):
        raise InputError(f"{source}: a projection has a bias that is not zero, which is not supported")
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
