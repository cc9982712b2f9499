"""Braille letters under an event-based fingertip: 27 classes, 12 taxels, ON and OFF events (Müller-Cleve et al. 2022).

Published on Zenodo (record 6556273) and at github.com/miskarous/tactile_braille_reading: a file with a list of
`{"letter", "events": [12 taxels][ON, OFF] lists of times in s}`. The sensor sends an event when a signal has changed by
a threshold, so the recordings are spikes already: they are only binned to a clock.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from neurotact_parts.readers.events.spikes import on_clock, say_merged
from neurotact_parts.readers.events.times import event_times, joined_times, rounding_of, steps_of
from neurotact_parts.readers.numpy_files import read_arrays
from neurotact_parts.studies.braille.plain_objects import read_plain

from neurotact.data.dataset import Reader
from neurotact.data.spikes import SpikeTrains, from_trials
from neurotact.data.windows import LONGEST_STEPS
from neurotact.errors import InputError
from neurotact.lazily import lazily

with lazily():
    import pandas as pd


N_TAXELS = 12
POLARITIES = ("ON", "OFF")
AFFERENTS = tuple(f"{polarity} taxel{i + 1}" for polarity in POLARITIES for i in range(N_TAXELS))
ARRAYS = ("letter", "event_recording", "event_taxel", "event_polarity", "event_time_s")
STEP_MS = 5.0
"""The clock of the published study."""
Binning = Literal["floor", "nearest"]

log = logging.getLogger("neurotact")


class Letter(NamedTuple):
    """A recording: its letter, and time in s and afferent of each event, unordered."""

    letter: str
    times_s: np.ndarray
    units: np.ndarray


def read(
    path: str | Path, step_ms: float = STEP_MS, *, binning: Binning = "floor", length_ms: float | None = None
) -> SpikeTrains:
    """The spikes of every recording on a clock of `step_ms`.

    path: the published file, or its repack as .npz (arrays `letter`, `event_recording`, `event_taxel`,
        `event_polarity`, 0 being ON, and `event_time_s`).
    binning: an event belongs to the step in which it occurs (`floor`) or to the nearest beginning of a step (`nearest`,
        ties to the even step), as in the published study.
    length_ms: of every trial, later events are dropped; that of the longest recording when absent.

    Afferents are the ON events of each taxel, then the OFF events. Events of an afferent within one step are one spike.
    Raises InputError, which names the file and the place.

    >>> import tempfile
    >>> path = Path(tempfile.mkdtemp()) / "events.npz"
    >>> np.savez(path, letter=["A"], event_recording=[0, 0, 0], event_taxel=[2, 2, 11], event_polarity=[0, 0, 1],
    ...          event_time_s=[0.001, 0.004, 0.012])
    >>> trains = read(path)
    >>> trains.steps[0].tolist(), [trains.afferents[unit] for unit in trains.units[0]]
    ([0, 2], ['ON taxel3', 'OFF taxel12'])
    """
    if not (math.isfinite(step_ms) and step_ms > 0):
        raise InputError(f"`step_ms`: must be a positive number; got {step_ms}")
    if length_ms is not None and not (math.isfinite(length_ms) and length_ms >= step_ms):
        raise InputError(f"length_ms: must be one step of {step_ms:g} ms or more; got {length_ms}")
    path = Path(path)
    letters = list(_from_archive(path) if path.suffix == ".npz" else _from_published(path))
    if not letters:
        raise InputError(f"{path}: holds no recording; copy the published file again")
    last_s = max((float(letter.times_s.max(initial=0.0)) for letter in letters), default=0.0)
    if last_s * 1e3 / step_ms >= LONGEST_STEPS:
        raise InputError(f"{path}: an event at {last_s:g} s is beyond any clock of {step_ms:g} ms; check the file")
    steps = _steps([letter.times_s for letter in letters], step_ms, binning)
    last = max(int(letter_steps.max(initial=0)) for letter_steps in steps)
    n_steps = last + 1 if length_ms is None else int(length_ms / step_ms + 1e-9)
    trials = ((letter_steps, letter.units, n_steps) for letter_steps, letter in zip(steps, letters, strict=True))
    binned = on_clock(trials, len(AFFERENTS))
    if binned.n_late:
        log.warning("%s: %d of %d events are after %g ms and left out", path, binned.n_late, binned.n_events, length_ms)
    say_merged(binned, 1e-3 * step_ms, str(path), accept=True)
    conditions = pd.DataFrame({"label": [letter.letter for letter in letters]})
    return from_trials(binned.trials, 1e3 / step_ms, AFFERENTS, conditions, source=str(path))


def _steps(times_s: Sequence[np.ndarray], step_ms: float, binning: Binning) -> list[np.ndarray]:
    """The step of each event by `binning`."""
    if binning == "nearest":
        return [np.rint(letter_times * 1e3 / step_ms).astype(np.int64) for letter_times in times_s]
    times = [event_times(letter_times, 1.0)._replace(resolutions=()) for letter_times in times_s]
    rounding = rounding_of(joined_times(times), 1e-3 * step_ms)
    return [steps_of(letter_times, 1e-3 * step_ms, rounding) for letter_times in times]


def _from_archive(path: Path) -> Iterator[Letter]:
    arrays = read_arrays(path)
    for name in ARRAYS:
        if name not in arrays:
            raise InputError(f"{path}: the array '{name}' is missing; this is not a repacked file of Braille letters")
    letter, recording, taxel, polarity, time_s = (arrays[name] for name in ARRAYS)
    shapes = {array.shape for array in (recording, taxel, polarity, time_s)}
    if len(shapes) != 1 or letter.ndim != 1 or recording.ndim != 1:
        raise InputError(f"{path}: the arrays of events differ in length; repack the recordings")
    _check(path, "recording", recording, len(letter))
    _check(path, "taxel", taxel, N_TAXELS)
    _check(path, "polarity", polarity, len(POLARITIES))
    _check_times(path, time_s)
    units = polarity.astype(np.int64) * N_TAXELS + taxel.astype(np.int64)
    order = np.argsort(recording, kind="stable")
    ends = np.searchsorted(recording[order], np.arange(len(letter) + 1))
    for number, name in enumerate(letter.tolist()):
        mine = order[ends[number] : ends[number + 1]]
        yield Letter(str(name), time_s[mine], units[mine])


def _from_published(path: Path) -> Iterator[Letter]:
    table = read_plain(path)
    if not isinstance(table, list):
        raise InputError(f"{path}: holds a {type(table).__name__} where a list of recordings is expected")
    for number, entry in enumerate(table):
        where = f"{path}: recording {number}"
        if not isinstance(entry, dict) or not isinstance(entry.get("letter"), str) or "events" not in entry:
            raise InputError(f"{where} is not a table of 'letter' and 'events'; copy the published file again")
        yield Letter(entry["letter"], *_events(entry["events"], where))


def _events(events: Any, where: str) -> tuple[np.ndarray, np.ndarray]:
    """Times and afferents of `[taxel][polarity]` lists of times."""
    fits = isinstance(events, (list, tuple)) and len(events) == N_TAXELS
    if not fits or any(not isinstance(pair, (list, tuple)) or len(pair) != len(POLARITIES) for pair in events):
        raise InputError(f"{where}: its events are not {N_TAXELS} taxels of ON and OFF lists; copy the file again")
    times, units = [], []
    for taxel, pair in enumerate(events):
        for polarity, values in enumerate(pair):
            if not isinstance(values, (list, tuple)) or any(type(value) not in (int, float) for value in values):
                raise InputError(f"{where}, taxel {taxel + 1}: its times are not numbers; copy the file again")
            times += values
            units += [polarity * N_TAXELS + taxel] * len(values)
    times_s = np.array(times, float)
    _check_times(where, times_s)
    return times_s, np.array(units, np.int64)


def _check(path: Path, name: str, values: np.ndarray, n: int) -> None:
    if values.dtype.kind not in "iu" or (len(values) and not (values.min() >= 0 and values.max() < n)):
        raise InputError(f"{path}: event_{name} must hold whole numbers from 0 to {n - 1}; repack the recordings")


def _check_times(where: str | Path, times_s: np.ndarray) -> None:
    if times_s.dtype.kind not in "iuf" or not (np.isfinite(times_s) & (times_s >= 0)).all():
        raise InputError(f"{where}: times of events must be numbers of seconds >= 0; copy the file again")


READER = Reader(
    "27 Braille letters under an event-based fingertip (Zenodo 6556273): the published file, to spikes.", read, STEP_MS
)
