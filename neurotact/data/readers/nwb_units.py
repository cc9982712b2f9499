"""The units of an NWB file: their names, those to read, and the trials in which all of these were observed."""

from collections.abc import Sequence

import numpy as np
import pandas as pd

from neurotact.data.hdf5_input import Declared
from neurotact.data.readers.event_times import SLACK
from neurotact.data.readers.events import MOST_AFFERENTS
from neurotact.data.readers.nwb_tables import ELECTRODES, checked, columns, electrodes, ends_of, intervals, named
from neurotact.data.readers.observed import Unobserved, observed_trials, touching, within
from neurotact.data.trial_choice import TrialChoice, Words
from neurotact.errors import InputError

AFFERENT = "afferent"
"""The column of units with the names of afferents."""
SPIKE_TIMES, OBSERVED, INVALID = "units/spike_times", "units/obs_intervals", "intervals/invalid_times"
UNITS = Words("`units`", "`units`", ("unit", "column"))


def unit_names(declared: Declared, column: str) -> tuple[str, ...]:
    """The names of the units: from the requested column, else `unit` and the id."""
    path, ids = declared.path, declared.numbers("units/id", "iu").tolist()
    if not 0 < len(ids) <= MOST_AFFERENTS:
        raise InputError(f"{path}: has {len(ids)} units where 1 to {MOST_AFFERENTS} can be read; keep as many")
    if declared.holds(f"units/{column}"):
        names = tuple(str(name) for name in declared.column(f"units/{column}", len(ids)))
    elif column != AFFERENT:
        raise InputError(f"{path}: units have no column {column} ({named(declared.group('units'))}); give another")
    else:
        names = tuple(f"unit{unit_id}" for unit_id in ids)
    twice = next((name for name in names if names.count(name) > 1), None) if len(set(names)) < len(names) else None
    if twice is not None:
        raise InputError(f"{path}: two units are called '{twice[:40]}'; name units by another column (`name`)")
    return names


def unit_of_each(declared: Declared, n_spikes: int, n_units: int) -> np.ndarray:
    """The unit of each spike: `spike_times_index` holds the end of the spikes of each unit."""
    return np.repeat(np.arange(n_units), np.diff(ends_of(declared, SPIKE_TIMES, n_units, n_spikes), prepend=0))


def kept_units(declared: Declared, names: Sequence[str], choice: TrialChoice) -> np.ndarray:
    """Which units are read, `(unit,)`: by their names, the columns of their table, and those of their electrodes."""
    if not choice:
        return np.ones(len(names), bool)
    table = {"name": list(names), **dict(columns(declared, "units", len(names)))}
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
    groups = np.split(rows, ends_of(declared, "units/electrodes", n_units, len(rows))[:-1] if is_ragged else n_units)
    table = electrodes(declared, rows, "units/electrodes")
    return {
        name: [", ".join(dict.fromkeys(str(np.asarray(values, object)[row]) for row in group)) for group in groups]
        for name, values in table.items()
    }


def observed_by_units(
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
    if declared.holds(OBSERVED):
        spans = np.asarray(declared.value(OBSERVED), float)
        if spans.ndim != 2 or spans.shape[1] != 2:
            raise InputError(f"{declared.path}: {OBSERVED} has the shape {spans.shape} where (interval, 2) is expected")
        own = np.split(
            checked(spans, f"{declared.path}: {OBSERVED}"), ends_of(declared, OBSERVED, len(kept), len(spans))[:-1]
        )
        of_kept = [intervals_s for intervals_s, is_kept in zip(own, kept, strict=True) if is_kept]
        for unit, intervals_s in enumerate(of_kept):
            if len(intervals_s):
                observed[unit] = within(start_s, stop_s, intervals_s, step_s)
    return observed_trials(
        observed, names, policy, str(declared.path), invalid=_invalid(declared, start_s, stop_s, step_s),
        fix="leave units out with `leave_out_units={{'name': '{}'}}`",
    )  # fmt: skip


def valid_trials(declared: Declared, start_s: np.ndarray, stop_s: np.ndarray, policy: Unobserved | None) -> np.ndarray:
    """Which trials of a time series have no invalid times, `(trial,)`; its samples are observed."""
    observed, invalid = np.ones((0, len(start_s)), bool), _invalid(declared, start_s, stop_s, SLACK)
    return observed_trials(observed, (), policy, str(declared.path), fix="", invalid=invalid)


def _invalid(declared: Declared, start_s: np.ndarray, stop_s: np.ndarray, step_s: float) -> np.ndarray:
    """Which trials touch the invalid times of the file for more than a step, `(trial,)`."""
    return touching(start_s, stop_s, intervals(declared, INVALID), step_s)
