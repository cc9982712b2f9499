"""Exchange with NIR, for users: `nt.to_nir`, `nt.from_nir`, and the proof of an export."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from neurotact import effects
from neurotact.backend import Backend
from neurotact.data.recordings import Recordings
from neurotact.encoders import afferents
from neurotact.encoders.afferents import AfferentSpec
from neurotact.encoders.encoding import encode_recordings
from neurotact.encoders.model import EncoderSpec
from neurotact.errors import InputError
from neurotact.lazily import lazily
from neurotact.networks.use.exporters import Exporter
from neurotact.progress import Tell, untold

with lazily():
    import pandas as pd
    from neurotact_parts.exporters import trials as test_trials
    from neurotact_parts.exporters.nir import compare, execute, file, graph, note, parse
    from neurotact_parts.networks import graph as graphs
    from neurotact_parts.streams import chain as chains

    from neurotact.networks.definition import executors, module, rsnn
    from neurotact.networks.definition import network as definition
    from neurotact.networks.exit import rule as exit_rule
    from neurotact.networks.use import fitted


log = logging.getLogger("neurotact")


def to_nir(
    source: fitted.Fitted | rsnn.RSNN | module.ModuleNetwork | tuple[EncoderSpec, rsnn.RSNN | module.ModuleNetwork],
    path: str | Path | None = None,
    *,
    plain: bool = False,
    lower_refractory: bool = False,
    network_only: bool = False,
    dt_s: float | None = None,
    force: bool = False,
) -> Any:
    """The graph of a network, or of an encoder and a network, in the Neuromorphic Intermediate Representation.

    source: a run folder that `train` wrote, or a fitted `SpikingClassifier` or pipeline (its encoder included unless
        `network_only`, if it has one), a network, or an encoder and a network.
    path: a file to write (HDF5); an existing one is refused unless `force`.
    plain: only CubaLIF and Linear, which snnTorch and Norse load; exact for membrane `immediate` with reset `hard`.
        For any other, the graph's note contains the differences. lower_refractory: afferents' refractory periods as
        nodes; by default they are only in the note, since NIR's neurons have none.
    What a graph cannot hold stays outside, as a warning and the graph's note say: conditioning, early exit, the rule of
    a detector, encoders other than LIF afferents, and of a network with a `step_ms` the encoder and the bins: the graph
    takes spikes in bins of that length, `network.binned`.
    dt_s: seconds per step; None: 1 / clock. snnTorch requires 1e-4: time constants are scaled with it.
    Raises InputError for what a graph cannot represent: decays of 1, thresholds that adapt.

    >>> net = rsnn.RSNN(16, 8, hidden=20, sampling_rate_Hz=2000.0)
    >>> sorted(to_nir(net).nodes)  # doctest: +SKIP
    ['hidden', 'input', 'late', 'late_out', 'output', 'readout', 'w_in', 'w_out']
    """
    rule, classes, outside = exit_rule.FULL_WINDOW, None, graph.Outside()
    if isinstance(source, (rsnn.RSNN, module.ModuleNetwork)):
        encoder, network = None, source
    elif isinstance(source, tuple):
        encoder, network = source
    else:
        restored = fitted.restore(source)
        network = restored.network
        rule, classes, outside = restored.exits(), restored.classes, outside._replace(detector=restored.detector)
        encoder = chains.front_of(restored) if restored.encoder is not None else None
    form = "nir-plain" if plain else "nir"
    if encoder is not None:
        why = "as asked" if network_only else executors.left_outside(form, executors.Subject(encoder, network))
        encoder, outside = (encoder, outside) if why is None else (None, outside._replace(encoder=encoder, why=why))
    if network.steps_per_bin > 1:
        outside = outside._replace(step_ms=1e3 / network.clock_Hz, input_Hz=network.sampling_rate_Hz)
    executors.require(form, executors.Subject(encoder, network))
    assert isinstance(network, (rsnn.RSNN, module.ModuleNetwork))  # as all networks are
    assert encoder is None or isinstance(encoder, AfferentSpec)  # others are left outside
    exported = graph.of(
        network.on_own_clock(),
        encoder,
        rule=rule,
        classes=classes,
        dt_s=dt_s,
        plain=plain,
        lower_refractory=lower_refractory,
        outside=outside,
    )
    if lines := outside.lines(encoder, rule):
        log.warning("%s: outside the graph stay %s", "graph" if path is None else path, "; ".join(lines))
    if path is not None:
        file.write(exported, path, force=force)
    return exported


def from_nir(
    source: str | Path | Any,
    *,
    dt_s: float | None = None,
    sampling_rate_Hz: float | None = None,
    reset: graphs.OwnReset = "to-value",
    backend: Backend = "auto",
) -> parse.FromNIR:
    """The network in a NIR file or graph; from neurotact's own files also the encoder, the exit rule and the classes.

    A graph of Linear, CubaLIF (recurrent or not), Linear, CubaLIF without biases, with one time constant a layer, is an
    `RSNN`. Any other one of weights, delays and neurons is a network of the model `graph` (`networks/graph.py`), which
    the reference runs: with biases, constants of each neuron, any number of layers, graphs within graphs.

    dt_s: seconds per step, for files without it (snnTorch's have 1e-4). sampling_rate_Hz: of the network, if a step in
    another program's file means another time than `dt_s`; None: 1 / dt_s. Either is refused if it differs from what the
    file states.
    reset: `subtract` for a network of another program that was trained with that reset: files can only say a value.
    Raises InputError for files that are damaged or hostile, and for nodes that neurotact's networks do not have.

    >>> net = rsnn.RSNN(16, 8, hidden=20, sampling_rate_Hz=2000.0)
    >>> from_nir(to_nir(net)).network.n_inputs
    16
    """
    if sampling_rate_Hz is not None and not (math.isfinite(sampling_rate_Hz) and sampling_rate_Hz > 0):
        raise InputError(f"sampling_rate_Hz: must be a positive number; got {sampling_rate_Hz}")
    is_file = isinstance(source, (str, Path))
    content = file.read(source) if is_file else source
    return parse.parsed(content, dt_s, str(source) if is_file else "graph", sampling_rate_Hz, backend, reset)


def export_nir(
    run: fitted.Fitted,
    path: str | Path,
    *,
    plain: bool = False,
    lower_refractory: bool = False,
    network_only: bool = False,
    dt_s: float | None = None,
    prove: int = 0,
    recordings: Recordings | str | Path | None = None,
    spikes: str | Path | None = None,
    force: bool = False,
    tell: Tell = untold,
) -> Any:
    """Write the afferents and the network of a run as a NIR graph, as `neurotact export` does; returns it.

    run: as of `export_c`.
    plain, lower_refractory, network_only, dt_s: as of `to_nir`.
    prove: run the graph in the interpreter, snnTorch and Norse, and compare this many test trials spike by spike.
    recordings, spikes: for that, those that the run was trained on, where they moved since; of a classifier, others.
    force: replace a file. tell: called with what the command prints.
    Raises InputError for a file that exists, and for a chain that NIR cannot express.

    >>> made = nt.export_nir("run", "run.nir")
    >>> "afferents" in made.nodes
    True
    """
    effects.check(ranges=prove, recordings=recordings, spikes=spikes)
    made = to_nir(
        run, path, plain=plain, lower_refractory=lower_refractory, network_only=network_only, dt_s=dt_s, force=force
    )
    said = note.of(made, str(path))
    assert said is not None
    tell(f"{path}: {len(execute.flat(made)[0])} nodes, steps of {said.dt_s:g} s, {said.form}")
    for difference in said.differences:
        tell(f"  differs: {difference}")
    if prove:
        for line in summary(proved(run, made, prove, recordings, spikes, say=log.warning)):
            tell(line)
    return made


def proved(
    run: fitted.Fitted,
    made: Any,
    n_trials: int,
    recordings: Recordings | str | Path | None = None,
    spikes: str | Path | None = None,
    say: Callable[[str], None] = lambda _: None,
) -> pd.DataFrame:
    """The run's network compared with its graph on test trials, in the interpreter, snnTorch and Norse.

    recordings, spikes: those that the run was trained on, if they were moved. Columns as `compare.first_differences`.
    A simulator that cannot run the graph is reported, with the reason.
    """
    restored = fitted.restore(run, spikes=spikes)
    encoder = chains.front_of(restored)
    network = restored.network
    assert isinstance(network, (rsnn.RSNN, module.ModuleNetwork))  # as `to_nir` has taken it
    written = note.of(made, "graph")
    known = test_trials.recorded(restored, recordings)
    inputs = list(_inputs(known, encoder, network, n_trials, with_afferents=bool(written and written.encoder)))
    tables: list[pd.DataFrame] = []
    for simulator in compare.SIMULATORS:
        for trial, (raster, more) in enumerate(inputs):
            try:
                table = compare.report(network.on_own_clock(), made, raster, (simulator,), **more)
            except InputError as error:
                say(f"{simulator} is skipped: {error}")
                break
            table["first_trial"] = table["first_trial"].where(table["first_trial"].isna(), trial)
            tables.append(table)
    return _joined(tables)


def _inputs(
    known: test_trials.Recorded,
    encoder: EncoderSpec | None,
    network: definition.Network,
    n_trials: int,
    *,
    with_afferents: bool,
) -> Iterator[tuple[np.ndarray, dict[str, Any]]]:
    """Of some test trials, spikes as the network computes them, and the rest that `compare.report` takes."""
    import torch

    for signal in known.test[:n_trials]:
        if with_afferents:
            assert isinstance(encoder, AfferentSpec)
            conditioned = compare.conditioned_trial(signal, encoder, known.sampling_rate_Hz)
            raster = afferents.encode(conditioned, network.sampling_rate_Hz, encoder)[0]
            yield raster, {"conditioned": conditioned, "encoder": encoder}
        elif encoder is None:  # events as given
            yield network.binned(torch.from_numpy(signal[None])).numpy(), {}
        else:
            one = Recordings([signal], known.sampling_rate_Hz, encoder.unit, pd.DataFrame({"label": ["test"]}))
            trains = encode_recordings(one, encoder)
            raster = torch.zeros(1, int(trains.trial_steps[0]), len(trains.afferents), dtype=torch.uint8)
            raster[0, trains.steps[0], trains.units[0]] = 1
            yield network.binned(raster).numpy(), {}


def _joined(tables: list[pd.DataFrame]) -> pd.DataFrame:
    """One row per simulator and layer: the first trial that differs, and the sums."""
    rows = pd.concat(tables, ignore_index=True)
    firsts = []
    for _, group in rows.groupby(["simulator", "layer"], sort=False):
        differing = group[group["differing"] > 0]
        first = (differing if len(differing) else group).iloc[0].copy()
        first["spikes"], first["differing"] = int(group["spikes"].sum()), int(group["differing"].sum())
        firsts.append(first)
    return pd.DataFrame(firsts).reset_index(drop=True)


def summary(table: pd.DataFrame) -> list[str]:
    """One line per row of a proof.

    >>> empty = {"first_trial": None, "first_step": None, "first_neuron": None, "reference": None, "other": None}
    >>> summary(pd.DataFrame([{"simulator": "graph", "layer": "hidden", **empty, "spikes": 7, "differing": 0}]))
    ['graph, hidden: equal, 7 values']
    """
    lines = []
    for row in table.itertuples(index=False):
        head = f"{row.simulator}, {row.layer}"
        if not row.differing:
            lines.append(f"{head}: equal, {row.spikes} values")
            continue
        position = f"trial {int(row.first_trial)}, step {int(row.first_step)}, neuron {int(row.first_neuron)}"
        values = f"{np.format_float_positional(row.reference, 6)} and not {np.format_float_positional(row.other, 6)}"
        lines.append(f"{head}: {row.differing} differ of {row.spikes} values, first at {position} ({values})")
    return lines


EXPORTER = Exporter(
    "a file with afferents and network as a graph (Neuromorphic Intermediate Representation)",
    export_nir,
    {
        "plain": "only CubaLIF and Linear nodes, which snnTorch and Norse load.",
        "lower_refractory": "express refractory periods as nodes.",
        "network_only": "leave out the afferents.",
        "dt_s": "seconds per step; 1 / clock when absent, 1e-4 for snnTorch.",
    },
)
