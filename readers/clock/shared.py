"""Rows that share a time stamp: batches, whole seconds or a clock that is coarser than the samples, spread evenly.

A clock that counts coarsely gives several rows one stamp, and the rows of a batch have the stamp of the batch. Such
rows lie between their stamp and the next one.
"""

from typing import NamedTuple

import numpy as np

BATCH = 2.0
"""Rows per stamp, on average, from which on rows come in batches; below it, rows share a stamp now and then."""
UNEVEN, FEW_ROWS = 0.25, 2.0
"""Rows of a stamp may differ from those of its time by this share, or by a few, where batches are even."""
EARLY_OR_LATE = 0.75
"""Share of the time between two batches by which their stamps may be early or late, but less than a lost batch."""


class Uneven(NamedTuple):
    """The first stamp whose number of rows does not fit: its first row, its rows, its time and the usual number."""

    row: int
    n_rows: int
    lasts_s: float
    usual: float


class _Stamps(NamedTuple):
    """Distinct stamps in s, `(stamp,)`, the first row of each, and their numbers of rows."""

    time_s: np.ndarray
    first: np.ndarray
    n_rows: np.ndarray


def spread(time_s: np.ndarray, resolution_s: float, sample_s: float | None = None) -> np.ndarray | Uneven | None:
    """The times of rows whose stamps ascend and repeat, `(row,)` in s from the first row on, or why they are unknown.

    The first batch may be cut at its start and the last one at its end. All rows are on one line if it deviates from
    the stamps by no more than the resolution of the clock, or where rows come in batches by less than a batch lasts.
    Otherwise the rows of a stamp are spread evenly up to the next one.

    resolution_s: of the clock. sample_s: interval of the samples, for less than three stamps.
    None: less than three stamps, and no interval that fits.

    >>> spread(np.array([0.0, 0.0, 1.0, 1.0, 1.0, 2.0, 2.0, 2.0, 3.0]), 1.0).round(3).tolist()
    [0.0, 0.333, 0.667, 1.0, 1.333, 1.667, 2.0, 2.333, 2.667]
    >>> spread(np.repeat([0.0, 1.0, 2.0, 3.0, 4.0], [4, 10, 10, 30, 2]), 1.0)
    Uneven(row=24, n_rows=30, lasts_s=1.0, usual=10.0)
    """
    stamps = _stamps(time_s)
    if len(stamps.time_s) < 3:
        return None if sample_s is None else _of_few(stamps, len(time_s), sample_s)
    interval_s, usual_s = _interval(stamps), _usual_interval(stamps)
    is_line = _deviation(stamps, interval_s) < _rounding(stamps, resolution_s)
    uneven = None if is_line and _are_equal(stamps) else _first_uneven(stamps, usual_s)
    if uneven is not None:
        return uneven
    return np.arange(len(time_s)) * interval_s if is_line else _between_stamps(stamps, interval_s)


def own_interval(time_s: np.ndarray) -> float | None:
    """The interval of samples that share stamps, in s; None if no stamp is shared, or if they are too few or uneven."""
    stamps = _stamps(time_s)
    if len(stamps.time_s) in (len(time_s), 1, 2) or (np.diff(time_s) < 0).any():
        return None
    is_even = _are_equal(stamps) or _first_uneven(stamps, _usual_interval(stamps)) is None
    return _interval(stamps) if is_even else None


def on_line(time_s: np.ndarray, resolution_s: float, interval_s: float) -> bool:
    """Whether rows at this interval have these stamps, but for how they are rounded."""
    stamps = _stamps(time_s)
    if len(stamps.time_s) < 3:
        return _of_few(stamps, len(time_s), interval_s) is not None
    is_even = _are_equal(stamps) or _first_uneven(stamps, interval_s) is None
    return is_even and _deviation(stamps, interval_s) < _rounding(stamps, resolution_s)


def _stamps(time_s: np.ndarray) -> _Stamps:
    first = np.flatnonzero(np.concatenate([[True], np.diff(time_s) != 0]))
    return _Stamps(time_s[first], first, np.diff(first, append=len(time_s)))


def _interval(stamps: _Stamps) -> float:
    """The interval of samples: the slope of the line through the first row of each stamp but the first one.

    The first row of a stamp comes less than a sample after it, wherever the recording began within the first stamp.
    """
    row, time_s = stamps.first[1:] - stamps.first[1:].mean(), stamps.time_s[1:] - stamps.time_s[1:].mean()
    return float((row * time_s).sum() / (row * row).sum())


def _usual_interval(stamps: _Stamps) -> float:
    """The median interval of samples within the stamps that are whole."""
    return float(np.median(np.diff(stamps.time_s)[1:] / stamps.n_rows[1:-1]))


def _deviation(stamps: _Stamps, interval_s: float) -> float:
    """The range of the deviations of stamps from the line of their first rows."""
    return float(np.ptp(stamps.time_s[1:] - interval_s * stamps.first[1:]))


def _rounding(stamps: _Stamps, resolution_s: float) -> float:
    """How far the stamps may be from a line: less than a row that was written twice, or than a batch that was lost."""
    batch_s = float(np.median(np.diff(stamps.time_s)))
    return EARLY_OR_LATE * batch_s if _in_batches(stamps) else 0.999 * resolution_s


def _in_batches(stamps: _Stamps) -> bool:
    return float(stamps.n_rows[1:-1].mean()) >= BATCH


def _are_equal(stamps: _Stamps) -> bool:
    """Whether each stamp has as many rows as the others, but for the cut first and last one."""
    usual = stamps.n_rows[1]
    return bool((stamps.n_rows[1:-1] == usual).all() and max(stamps.n_rows[0], stamps.n_rows[-1]) <= usual)


def _first_uneven(stamps: _Stamps, interval_s: float) -> Uneven | None:
    """The first stamp with too many rows for its time, or with too few where rows come in batches."""
    lasts_s = np.diff(stamps.time_s)
    lasts_s = np.append(lasts_s, np.median(lasts_s))
    expected = lasts_s / interval_s
    allowed = np.maximum(FEW_ROWS, UNEVEN * expected)
    wrong = stamps.n_rows > expected + allowed
    if _in_batches(stamps):
        wrong[1:-1] |= stamps.n_rows[1:-1] < (expected - allowed)[1:-1]
    if not wrong.any():
        return None
    i = int(np.argmax(wrong))
    return Uneven(int(stamps.first[i]), int(stamps.n_rows[i]), float(lasts_s[i]), float(expected[i]))


def _between_stamps(stamps: _Stamps, interval_s: float) -> np.ndarray:
    """Each row between its stamp and the next one; rows of a cut first batch end at the second stamp."""
    lasts_s = np.append(np.diff(stamps.time_s), np.inf)
    step_s = lasts_s / stamps.n_rows
    step_s[[0, -1]] = np.minimum(step_s[[0, -1]], interval_s)
    begin_s = stamps.time_s.copy()
    begin_s[0] = stamps.time_s[1] - stamps.n_rows[0] * step_s[0]
    rank = np.arange(stamps.n_rows.sum()) - np.repeat(stamps.first, stamps.n_rows)
    times_s = np.repeat(begin_s, stamps.n_rows) + rank * np.repeat(step_s, stamps.n_rows)
    return times_s - times_s[0]


def _of_few(stamps: _Stamps, n_rows: int, sample_s: float) -> np.ndarray | None:
    """Rows of one or two stamps at a known interval; None if the rows of the first stamp do not fit before the second.

    The rows of a whole stamp are not known here, so that it may hold any number of rows up to that of its time.
    """
    if len(stamps.time_s) == 2:
        expected = float(stamps.time_s[1] - stamps.time_s[0]) / sample_s
        if stamps.n_rows.max() > expected + max(FEW_ROWS, UNEVEN * expected):
            return None
    return np.arange(n_rows) * sample_s
