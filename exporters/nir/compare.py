"""Where two implementations of a network first differ: the spike-exactness report."""

import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import redirect_stdout
from io import StringIO
from typing import Any

import numpy as np
import pandas as pd
import torch
from neurotact_parts.exporters.nir import graph as writing
from neurotact_parts.exporters.nir.execute import Interpreter, arranged
from neurotact_parts.exporters.nir.note import Note, of

from neurotact.data.conditioning import Conditioner
from neurotact.encoders import afferents
from neurotact.errors import InputError, nearest, optional
from neurotact.networks.definition.module import ModuleNetwork
from neurotact.networks.definition.readouts import Stretches
from neurotact.networks.definition.rsnn import RSNN

COLUMNS = (
    "simulator", "layer", "first_trial", "first_step", "first_neuron", "reference", "other", "spikes", "differing",
)  # fmt: skip
STEP_OF_SNNTORCH_S = 1e-4
"""The step that snnTorch's import uses, for any `dt` in the file."""
Layers = Mapping[str, np.ndarray]
"""Rasters `(trial, time, neuron)` by the name of their layer."""


def first_differences(reference: Layers, others: Mapping[str, Layers]) -> pd.DataFrame:
    """One row per layer and simulator.

    Columns: simulator, layer; first_trial, first_step, first_neuron and both values there, for the first step of the
    first trial that differs (None if all are equal); spikes of the reference; number of values that differ.

    >>> ours, theirs = np.zeros((1, 3, 2)), np.zeros((1, 3, 2))
    >>> theirs[0, 1, 1] = 1.0
    >>> row = first_differences({"hidden": ours}, {"other": {"hidden": theirs}}).iloc[0]
    >>> int(row.first_step), int(row.first_neuron), int(row.differing)
    (1, 1, 1)
    """
    rows = []
    for simulator, layers in others.items():
        for layer, raster in layers.items():
            expected = reference[layer]
            if raster.shape != expected.shape:
                raise InputError(f"{simulator}: '{layer}' is {raster.shape} where {expected.shape} is expected")
            places = np.argwhere(raster != expected)
            first = tuple(int(index) for index in places[0]) if len(places) else (None, None, None)
            values = (float(expected[first]), float(raster[first])) if len(places) else (None, None)
            rows.append((simulator, layer, *first, *values, int((expected != 0).sum()), len(places)))
    return pd.DataFrame(rows, columns=list(COLUMNS))


@torch.no_grad()
def report(
    network: RSNN | ModuleNetwork,
    graph: Any,
    spikes: np.ndarray,
    simulators: Sequence[str] = ("graph",),
    *,
    conditioned: np.ndarray | None = None,
    encoder: afferents.AfferentSpec | None = None,
) -> pd.DataFrame:
    """The spikes of a network compared with those of its graph in some simulators; columns as `first_differences`.

    graph: without afferents it receives `spikes` `(trial, time, afferent)`; with afferents, `conditioned` signals
        `(trial, time, taxel)`, which `encoder` encodes as `spikes`.
    simulators: "graph" (the interpreter), "snntorch", "norse"; the last two load only the plain form.
    """
    written = of(graph, "graph")
    simulated = network.simulate(torch.from_numpy(np.ascontiguousarray(spikes)))
    readout, integration = simulated.readout.detach().numpy(), network.integration
    rsnn = network if isinstance(network, RSNN) else None
    adds = isinstance(network, RSNN) or getattr(network.module, "level", None) is not None
    if integration is not None and adds and written is not None and written.form == "exact":
        readout = torch.stack([*integration.detach().over(simulated.readout.detach())], dim=1).numpy()
    reference = {"hidden": simulated.hidden.numpy()} if rsnn is not None and rsnn.spec.hidden else {}
    reference |= {"readout": readout}
    inputs = np.asarray(spikes, np.float64)
    if conditioned is not None:
        assert encoder is not None
        reference = {"afferents": np.asarray(spikes, np.float64), **reference}
        inputs = writing.signals(conditioned.astype(np.float64), network.sampling_rate_Hz)
    others = {}
    for name in simulators:
        if name not in SIMULATORS:
            raise InputError(f"simulator: '{name}' is unknown; {nearest(name, [*SIMULATORS])}")
        layers = SIMULATORS[name](graph, inputs, list(reference))
        if rsnn is not None and written is not None and written.form == "plain" and rsnn.stretches is not None:
            layers["readout"] = _of_stretches(layers["readout"], rsnn.stretches)
        if integration is not None and adds:
            layers["readout"] = _settled(layers["readout"], reference["readout"])
        others[name] = layers
    return first_differences(reference, others)


def _of_stretches(output: np.ndarray, stretches: Stretches) -> np.ndarray:
    """Of the outputs for each stretch, `(trial, time, K class)`, in each step those of its stretch."""
    n_steps = output.shape[1]
    apart = output.reshape(*output.shape[:2], stretches.number, -1)
    return apart[:, np.arange(n_steps), stretches.of_steps(n_steps).numpy()]


def conditioned_trial(signal: np.ndarray, encoder: afferents.AfferentSpec, rate_Hz: float) -> np.ndarray:
    """The conditioned signal of a trial `(sample, taxel)`, which the afferents receive, `(1, time, taxel)`."""
    return Conditioner(rate_Hz, encoder.conditioning).whole(np.asarray(signal, np.float32))[None]


def _settled(sums: np.ndarray, expected: np.ndarray) -> np.ndarray:
    """The sums, with those of the reference where they differ only by rounding."""
    return np.where(np.isclose(sums, expected, rtol=1e-5, atol=1e-5), expected, sums)


def _interpreted(graph: Any, inputs: np.ndarray, layers: Sequence[str]) -> dict[str, np.ndarray]:
    written = of(graph, "graph")
    dt_s = float(graph.metadata["dt"]) if written is None else written.dt_s
    names = {layer: "output" if layer == "readout" else layer for layer in layers}
    outputs = Interpreter(graph, dt_s).run(inputs, tuple(names.values()))
    return {layer: outputs[name] for layer, name in names.items()}


def _by_snntorch(graph: Any, inputs: np.ndarray, layers: Sequence[str]) -> dict[str, np.ndarray]:
    loader = optional("snntorch.import_nir", "snntorch: its import cannot be loaded ({}); pip install nirtorch")
    written = _loadable(graph, "snntorch")
    if written is not None and not np.isclose(written.dt_s, STEP_OF_SNNTORCH_S):
        raise InputError("snntorch: uses steps of 1e-4 s for any file; write it with `dt_s=1e-4`")
    with redirect_stdout(StringIO()):  # it prints its progress
        model = loader.import_from_nir(arranged(graph))
    return _stepped(model, inputs, layers)


def _by_norse(graph: Any, inputs: np.ndarray, layers: Sequence[str]) -> dict[str, np.ndarray]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # deprecated calls, on its own import and on that of a graph
        norse = optional("norse.torch", "norse: cannot be imported ({}); pip install --no-deps norse nirtorch")
        _loadable(graph, "norse")
        return _stepped(norse.from_nir(graph, dt=float(graph.metadata["dt"])), inputs, layers)


def _loadable(graph: Any, simulator: str) -> Note | None:
    kinds = {type(node).__name__ for node in graph.nodes.values()}
    unknown = kinds - {"Input", "Output", "Linear", "Affine", "CubaLIF", "LIF", "NIRGraph"}
    if unknown:
        raise InputError(f"{simulator}: has no {sorted(unknown)[0]}; write the plain form, `plain=True`")
    return of(graph, "graph")


@torch.no_grad()
def _stepped(model: Any, spikes: np.ndarray, layers: Sequence[str]) -> dict[str, np.ndarray]:
    """Rasters of a torch module that computes one step from its state; the trials are one batch."""
    outputs: dict[str, list[np.ndarray]] = {layer: [] for layer in layers}

    def record(layer: str) -> Callable[..., None]:
        return lambda module, inputs, output: outputs[layer].append(_first(output))

    hooks = [getattr(model, layer).register_forward_hook(record(layer)) for layer in layers if layer != "readout"]
    state = None
    for step in torch.from_numpy(spikes.astype(np.float32)).unbind(dim=1):
        output, state = model(step, state)
        outputs["readout"].append(_first(output))
    for hook in hooks:
        hook.remove()
    return {layer: np.stack(rows, axis=1) for layer, rows in outputs.items()}


def _first(output: Any) -> np.ndarray:
    return (output[0] if isinstance(output, tuple) else output).numpy().copy()


SIMULATORS: dict[str, Callable[[Any, np.ndarray, Sequence[str]], dict[str, np.ndarray]]] = {
    "graph": _interpreted, "snntorch": _by_snntorch, "norse": _by_norse,
}  # fmt: skip
