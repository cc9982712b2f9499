"""Long recordings for a detector: their windows, their parts where they are few, and a network that forgets.

A detector learns windows and runs on without: what is older than a window must have decayed. The measure is linear, of
a spike's response through synapse, membrane and readout; a neuron that fires as fast as it can keeps its phase.
"""

import logging
import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pandas as pd

from neurotact.data import marks
from neurotact.data.recordings import Recordings
from neurotact.data.spikes import SpikeTrains
from neurotact.data.windows import WindowSpec, steps_of
from neurotact.errors import InputError
from neurotact.networks.definition import recipe
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.spec import build

log = logging.getLogger("neurotact")

LEFT = 0.01
"""Share of the response to a spike that may be left a window later."""
READOUT_SHARE = 6
"""Time constants of a detector's readout in a window."""
SHORTEST_MS, HOPS = 300.0, 4
"""Of windows that nobody gave: the least length, and how many begin within one."""
RECORDINGS = 10
"""With fewer recordings, each is cut in time into parts, as many as this together: sides of a split are of parts."""
RECORDING, PART_S = "recording", "part_begin_s"
"""Conditions of a part: the recording that it is of, and when it begins there."""


def in_parts(trains: SpikeTrains, n: int) -> SpikeTrains:
    """Each recording cut in time into `n` parts, as trials; a cut that falls into a mark is moved to its end.

    The parts of one recording are no copies of each other. Times of a part count from its begin.
    """
    rows, labelled = _cut(trains, trains.trial_steps, n)
    of, first, last = np.array(rows).T
    kept = [np.searchsorted(trains.steps[trial], (a, b)) for trial, a, b in rows]
    of_parts = {
        name: tuple(f"{names[trial]}/{a}" for trial, a, _ in rows) if (names := getattr(trains, name)) else ()
        for name in ("trial_digests", "trial_touches")
    }
    return replace(
        trains, steps=[trains.steps[row[0]][a:b] - row[1] for row, (a, b) in zip(rows, kept, strict=True)],
        units=[trains.units[row[0]][a:b] for row, (a, b) in zip(rows, kept, strict=True)], trial_steps=last - first,
        conditions=_conditions(trains, of, first), variations=None, marks=labelled, **of_parts,
    )  # fmt: skip


def parts_of_recordings(recordings: Recordings) -> Recordings:
    """Fewer recordings than `RECORDINGS` cut as by `in_parts`, before they are encoded."""
    n = math.ceil(RECORDINGS / len(recordings))
    if n == 1:
        return recordings
    rows, labelled = _cut(recordings, recordings.lengths, n)
    of, first, _ = np.array(rows).T
    log.warning(
        "Split: by time, since there are %d recordings: %d parts, cut outside of marks.", len(recordings), len(of)
    )
    signals = [recordings.signals[trial][begin:end] for trial, begin, end in rows]
    return replace(recordings, signals=signals, conditions=_conditions(recordings, of, first), marks=labelled)


def _cut(
    touches: Recordings | SpikeTrains, lengths: np.ndarray, n: int
) -> tuple[list[tuple[int, int, int]], pd.DataFrame | None]:
    """The trial, the first sample and the end of each part, and the marks of parts."""
    rate_Hz, rows, labelled = touches.sampling_rate_Hz, [], []
    table = pd.DataFrame(columns=marks.COLUMNS) if touches.marks is None else touches.marks
    for trial, length in enumerate(lengths.tolist()):
        own = table[table["trial"] == trial]
        for first, last in pairwise(_edges(length, n, own, rate_Hz)):
            inside = own[(own["start_s"] >= first / rate_Hz) & (own["start_s"] < last / rate_Hz)]
            times = {key: (inside[key].clip(upper=last / rate_Hz) - first / rate_Hz) for key in marks.COLUMNS[1:3]}
            labelled.append(inside.assign(trial=len(rows), **times))
            rows.append((trial, first, last))
    return rows, None if touches.marks is None else pd.concat(labelled, ignore_index=True)


def _conditions(touches: Recordings | SpikeTrains, of: np.ndarray, first: np.ndarray) -> pd.DataFrame:
    conditions = touches.conditions.iloc[of].reset_index(drop=True)
    return conditions.assign(**{RECORDING: of, PART_S: first / touches.sampling_rate_Hz})


def _edges(n_steps: int, n: int, own: pd.DataFrame, rate_Hz: float) -> list[int]:
    """The steps at which the parts of a recording begin, and its end."""
    edges = {0, n_steps}
    for place in np.linspace(0, n_steps, n + 1)[1:-1].round().astype(int).tolist():
        for start, stop in own[["start_s", "stop_s"]].to_numpy() * rate_Hz:
            place = math.ceil(stop - 1e-6) if start <= place < stop else place
        edges.add(min(place, n_steps))
    return sorted(edges)


def parts_for(trains: SpikeTrains, window: WindowSpec) -> int:
    """In how many parts each recording is cut; told, with the windows that this drops."""
    n = math.ceil(RECORDINGS / len(trains))
    if n > 1:
        cuts = (trains.trial_steps, in_parts(trains, n).trial_steps)
        length, start, hop = steps_of(window, trains.sampling_rate_Hz)
        whole, cut = (int(np.maximum(0, (steps - start - length) // hop + 1).sum()) for steps in cuts)
        log.warning(
            "Split: by time, since there are %d recordings: each is cut into up to %d parts outside of marks; %d of %d "
            "windows, which would cross a cut, are dropped.", len(trains), n, whole - cut, whole,
        )  # fmt: skip
    return n


def left_after(taus_ms: Sequence[float], length_ms: float) -> float:
    """The share of the response to a spike, through exponentials one after another, that is left after a time.

    >>> round(left_after([10.0], 10.0), 2)
    0.37
    """
    from scipy.signal import lfilter

    response = np.eye(1, 20_000)[0]
    for tau_ms in taus_ms:
        response = lfilter([1.0], [1.0, -math.exp(-length_ms / 1000 / tau_ms)], response)
    return float(response[1000:].sum() / response.sum())


def taus_ms_of(spec: RSNNSpec, length_ms: float) -> list[float]:
    """The time constants of a network for windows of a length: given ones, and those of the recipe."""
    shares = {"tau_syn_ms": recipe.TAU_SHARE, "tau_mem_ms": recipe.TAU_SHARE, "readout_tau_ms": READOUT_SHARE}
    is_given = {key: spec.recipe is None or key in spec.model_fields_set for key in shares}
    taus = [getattr(spec, key) if is_given[key] else length_ms / share for key, share in shares.items()]
    return [tau for tau in (*taus, spec.tau_adaptation_ms if spec.threshold_adaptation else None) if tau]


def window_for(window: WindowSpec, spec: RSNNSpec) -> WindowSpec:
    """The windows of a detector: what nobody gave is chosen such that older state has decayed; told."""
    if window.align != "trial":
        raise InputError("window.align: a detector has windows all along a recording; leave `align` out")
    length_ms = window.length_ms
    if "length_ms" not in window.model_fields_set:
        length_ms = SHORTEST_MS
        while left_after(taus_ms_of(spec, length_ms), length_ms) > LEFT:
            length_ms += 10
    hop_ms = window.hop_ms or length_ms / HOPS
    log.warning(
        "Window: %g ms, one each %g ms, labelled at its end; after it less than %g %% of a response is left.",
        length_ms, hop_ms, 100 * LEFT,
    )  # fmt: skip
    return window.model_copy(update={"length_ms": length_ms, "hop_ms": hop_ms})


def network_for(spec: RSNNSpec, window: WindowSpec) -> RSNNSpec:
    """The network of a detector: what nobody gave is set such that it forgets; told.

    InputError for one that cannot run on without windows: its state must decay, and within one.
    """
    chosen = {"model": "snn", "readout": "integrator", "readout_tau_ms": round(window.length_ms / READOUT_SHARE, 3)}
    chosen = {key: value for key, value in chosen.items() if spec.recipe and key not in spec.model_fields_set}
    if chosen:
        log.warning("Detector: %s.", ", ".join(f"{key} = {value}" for key, value in chosen.items()))
        spec = build(RSNNSpec, {**spec.model_dump(mode="json"), **chosen}, source="target = 'events'")
    if spec.own is not None or spec.model != "snn":
        raise InputError(
            f"model: '{spec.model}' may keep what is older than a window, and a detector runs on without; set 'snn'"
        )
    if spec.readout != "integrator" or spec.readout_tau_ms is None:
        raise InputError(
            "target: 'events' needs a readout that forgets; set readout = 'integrator' and readout_tau_ms, or leave "
            "them to network='default'"
        )
    taus_ms = taus_ms_of(spec, window.length_ms)
    if (left := left_after(taus_ms, window.length_ms)) > LEFT:
        fitting = window.length_ms
        while left_after(taus_ms, fitting) > LEFT:
            fitting *= 1.02
        raise InputError(
            f"window.length_ms: {window.length_ms:g} ms after a spike {100 * left:.2g} % of the response is left (time "
            f"constants of {', '.join(f'{tau:g}' for tau in taus_ms)} ms), more than {100 * LEFT:g} %; give at least "
            f"{math.ceil(fitting / 10) * 10} ms, or shorten readout_tau_ms"
        )
    return spec
