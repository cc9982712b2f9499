"""Export to XyloAudio 2: a configuration for Rockpool, and its proof in XyloSim, which is the chip's own simulator."""

from collections.abc import Iterator
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import torch
from neurotact_parts.exporters import chips
from neurotact_parts.exporters.xylo.chip import Chip, ChipLayer, Ran, with_last_step
from neurotact_parts.exporters.xylo.conversion import Converted, converted

from neurotact import files
from neurotact.errors import InputError
from neurotact.networks.definition.executors import FEATURES
from neurotact.networks.definition.rsnn import RSNN, rsnn_of
from neurotact.networks.training import run_folder, tasks
from neurotact.networks.training.ranges import evenly
from neurotact.networks.use import fitted
from neurotact.networks.use.fitted import Fitted
from neurotact.progress import Tell

TARGET = "xyloaudio2"
WINDOWS = 64
"""Training windows on which the chip's states are to stay within their bits."""
REFUSED = ("inputs", "hidden neurons", "classes", "threshold adaptation")
CONVERTED = {
    "membrane": "replaced, so that what a hidden neuron sends returns earlier",
    "reset": "replaced",
    "recurrent delay": "left out",
    "readout": "read from the membranes of output neurons, which do not spike; the reader adds the bias",
    "decay of the current": "replaced; thresholds keep the response to a constant rate",
    "decay of the membrane": "replaced; thresholds keep the response to a constant rate",
}
"""Limits (`chips.compare`) that a network may break, and what the conversion does."""
ALWAYS = (
    "a neuron takes its threshold off before the decay, not after; a hidden neuron may spike up to 31 times in a step; "
    "the readout receives hidden spikes a step later"
)
ABSENT = "XyloSim is not installed; install it with: pip install xylosim (which needs a C++ compiler)"


def export(run: Fitted, path: str | Path, prove: int, spikes: str | Path | None, *, force: bool, tell: Tell) -> Chip:
    """`door.export_xylo`."""
    files.check_new(path, force=force)
    restored = fitted.restore(run, spikes=spikes).of_classes("a chip of spikes")
    network = rsnn_of("chip", restored.network)
    differences = [*_differences(network, restored)]
    trains = run_folder.trained_spikes_of(restored)
    split = tasks.trials_of(trains, restored.task)
    windows = tasks.examples_of(trains, evenly(split.train), restored.task)[0].spikes
    made = converted(network, evenly(windows, WINDOWS))
    files.write_json(path, made.chip.specification)
    hidden, readout = made.chip
    shifts = f"{hidden.shift}, {hidden.shift_among} and {readout.shift}"
    tell(f"{path}: {network.n_inputs} inputs, {len(hidden.threshold)} hidden and {network.n_classes} output neurons of "
         f"XyloAudio 2; weights shifted by {shifts} bits")  # fmt: skip
    for line in differences:
        tell(line)
    if prove:
        examples, _ = tasks.examples_of(trains, split.test[:prove], restored.task)
        inputs = network.binned(examples.spikes).numpy()
        tell(beside_xylosim(made.chip, inputs))
        tell(in_stages(network, made, examples.spikes, examples.labels.numpy()))
    return made.chip


def _differences(network: RSNN, restored: run_folder.Restored) -> Iterator[str]:
    """A line for each way in which the chip is not the network; InputError for one that it cannot be."""
    if network.stretches is not None:
        raise InputError(
            f"readout of stretches: XyloAudio 2 has the same weights at all times; "
            f"{FEATURES['readout of stretches'].instead}"
        )
    for row in chips.compare(network, restored.encoder, restored.exits(), TARGET).itertuples(index=False):
        if row.what in REFUSED and not row.fits:
            raise InputError(f"{row.what}: XyloAudio 2 takes {row.limit}, not {row.here}; {row.cost}")
        is_converted = row.what in CONVERTED and (not row.fits or "decay" in str(row.what))
        if is_converted or not row.fits:
            how = "converted" if is_converted else "outside"
            limit = f"{row.what}: {row.here}, on the chip {row.limit}"
            yield f"  {how}: " + "; ".join(filter(None, (limit, CONVERTED.get(str(row.what)), str(row.cost))))
    yield f"  differs: {ALWAYS}"


def beside_xylosim(chip: Chip, inputs: np.ndarray) -> pd.DataFrame | str:
    """A row for each kind of value of our integers and of XyloSim; a line where that is not installed.

    inputs: spikes on the network's clock, `(window, step, input)`.
    """
    if find_spec("xylosim") is None:
        return f"not compared with the chip's own simulator: {ABSENT}"
    rows = [
        (f"{layer} {kind}", difference(getattr(theirs, kind), getattr(ours, kind)))
        for layer, ours, theirs in zip(("hidden", "readout"), chip.run(inputs), simulated(chip, inputs), strict=True)
        for kind in ("spikes", "currents", "membranes")
    ]
    return pd.DataFrame(rows, columns=["of each step", f"here and in XyloSim {version('xylosim')}"])


def in_stages(network: RSNN, made: Converted, windows: torch.Tensor, labels: np.ndarray) -> pd.DataFrame:
    """From the network to the chip in three stages: what each kind of difference costs.

    windows: `(window, time, afferent)`; labels: their classes. Columns: accuracy_percent, differ_from_infer (windows
    whose decision does), hidden_spikes (per window), several_spikes (how often a hidden neuron sent more than one in a
    step), clipped (states that met the chip's limits).
    """
    inputs = network.binned(windows)
    inferred, in_float = network.infer(windows), made.network.infer(inputs)
    rows = [
        (what, found.labels.numpy(), float(found.hidden_spikes.double().mean()), 0, 0)
        for what, found in (("infer", inferred), ("membrane, reset, delay and decays of the chip, in float", in_float))
    ]
    for what, chip in (
        ("and its order of reset and decay, several spikes in a step", made.fine),
        ("and its bits, as on the chip", made.chip),
    ):
        hidden, readout = chip.run(inputs.numpy())
        spikes = hidden.spikes[:, :-1]  # the last step is the readout's alone
        per_window = float(spikes.sum(axis=(1, 2), dtype=np.int64).mean())
        clipped = hidden.clipped + readout.clipped
        rows.append((what, made.labels(readout, chip), per_window, int((spikes > 1).sum()), clipped))
    return pd.DataFrame([
        {
            "what": what, "accuracy_percent": 100 * float((found == labels).mean()),
            "differ_from_infer": int((found != rows[0][1]).sum()), "hidden_spikes": spikes, "several_spikes": several,
            "clipped": clipped,
        }
        for what, found, spikes, several, clipped in rows
    ])  # fmt: skip


def difference(expected: np.ndarray, found: np.ndarray) -> str:
    """How two arrays `(window, step, neuron)` compare, in words.

    >>> difference(np.array([[[0, 2]]]), np.array([[[0, 1]]]))
    '1 of 2 differ, first in window 0, step 0, neuron 1 (2 and not 1)'
    """
    places = np.argwhere(expected != found)
    if not len(places):
        return f"equal, {int((expected != 0).sum())} of {expected.size} values are not 0"
    window, step, neuron = first = tuple(places[0].tolist())
    return (
        f"{len(places)} of {expected.size} differ, first in window {window}, step {step}, neuron {neuron} "
        f"({expected[first]} and not {found[first]})"
    )


class _Held(NamedTuple):
    """XyloSim's layer, and the synapses whose addresses it keeps."""

    layer: Any
    synapses: list[Any]


def simulated(chip: Chip, spikes: np.ndarray) -> tuple[Ran, Ran]:
    """`chip.run(spikes)` by XyloSim: the package xylosim, which Rockpool's module of that name calls as well."""
    held = _held(chip)
    recorded = [_recorded(held.layer, window) for window in with_last_step(spikes)]
    kinds = [np.stack(kind) for kind in zip(*recorded, strict=True)]
    return Ran(kinds[0], kinds[1], kinds[2]), Ran(kinds[3], kinds[4], kinds[5])


def _recorded(layer: Any, window: np.ndarray) -> list[np.ndarray]:
    """Spikes, currents and membranes of the hidden layer and of the readout for one window `(step, input)`."""
    layer.reset_all()
    layer.evolve(window.tolist())
    hidden = layer.rec_recurrent_spikes, np.transpose(layer.rec_i_syn), np.transpose(layer.rec_v_mem)
    readout = layer.rec_out_spikes, np.transpose(layer.rec_i_syn_out), np.transpose(layer.rec_v_mem_out)
    return [np.array(each) for each in (*hidden, *readout)]


def _held(chip: Chip) -> _Held:
    from xylosim.v2 import XyloLayer, XyloSynapse  # pyright: ignore[reportMissingImports]

    def synapses(weights: np.ndarray) -> list[Any]:
        return [[XyloSynapse(int(post), 0, int(row[post])) for post in np.flatnonzero(row)] for row in weights]

    def neurons(layer: ChipLayer, end: str) -> dict[str, Any]:
        n = len(layer.threshold)
        return {
            f"threshold{end}": layer.threshold.tolist(), f"bias{end}": [0] * n, f"dash_mem{end}": [layer.dash_mem] * n,
            f"dash_syns{end}": [[layer.dash_syn]] * n,
        }  # fmt: skip

    hidden, readout = chip
    n = len(hidden.threshold)
    among = np.zeros((n, n), int) if hidden.among is None else hidden.among
    made = {"in": synapses(hidden.weights), "rec": synapses(among), "out": synapses(readout.weights)}
    layer = XyloLayer(
        **{f"synapses_{name}": each for name, each in made.items()}, **neurons(hidden, ""), **neurons(readout, "_out"),
        aliases=[[]] * n, has_bias=False, weight_shift_inp=hidden.shift, weight_shift_rec=hidden.shift_among,
        weight_shift_out=readout.shift, name="",
    )  # fmt: skip
    return _Held(layer, [*made.values()])
