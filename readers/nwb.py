"""Neurodata Without Borders (NWB 2, HDF5): spike times of units, or a time series, cut into the trials of the file.

The layout is that of the NWB schema (doi 10.7554/eLife.78362): `units`, tables of `intervals`, `TimeSeries`. It is read
as HDF5, dataset by dataset, so that declared sizes are checked before reading. Its schema is ignored.
"""

from __future__ import annotations

import json
import logging
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np
from neurotact_parts.readers.clock.stamps import row_times
from neurotact_parts.readers.clock.trials import Read, recordings_of
from neurotact_parts.readers.doubts import SYMBOLS, Fixes
from neurotact_parts.readers.events.observed import Unobserved, observed_trials, touching, within
from neurotact_parts.readers.events.spikes import BYTES_PER_EVENT, MOST_AFFERENTS, trains_with_ends
from neurotact_parts.readers.events.times import SLACK, EventTimes, event_times
from pydantic import Field

from neurotact.data.dataset import Reader
from neurotact.data.digests import DIGEST, TOUCH
from neurotact.data.hdf5_input import Declared, attribute, own_members, reading
from neurotact.data.readers.columns import Samples
from neurotact.data.readers.table.cells import check_digits
from neurotact.data.recordings import LABEL, Recordings
from neurotact.data.spikes import SpikeTrains
from neurotact.data.trial_choice import EVERY, TrialChoice, Where, Words
from neurotact.data.windows import LONGEST_STEPS
from neurotact.errors import InputError
from neurotact.files import check_size
from neurotact.lazily import lazily
from neurotact.repeated_warnings import in_few_lines
from neurotact.spec import Spec, build

with lazily():
    import pandas as pd


log = logging.getLogger("neurotact")

KEPT = ("id", "start_time", "stop_time", "timeseries", "tags", DIGEST, TOUCH)
"""Columns of trials that are not conditions."""
ELECTRODES = "general/extracellular_ephys/electrodes"
ELECTRODE_NAMES = ("label", "channel_name")
"""Columns of electrodes with their names."""
MOST_NAMED = 8


def _columns(declared: Declared, table_path: str, n_trials: int) -> Iterator[tuple[str, np.ndarray | list[str]]]:
    """The columns of a table with one value per trial, in its own order."""
    group = declared.group(table_path)
    for name in _order(group, declared.path):
        if name in KEPT or f"{name}_index" in group or not declared.holds(f"{table_path}/{name}"):
            continue
        member = group[name]
        is_plain = isinstance(member, h5py.Dataset) and (
            member.dtype.kind in "iufb" or h5py.check_string_dtype(member.dtype) is not None
        )
        if is_plain and member.shape == (n_trials,):
            values = declared.column(f"{table_path}/{name}", n_trials)
            elements = f"{table_path}/{name}_elements"
            if declared.holds(elements) and not isinstance(values, list):
                meant = np.array(declared.texts(elements), object)
                values = [str(text) for text in meant[values.astype(np.int64)]]
            yield name, values.astype(np.int64) if isinstance(values, np.ndarray) and values.dtype == bool else values


def _order(group: h5py.Group, path: str | Path) -> list[str]:
    """The names of a table's columns in the order of its attribute `colnames`, others after them."""
    listed: list[str] = []
    if "colnames" in group.attrs:
        colnames = h5py.h5a.open(group.id, b"colnames")
        check_size(path, colnames.get_storage_size())
        listed = [name.decode() if isinstance(name, bytes) else str(name) for name in np.ravel(group.attrs["colnames"])]
    return list(dict.fromkeys([*(name for name in listed if name in group), *group]))


def _named(group: h5py.Group) -> str:
    """The first names in a group, in words."""
    names = [str(name) for name, _ in zip(group, range(MOST_NAMED), strict=False)]
    return f"there is {', '.join(names)}" if names else "there is none"


def _intervals(declared: Declared, table: str) -> np.ndarray:
    """The beginnings and ends of a table of intervals in s, `(interval, 2)`; none without the table."""
    if not declared.holds(table):
        return np.empty((0, 2))
    times = [declared.numbers(f"{table}/{name}").astype(float) for name in ("start_time", "stop_time")]
    if len(times[0]) != len(times[1]):
        raise InputError(f"{declared.path}: {table} has {len(times[0])} starts and {len(times[1])} stops; correct it")
    return _checked(np.stack(times, axis=1), f"{declared.path}: {table}")


def _checked(intervals_s: np.ndarray, where: str) -> np.ndarray:
    """The intervals as they are; InputError for one that ends before it begins; `where` begins it."""
    wrong = np.flatnonzero(~(intervals_s[:, 0] <= intervals_s[:, 1]))
    if len(wrong):
        start_s, stop_s = intervals_s[wrong[0]].tolist()
        raise InputError(f"{where}: interval {wrong[0]} lasts from {start_s:g} s to {stop_s:g} s; correct it")
    return intervals_s


def _electrodes_of(declared: Declared, series: str, n_channels: int) -> tuple[str, ...]:
    """The names of the electrodes of a series: their column `label` or `channel_name`, else their ids; none without."""
    if not (declared.holds(f"{series}/electrodes") and declared.holds(ELECTRODES)):
        return ()
    rows = declared.numbers(f"{series}/electrodes", "iu").astype(np.int64)
    if len(rows) != n_channels:
        raise InputError(f"{declared.path}: {series} has {n_channels} columns but {len(rows)} electrodes; correct it")
    table = _electrodes(declared, rows, f"{series}/electrodes")
    known = [[str(text) for text in np.asarray(table[name], object)[rows]] for name in ELECTRODE_NAMES if name in table]
    unique = next((names for names in known if len({*names}) == len(names)), None)
    return tuple(unique or (f"electrode{number}" for number in declared.numbers(f"{ELECTRODES}/id")[rows].tolist()))


def _electrodes(declared: Declared, rows: np.ndarray, where: str) -> dict[str, np.ndarray | list[str]]:
    """The columns of the table of electrodes, in which `rows` must lie; `where` says what names these rows."""
    n_electrodes = len(declared.numbers(f"{ELECTRODES}/id", "iu"))
    if not len(rows) or rows.min() < 0 or rows.max() >= n_electrodes:
        raise InputError(f"{declared.path}: {where} names rows that {n_electrodes} electrodes do not have; correct it")
    return dict(_columns(declared, ELECTRODES, n_electrodes))


def _ends_of(declared: Declared, name: str, n_rows: int, n_values: int) -> np.ndarray:
    """The end of the values of each row in a column of rows of any lengths, `(row,)`; InputError if they do not fit."""
    ends = declared.numbers(f"{name}_index", "iu").astype(np.int64)
    if len(ends) != n_rows or (np.diff(ends, prepend=0) < 0).any() or (n_rows and ends[-1] != n_values):
        raise InputError(f"{declared.path}: {name}_index does not fit {n_values} values of {n_rows} rows; correct it")
    return ends


AFFERENT = "afferent"
"""The column of units with the names of afferents."""
SPIKE_TIMES, OBSERVED, INVALID = "units/spike_times", "units/obs_intervals", "intervals/invalid_times"
UNITS = Words("`units`", "`units`", ("unit", "column"))


def _unit_names(declared: Declared, column: str) -> tuple[str, ...]:
    """The names of the units: from the requested column, else `unit` and the id."""
    path, ids = declared.path, declared.numbers("units/id", "iu").tolist()
    if not 0 < len(ids) <= MOST_AFFERENTS:
        raise InputError(f"{path}: has {len(ids)} units where 1 to {MOST_AFFERENTS} can be read; keep as many")
    if declared.holds(f"units/{column}"):
        names = tuple(str(name) for name in declared.column(f"units/{column}", len(ids)))
    elif column != AFFERENT:
        raise InputError(f"{path}: units have no column {column} ({_named(declared.group('units'))}); give another")
    else:
        names = tuple(f"unit{unit_id}" for unit_id in ids)
    twice = next((name for name in names if names.count(name) > 1), None) if len(set(names)) < len(names) else None
    if twice is not None:
        raise InputError(f"{path}: two units are called '{twice[:40]}'; name units by another column (`name`)")
    return names


def _kept_units(declared: Declared, names: Sequence[str], choice: TrialChoice) -> np.ndarray:
    """Which units are read, `(unit,)`: by their names, the columns of their table, and those of their electrodes."""
    if not choice:
        return np.ones(len(names), bool)
    table = {"name": list(names), **dict(_columns(declared, "units", len(names)))}
    unknown = {*choice.where, *choice.leave_out} - {*table}
    if unknown and declared.holds(ELECTRODES) and declared.holds("units/electrodes"):
        table |= {name: values for name, values in _of_electrodes(declared, len(names)).items() if name not in table}
    keep = choice.keeps(pd.DataFrame(table), str(declared.path), UNITS)
    choice.say(keep, str(declared.path), UNITS)
    return keep


def _of_electrodes(declared: Declared, n_units: int) -> dict[str, list[str]]:
    """The columns of the table of electrodes for each unit, as texts; several values of one unit are joined."""
    rows = declared.numbers("units/electrodes", "iu").astype(np.int64)
    is_ragged = declared.holds("units/electrodes_index")
    groups = np.split(rows, _ends_of(declared, "units/electrodes", n_units, len(rows))[:-1] if is_ragged else n_units)
    table = _electrodes(declared, rows, "units/electrodes")
    return {
        name: [", ".join(dict.fromkeys(str(np.asarray(values, object)[row]) for row in group)) for group in groups]
        for name, values in table.items()
    }


def _observed_by_units(
    declared: Declared,
    start_s: np.ndarray,
    stop_s: np.ndarray,
    kept: np.ndarray,
    names: Sequence[str],
    step_s: float,
    policy: Unobserved | None,
) -> np.ndarray:
    """Which trials the kept units observe whole, to a step, without invalid times, `(trial,)`.

    start_s, stop_s: of the trials. kept: of all units. names: of the kept units. A unit without intervals, in a file
    where others have some, is taken as observed throughout.
    """
    observed = np.ones((len(names), len(start_s)), bool)
    if len(names) and declared.holds(OBSERVED):
        spans = np.asarray(declared.value(OBSERVED), float)
        if spans.ndim != 2 or spans.shape[1] != 2:
            raise InputError(f"{declared.path}: {OBSERVED} has the shape {spans.shape} where (interval, 2) is expected")
        own = np.split(
            _checked(spans, f"{declared.path}: {OBSERVED}"), _ends_of(declared, OBSERVED, len(kept), len(spans))[:-1]
        )
        of_kept = [intervals_s for intervals_s, is_kept in zip(own, kept, strict=True) if is_kept]
        for unit, intervals_s in enumerate(of_kept):
            if len(intervals_s):
                observed[unit] = within(start_s, stop_s, intervals_s, step_s)
    return observed_trials(
        observed, names, policy, str(declared.path),
        invalid=touching(start_s, stop_s, _intervals(declared, INVALID), step_s),
        fix="leave units out with `leave_out_units={{'name': '{}'}}`",
    )  # fmt: skip


NOTES, OURS = "general/notes", "neurotact"
"""The field for data without a place in NWB (JSON), and the key that marks it."""
STEP_MS = 1.0
PREFIXES = {"": 1.0, "k": 1e3, "m": 1e-3, "u": 1e-6, "µ": 1e-6}
OF_TRIALS = "check its times of trials, which NWB has in seconds"
OF_SERIES = Fixes("save the series without it")
"""What mends a wrong column of a series."""


class _NWBSpec(Spec):
    """The parts of a file to read, and the clock."""

    step_ms: float | None = Field(default=None, gt=0)
    """The clock of spikes; the file's resolution of spike times when absent, else 1 ms."""
    merge_events: bool = False
    """Whether more than 1 % of the spikes may become one with another of their unit and step."""
    trials: str = "trials"
    """The table of intervals whose rows are trials."""
    label: str = LABEL
    """Its column with the class of each trial."""
    name: str = AFFERENT
    """The column of units with their names; `unit` and the id if there is none."""
    series: str | None = None
    """A time series that is read instead of the units; its columns are taxels."""
    unit: str | None = None
    """Unit of the series; that of the file when absent."""
    sampling_rate_Hz: float | None = Field(default=None, gt=0)
    """Of a series with time stamps; found from these when absent."""
    max_gap_ms: float | None = Field(default=None, gt=0)
    """The longest interval between the time stamps of a series; five median ones when absent."""
    drop_repeats: bool = False
    """Whether samples of a series with the time stamp of the one before are dropped, however many they are."""
    units: Where = {}
    """Values of columns of the units to read, or of their electrodes: `{ quality = "good" }`; `name` is their name."""
    leave_out_units: Where = {}
    """Values of columns of units that are not read."""
    unobserved: Unobserved | None = None
    """What becomes of trials that touch invalid times, or that a unit does not observe whole: left out, or read as
    silent; when absent, at most 10 % of the trials are left out."""

    @property
    def choice_of_units(self) -> TrialChoice:
        """The units to read."""
        return TrialChoice(self.units, self.leave_out_units)


class _Trials(NamedTuple):
    """Start and stop of each trial in s, `(trial,)`, its conditions, and digests and touches if the file has them."""

    start_s: np.ndarray
    stop_s: np.ndarray
    conditions: pd.DataFrame
    digests: list[str]
    touches: list[str]

    def chosen(self, keep: np.ndarray) -> _Trials:
        """The trials of which `keep`, `(trial,)`, is true."""
        told = ([name for name, kept in zip(text, keep, strict=False) if kept] for text in (self.digests, self.touches))
        return _Trials(self.start_s[keep], self.stop_s[keep], self.conditions[keep].reset_index(drop=True), *told)


def read(
    path: str | Path, spec: Mapping[str, Any] | None = None, choice: TrialChoice = EVERY
) -> SpikeTrains | Recordings:
    """The spike trains of the units of an NWB file, or with `series` the recordings of a time series.

    spec: keys of `_NWBSpec`. A spike at t belongs to each trial with start <= t < stop, and falls in step
    floor((t - start) / step); those of a unit within one step are one. Files from neurotact are restored step by step.
    Trials that touch `intervals/invalid_times`, or that a unit does not observe whole by its `obs_intervals`, are left
    out, with a line. choice: of the trials to read, before anything else of them is checked.
    Raises InputError for a file that is damaged, too large, or without trials, classes or spikes.
    """
    options = build(_NWBSpec, spec or {}, "import nwb")
    of_units = {
        "step_ms": options.step_ms, "name": options.name != AFFERENT, "merge_events": options.merge_events,
        "units": bool(options.choice_of_units),
    }  # fmt: skip
    of_series = {
        "unit": options.unit, "sampling_rate_Hz": options.sampling_rate_Hz, "max_gap_ms": options.max_gap_ms,
        "drop_repeats": options.drop_repeats,
    }  # fmt: skip
    wrong = next((name for name, value in (of_series if options.series is None else of_units).items() if value), None)
    if wrong is not None:
        what = "a time series" if options.series is None else "spikes of units"
        raise InputError(f"{path}: `{wrong}` is for {what}; drop it")
    with reading(path, "NWB", "the program that made it") as file:
        declared = Declared(file, path)
        trials = _trials(declared, options, choice)
        return _spikes(declared, trials, options) if options.series is None else _recordings(declared, trials, options)


@in_few_lines
def read_nwb(
    path: str | Path,
    *,
    trials: str = "trials",
    label: str = LABEL,
    step_ms: float | None = None,
    name: str = AFFERENT,
    series: str | None = None,
    unit: str | None = None,
    sampling_rate_Hz: float | None = None,
    max_gap_ms: float | None = None,
    drop_repeats: bool = False,
    units: Mapping[str, Any] | None = None,
    leave_out_units: Mapping[str, Any] | None = None,
    unobserved: Unobserved | None = None,
    merge_events: bool = False,
    where: Mapping[str, Any] | None = None,
    leave_out: str | Sequence[str] | Mapping[str, Any] | None = None,
) -> Recordings | SpikeTrains:
    """Read the spike trains of the units of an NWB file, or a time series, cut into trials: `neurotact import nwb`.

    trials: the table of intervals whose rows are trials. label: its column with the class of each.
    step_ms: of the clock of spikes; the file's resolution when None, else 1. name: the column of units with their
        names; their ids if there is none.
    series: a time series, whose columns are taxels, that is read in place of the units; unit: its unit, when None as
        the file says. sampling_rate_Hz, max_gap_ms, drop_repeats: of a series with time stamps, as of `read_folder`.
    units, leave_out_units: the units to read and to leave out, by columns of theirs or of their electrodes, such as
        `{"quality": "good"}`.
    unobserved: of trials that touch invalid times, or that a unit does not observe whole, leave all out or read them as
        silent; at most 10 % of the trials are left out when None.
    merge_events: whether more than 1 % of the spikes may become one with another.
    where, leave_out: the trials to keep and to leave out, by the columns of the table of trials, as of `read`.
    Raises InputError, which names the file and the fix.

    >>> _ = nt.to_nwb(nt.load_spikes("spikes.h5"), "spikes.nwb")
    >>> len(nt.read_nwb("spikes.nwb"))
    30
    """
    options = {
        "trials": trials, "label": label, "step_ms": step_ms, "name": name, "series": series, "unit": unit,
        "sampling_rate_Hz": sampling_rate_Hz, "max_gap_ms": max_gap_ms, "drop_repeats": drop_repeats,
        "units": units or {}, "leave_out_units": leave_out_units or {}, "unobserved": unobserved,
        "merge_events": merge_events,
    }  # fmt: skip
    return read(path, options, TrialChoice.of(where, leave_out))


READER = Reader("Neurodata Without Borders: spike times of units in trials, an NWB 2 file.", read)


# --- trials -----------------------------------------------------------------------------------------


def _trials(declared: Declared, spec: _NWBSpec, choice: TrialChoice) -> _Trials:
    path, table = declared.path, f"intervals/{spec.trials}"
    if not declared.holds(table):
        there = _named(declared.group("intervals")) if declared.holds("intervals") else "there is no table"
        raise InputError(f"{path}: holds no {table} ({there}); name the table of trials with `trials`")
    start_s, stop_s = (declared.numbers(f"{table}/{name}").astype(float) for name in ("start_time", "stop_time"))
    if len(start_s) != len(stop_s) or not len(start_s):
        raise InputError(f"{path}: {table} has {len(start_s)} starts and {len(stop_s)} stops; give one each per trial")
    extra = dict(_columns(declared, table, len(start_s)))
    if spec.label not in extra:
        raise InputError(
            f"{path}: no column of {table} is called {spec.label} ({', '.join(extra) or 'it has no other columns'}); "
            "name the class with `label`"
        )
    labels = extra.pop(spec.label)
    if extra.pop(LABEL, None) is not None:
        log.warning("%s: not used, since `label` names another: the column %s", path, LABEL)
    conditions = pd.DataFrame({LABEL: [str(label) for label in np.asarray(labels, object).tolist()], **extra})
    told = (declared.texts(f"{table}/{key}") if declared.holds(f"{table}/{key}") else [] for key in (DIGEST, TOUCH))
    choice = choice.with_label(spec.label)
    keep = choice.keeps(conditions, str(path))
    if choice:
        choice.say(keep, str(path))
    wrong = np.flatnonzero(keep & ~(np.isfinite(start_s) & np.isfinite(stop_s) & (start_s < stop_s)))
    if len(wrong):
        row = wrong[0]
        raise InputError(
            f"{path}: trial {row} lasts from {start_s[row]:g} s to {stop_s[row]:g} s; correct it, or leave it out with "
            "`leave_out`"
        )
    names = (names_of_trials if len(names_of_trials) == len(start_s) else [] for names_of_trials in told)
    return _Trials(start_s, stop_s, conditions, *names).chosen(keep)


# --- spikes -----------------------------------------------------------------------------------------


def _spikes(declared: Declared, trials: _Trials, spec: _NWBSpec) -> SpikeTrains:
    path = declared.path
    if not declared.holds("units/spike_times"):
        raise InputError(
            f"{path}: holds no spike times of units; name a time series with `series` ({_of_series(declared)})"
        )
    stamps = declared.numbers("units/spike_times")
    afferents = _unit_names(declared, spec.name)
    ends = _ends_of(declared, SPIKE_TIMES, len(afferents), len(stamps))
    unit = np.repeat(np.arange(len(afferents)), np.diff(ends, prepend=0))
    if not np.isfinite(stamps).all():
        spike = int(np.flatnonzero(~np.isfinite(stamps))[0])
        raise InputError(f"{path}: spike {spike} of '{afferents[unit[spike]]}' is at {stamps[spike]} s; drop it")
    kept = _kept_units(declared, afferents, spec.choice_of_units)
    if not kept.all():
        afferents = tuple(name for name, is_kept in zip(afferents, kept, strict=True) if is_kept)
        of_kept = kept[unit]
        stamps, unit = stamps[of_kept], (np.cumsum(kept) - 1)[unit[of_kept]]
    notes = _notes(declared)
    own_Hz = float(notes.get("sampling_rate_Hz") or 1 / _resolution_s(declared))
    rate_Hz = own_Hz if spec.step_ms is None else 1e3 / spec.step_ms
    longest = float((trials.stop_s - trials.start_s).max()) * rate_Hz
    if longest > LONGEST_STEPS:
        raise InputError(f"{path}: a trial has {longest:g} steps of {1e3 / rate_Hz:g} ms; give a longer `step_ms`")
    times_s = trials.start_s, trials.stop_s
    trials = trials.chosen(_observed_by_units(declared, *times_s, kept, afferents, 1 / rate_Hz, spec.unobserved))
    order = np.argsort(stamps, kind="stable")
    times = event_times(stamps[order], 1.0)
    cuts = _of_trials(times, trials, rate_Hz)
    n_read = sum(len(cut) for cut in cuts)
    check_size(f"{path}: the spikes of its trials", BYTES_PER_EVENT * n_read)
    n_outside = len(stamps) - len(np.unique(np.concatenate(cuts)))
    if n_outside:
        log.warning("%s: %d of %d spikes are in no trial and left out", path, n_outside, len(stamps))
    since = [times.at(cut).since(start_s) for cut, start_s in zip(cuts, trials.start_s.tolist(), strict=True)]
    return trains_with_ends(
        [(its, unit[order[cut]]) for its, cut in zip(since, cuts, strict=True)],
        event_times(trials.stop_s, 1.0).since(trials.start_s), rate_Hz, afferents, trials.conditions, str(path),
        merge_events=spec.merge_events, fix=OF_TRIALS, told=(trials.digests, trials.touches),
        encoder=notes.get("encoder") if rate_Hz == own_Hz and kept.all() else None,
        source=str(notes.get("source") or path),
        recorded_Hz=float(notes["recorded_Hz"]) if "recorded_Hz" in notes else None,
    )  # fmt: skip


def _of_trials(times: EventTimes, trials: _Trials, rate_Hz: float) -> list[np.ndarray]:
    """The spikes of each trial, from just before it begins to just before it ends; overlapping trials share spikes.

    times: ascending. A spike at the beginning of a trial may be a little earlier because it is rounded.
    """
    bounds = []
    for bounds_s in (trials.start_s, trials.stop_s):
        error_s = np.interp(bounds_s, times.time_s, times.error_s) if len(times.time_s) else np.zeros(len(bounds_s))
        slack_s = np.minimum(np.maximum(error_s, SLACK / rate_Hz), 0.5 / rate_Hz)
        bounds.append(np.searchsorted(times.time_s, bounds_s - slack_s).tolist())
    return [np.arange(first, last) for first, last in zip(*bounds, strict=True)]


def _resolution_s(declared: Declared) -> float:
    """The smallest difference of spike times, from the file; 1 ms if it gives no usable one."""
    dataset = declared.file["units/spike_times"]
    resolution_s = float(attribute(dataset, "resolution", declared.path)) if "resolution" in dataset.attrs else math.nan
    return resolution_s if 1e-9 < resolution_s < 1e3 else STEP_MS * 1e-3


def _notes(declared: Declared) -> dict[str, Any]:
    """The notes of neurotact in the file; empty in files of other programs."""
    if not declared.holds(NOTES):
        return {}
    try:
        notes = json.loads(str(declared.value(NOTES)))[OURS]
        rates_Hz = float(notes["sampling_rate_Hz"]), float(notes.get("recorded_Hz", 1.0))
    except (ValueError, LookupError, TypeError, RecursionError):
        return {}
    is_whole = isinstance(notes.get("encoder"), dict) and isinstance(notes.get("source"), str)
    return notes if is_whole and all(math.isfinite(rate_Hz) and rate_Hz > 0 for rate_Hz in rates_Hz) else {}


# --- recordings -------------------------------------------------------------------------------------


def _recordings(declared: Declared, trials: _Trials, spec: _NWBSpec) -> Recordings:
    path, series = declared.path, _place_of(declared, str(spec.series))
    none = np.ones(0, bool)  # no unit: the samples of a series are observed
    times_s = trials.start_s, trials.stop_s
    trials = trials.chosen(_observed_by_units(declared, *times_s, none, (), SLACK, spec.unobserved))
    data = declared.streamed(f"{series}/data")
    if data.ndim > 2 or not data.size:
        raise InputError(f"{path}: {series} has the shape {data.shape} where (time, taxel) is expected; name another")
    _check_time_is_first(declared, series, data.shape, trials)
    factor, offset = _conversion(declared, series, 1 if data.ndim == 1 else data.shape[1])
    said = str(attribute(data, "unit", path) if "unit" in data.attrs else "")
    unit = spec.unit or SYMBOLS.get(said, said)
    scale = _scale(SYMBOLS.get(said, said), unit, f"{path}: {series}")
    factor, offset = scale * factor, scale * offset
    cuts, rate_Hz, time_s = _cuts(declared, series, len(data), trials)
    if rate_Hz is not None and spec.sampling_rate_Hz is not None:
        raise InputError(f"{path}: `sampling_rate_Hz`: {series} says its rate, {rate_Hz:g} Hz; leave it out")
    n_samples = sum(stop - start for start, stop in cuts)
    check_size(f"{path}: the trials of {series}", 8 * n_samples * math.prod(data.shape[1:]))
    channels, read = _electrodes_of(declared, series, 1 if data.ndim == 1 else data.shape[1]), []
    for trial, (start, stop) in enumerate(cuts):
        signal = data[start:stop].reshape(stop - start, -1) * factor + offset
        check_digits(signal, f"{path}: {series}, trial {trial}")
        table = Samples(channels, signal, None if time_s is None else time_s[start:stop], 0, "s")
        read.append(Read(f"{path}: {series}, trial {trial}", f"trial {trial}", table))
    return recordings_of(
        read, trials.conditions, rate_Hz or spec.sampling_rate_Hz, unit, max_gap_ms=spec.max_gap_ms,
        drop_repeats=spec.drop_repeats, source=str(path), where=str(path), fixes=OF_SERIES,
    )  # fmt: skip


def _check_time_is_first(declared: Declared, series: str, shape: tuple[int, ...], trials: _Trials) -> None:
    """Refuse samples of which the second axis, and not the first, is as long as the stamps or the trials."""
    n_rows, n_columns = shape if len(shape) == 2 else (shape[0], 0)
    if declared.holds(f"{series}/timestamps"):
        n_stamps = declared.file[f"{series}/timestamps"].size
        is_second = n_rows != n_stamps == n_columns
    else:
        rate_Hz = float(attribute(declared.file[f"{series}/starting_time"], "rate", declared.path))
        n_needed = (trials.stop_s.max(initial=0) - float(declared.value(f"{series}/starting_time"))) * rate_Hz
        is_second = n_rows + 1 < n_needed <= n_columns + 1
    if is_second:
        raise InputError(
            f"{declared.path}: {series} has the shape {shape}, which is (taxel, time) by its times; NWB has the time "
            "first: write the series transposed"
        )


def _scale(said: str, wanted: str, where: str) -> float:
    """The factor from the unit that a file says to the wanted one; 1 if one of them is not known.

    >>> _scale("N", "mN", "a.nwb"), _scale("V", "V", "a.nwb"), _scale("a.u.", "mV", "a.nwb")
    (1000.0, 1.0, 1.0)
    """
    known = {
        prefix + base: (base, factor) for base in {*SYMBOLS.values()} for prefix, factor in PREFIXES.items()
    }  # fmt: skip
    if not {said, wanted} <= known.keys():
        return 1.0
    (base, factor), (other, wanted_factor) = known[said], known[wanted]
    if base != other:
        raise InputError(f"{where}: is in {said}, which is not measured in {wanted}; leave out `unit`")
    return factor / wanted_factor


def _conversion(declared: Declared, series: str, n_channels: int) -> tuple[np.ndarray, float]:
    """The factor of stored numbers, per channel, and the offset added afterwards (NWB: conversion, offset)."""
    attributes = declared.file[f"{series}/data"].attrs
    factor, offset = (
        float(attribute(declared.file[f"{series}/data"], name, declared.path)) if name in attributes else default
        for name, default in (("conversion", 1.0), ("offset", 0.0))
    )
    own = np.ones(n_channels)
    if declared.holds(f"{series}/channel_conversion"):
        own = declared.numbers(f"{series}/channel_conversion").astype(float)
    if len(own) != n_channels:
        raise InputError(f"{declared.path}: {series} has {n_channels} channels but {len(own)} conversions of them")
    return factor * own, offset


def _cuts(
    declared: Declared, series: str, n_samples: int, trials: _Trials
) -> tuple[list[tuple[int, int]], float | None, np.ndarray | None]:
    """First sample and end (exclusive) of each trial, samples per second, and the time stamps if there is no rate."""
    path, rate_Hz, time_s = declared.path, None, None
    if declared.holds(f"{series}/starting_time"):
        begin = declared.file[f"{series}/starting_time"]
        first_s, rate_Hz = float(declared.value(f"{series}/starting_time")), float(attribute(begin, "rate", path))
        if not (math.isfinite(first_s) and math.isfinite(rate_Hz) and rate_Hz > 0):
            raise InputError(f"{path}: {series} starts at {first_s} s with {rate_Hz} samples per second; correct it")
        bounds = [np.ceil((bounds_s - first_s) * rate_Hz - SLACK) for bounds_s in (trials.start_s, trials.stop_s)]
        outside = (bounds[0] < 0) | (bounds[1] > n_samples + 1)
    else:
        time_s = declared.numbers(f"{series}/timestamps").astype(float)
        if len(time_s) != n_samples or (np.diff(time_s) < 0).any() or not np.isfinite(time_s).all():
            raise InputError(f"{path}: {series}/timestamps must rise, one per sample; correct them")
        bounds = [np.searchsorted(row_times(time_s), bounds_s) for bounds_s in (trials.start_s, trials.stop_s)]
        outside = bounds[1] - bounds[0] < 2
    wrong = np.flatnonzero(outside)
    if len(wrong):
        row = wrong[0]
        raise InputError(
            f"{path}: trial {row} lasts from {trials.start_s[row]:g} s to {trials.stop_s[row]:g} s, where {series} has "
            "no samples; drop the trial or name another series"
        )
    cuts = [(int(a), min(int(b), n_samples)) for a, b in zip(*bounds, strict=True)]
    return cuts, rate_Hz, time_s


def _place_of(declared: Declared, name: str) -> str:
    """The path of a time series, given its name or path."""
    series = [path for path in _places(declared) if name in (path, path.rpartition("/")[2])]
    if len(series) != 1:
        what = "no time series is" if not series else f"{len(series)} time series are"
        raise InputError(f"{declared.path}: {what} called '{name}' ({_of_series(declared)}); give its full path")
    return series[0]


def _of_series(declared: Declared) -> str:
    places = [path for path, _ in zip(_places(declared), range(MOST_NAMED), strict=False)]
    return f"there is {', '.join(places)}" if places else "there is none"


def _places(declared: Declared) -> Iterator[str]:
    """The time series of a file: groups with data and its times."""
    for top in ("acquisition", "stimulus/presentation", "processing"):
        if declared.holds(top):
            yield from _below(declared.group(top), top, depth=3)


def _below(group: h5py.Group, group_path: str, depth: int) -> Iterator[str]:
    for name, member in own_members(group):
        own = f"{group_path}/{name}"
        if isinstance(member, h5py.Group):
            if "data" in member and ("starting_time" in member or "timestamps" in member):
                yield own
            elif depth > 1:
                yield from _below(member, own, depth - 1)
