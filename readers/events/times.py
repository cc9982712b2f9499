"""The steps of events on a clock, found within the resolution that their stamps show.

Stamps are rounded to whole microseconds, cut off, stored as float32, or count from long before the trial. So the stamp
of an event at the beginning of a step may be a little earlier, in the step of the event before. Where stamps are as
near to the beginnings of steps as they can show, an event belongs to the step that begins there; elsewhere to the step
in which its stamp is.
"""

from collections.abc import Iterator, Sequence
from functools import lru_cache
from typing import Literal, NamedTuple

import numpy as np

Origin = Literal["zero", "first"]
NOISE = 1e-9
"""Tolerance of times in double precision, as a share of a step."""
SLACK = 1e-6
"""Tolerance of the bounds of trials, which are sums of many times, as a share of a step."""
FLOAT_ERROR = 2.0
"""Error of a stamp in units in the last place: of a product of two rounded numbers, and of the origin."""
MOST_DECIMALS = 12
VISIBLE = 0.4
"""Numbers show a decimal if they are exact to this share of it."""
FLOAT32_DIGITS = 9
"""Digits that tell any two numbers of float32 apart."""
ON_CLOCK = 0.5
"""Stamps are on a clock if more than this share of those that are not near a beginning by chance are near one."""
MOST_COMPARED = 100_000
"""Stamps, evenly chosen, that are compared with a clock."""
BITS = (16, 20, 24, 28, 31, 32)
"""Bits of counters of time that begin again, the fewest first."""
SURE_BITS, WRAP_STEPS = 31, 1
"""Counters of so many bits begin again even over a long pause; those of fewer by so many of the longest other steps."""
NO_ORDER = 1 / 3
"""If more than this share of the events are earlier than the one before, a file is in no order of time."""
LATTICE = 4096
CUT = 0.999
KNOWN, LIKELY, SURE = 0.0, float(np.log(20)), float(np.log(1000))
"""How many times less likely chance has to be than the clock, as logarithms."""


class _Resolution(NamedTuple):
    """A difference of adjacent stamps in s, and what it takes to believe that the stamps are rounded to it."""

    unit_s: float
    evidence: float


class EventTimes(NamedTuple):
    """Times of events in s from the origin of their trial, and the error of each by the precision of its number.

    time_s, error_s: `(event,)`. resolutions: those that the stamps may have.
    """

    time_s: np.ndarray
    error_s: np.ndarray
    resolutions: tuple[_Resolution, ...] = ()

    def at(self, index: np.ndarray) -> "EventTimes":
        """The times of some events."""
        return EventTimes(self.time_s[index], self.error_s[index], self.resolutions)

    def since(self, start_s: float | np.ndarray) -> "EventTimes":
        """The times from a later origin, which is itself rounded; none is before it."""
        error_s = self.error_s + FLOAT_ERROR * np.spacing(np.abs(start_s))
        return EventTimes(np.maximum(self.time_s - start_s, 0.0), error_s, self.resolutions)


class Rounding(NamedTuple):
    """How stamps lie about the beginnings of steps: `shift_s` earlier, and from there within `width_s`."""

    shift_s: float
    width_s: float


def event_times(
    stamps: np.ndarray,
    unit_s: float,
    origin: Origin = "zero",
    trial: np.ndarray | None = None,
    texts: np.ndarray | None = None,
) -> EventTimes:
    """The times of events; stamps that are whole numbers stay whole until the origin is taken off.

    stamps: finite numbers, `(event,)`. origin: time zero, or the first event of each trial. trial: that of each event,
    from 0 on; one for all when None. texts: the cells from which stamps were read.

    >>> times = event_times(np.array([1_700_000_000_000_000, 1_700_000_000_001_000]), 1e-6, "first")
    >>> times.time_s.tolist(), [resolution.unit_s for resolution in times.resolutions]
    ([0.0, 0.001], [1e-06, 0.001])
    """
    since = stamps.astype(float) if origin == "zero" or not len(stamps) else _from_first(stamps, trial)
    error = np.zeros(len(stamps)) if stamps.dtype.kind in "iu" else _error_of(stamps, texts)
    resolutions = tuple(_Resolution(unit * unit_s, evidence) for unit, evidence in _units_of(stamps, error, texts))
    return EventTimes(since * unit_s, error * unit_s, resolutions)


def _from_first(stamps: np.ndarray, trial: np.ndarray | None) -> np.ndarray:
    is_whole = stamps.dtype.kind in "iu"
    values = stamps if is_whole else stamps.astype(float)
    trial = np.zeros(len(stamps), np.int64) if trial is None else trial
    first = np.full(int(trial.max()) + 1, np.iinfo(values.dtype).max if is_whole else np.inf, values.dtype)
    np.minimum.at(first, trial, values)
    if not is_whole:
        return values - first[trial]
    return (values.astype(np.uint64) - first.astype(np.uint64)[trial]).astype(float)  # exact modulo 2^64


def _error_of(stamps: np.ndarray, texts: np.ndarray | None) -> np.ndarray:
    """The error of each stamp, a float, by its type or the digits that were written, in its own unit."""
    size = np.abs(stamps)
    if texts is None:
        was_float32 = (stamps == _float32(stamps)).all() and (stamps != np.rint(stamps)).any()
        return FLOAT_ERROR * np.spacing(_float32(size) if was_float32 and size.itemsize > 4 else size).astype(float)
    decimals, digits = _written(texts)
    error = FLOAT_ERROR * np.spacing(size)
    if digits <= FLOAT32_DIGITS and (_float32(stamps).astype(str).astype(float) == stamps).all():
        error = FLOAT_ERROR * np.spacing(_float32(size)).astype(float)
    last = 10.0 ** (np.floor(np.log10(np.where(size > 0, size, 1.0))) + 1 - digits)
    return np.maximum(error, np.where(last > 1.5 * 10.0**-decimals, last, 0.0))


def _float32(values: np.ndarray) -> np.ndarray:
    with np.errstate(over="ignore"):
        return values.astype(np.float32)


def _units_of(stamps: np.ndarray, error: np.ndarray, texts: np.ndarray | None) -> Iterator[tuple[float, float]]:
    """The last digit of stamps and the evidence for it; and the greatest common divisor of stamps, in the same unit."""
    stamps, error = _some(stamps), _some(error)
    if not len(stamps):
        return
    if stamps.dtype.kind in "iu":
        unit, whole, evidence = 1.0, stamps.astype(np.uint64) - stamps.astype(np.uint64)[0], KNOWN
    else:
        unit = _shown(stamps.astype(float), error / FLOAT_ERROR) if texts is None else 10.0 ** -_written(texts)[0]
        if unit == 0.0 or np.ptp(stamps.astype(float)) / unit > 2.0**53:
            return
        whole = np.rint((stamps.astype(float) - float(stamps[0])) / unit)
        evidence = LIKELY if texts is None and unit < 1 else KNOWN
    yield unit, evidence
    yield unit * float(np.gcd.reduce(whole.astype(np.int64))), SURE


def _some(values: np.ndarray) -> np.ndarray:
    return values[:: max(1, len(values) // MOST_COMPARED)]


def _written(texts: np.ndarray) -> tuple[int, int]:
    """The most decimals of any cell, and the most digits from the first that is not zero.

    >>> _written(np.array(["0.033", "12.50", "1.5e-05"]))
    (6, 4)
    """
    decimals = digits = 0
    for text in _some(texts).tolist():
        mantissa, _, exponent = text.strip().lower().partition("e")
        whole, _, fraction = mantissa.partition(".")
        decimals = max(decimals, len(fraction) - int(exponent or 0))
        digits = max(digits, len((whole + fraction).lstrip("+-0")))
    return decimals, digits


def _shown(values: np.ndarray, ulp: np.ndarray) -> float:
    """The last decimal that numbers show, 1 if they are whole; 0 if they show all that their type holds."""
    if ulp.max() < 1 and (values == np.rint(values)).all():
        return 1.0
    for decimals in range(1, MOST_DECIMALS + 1):
        scaled = values * 10.0**decimals
        exact = ulp * 10.0**decimals + np.spacing(np.abs(scaled))
        tells = exact < VISIBLE  # of float32, late stamps hold fewer decimals than early ones
        if not tells.all() and -np.log(2 * exact[tells & (values != 0)]).sum() <= SURE:
            break
        if (np.abs(scaled - np.rint(scaled)) <= exact)[tells].all():
            return 10.0**-decimals
    return 0.0


def joined_times(parts: Sequence[EventTimes]) -> EventTimes:
    """Times of events of several files; the finest resolution of any."""
    return EventTimes(
        np.concatenate([part.time_s for part in parts]),
        np.concatenate([part.error_s for part in parts]),
        min((part.resolutions for part in parts if len(part.time_s)), default=()),
    )


class InOrder(NamedTuple):
    """Stamps that rise throughout a trial; those that do not are counted.

    n_back: events earlier than the one before them. n_wraps: how often a counter (`BITS`) began again, which is undone.
    """

    stamps: np.ndarray
    n_back: int = 0
    n_wraps: int = 0


def in_order(
    stamps: np.ndarray, trial: np.ndarray, afferent: Sequence[np.ndarray], *, may_wrap: bool = True
) -> InOrder:
    """Stamps in the order of a file, in which a counter may begin again: whole numbers then go on.

    afferent: what tells afferents apart, `(event,)` each. Tables of one afferent after the other, or in no order at
    all, are not out of order. may_wrap: whether a trial can be as long as the range of a counter.

    >>> in_order(np.array([2**32 - 2, 2**32 - 1, 1, 0, 2]), np.zeros(5, int), [np.array([0, 1, 0, 1, 0])])
    InOrder(stamps=array([4294967294, 4294967295, 4294967297, 4294967296, 4294967298]), n_back=1, n_wraps=1)
    """
    order = np.argsort(trial, kind="stable")
    ordered, of_trial = stamps[order], trial[order]
    follows = of_trial[1:] == of_trial[:-1]
    is_back = follows & (ordered[1:] < ordered[:-1])
    if not is_back.any():
        return InOrder(stamps)
    groups = of_trial
    for names in afferent:
        values, index = np.unique(names[order], return_inverse=True)
        groups = groups * len(values) + index
    changes = np.diff(groups) != 0
    if np.count_nonzero(changes) + 1 == len(np.unique(groups)) and not (is_back & ~changes).any():
        return InOrder(stamps)
    n_wraps = 0
    for bits in BITS if may_wrap and ordered.dtype.kind in "iu" else ():
        rounds = _rounds(ordered, follows, bits)
        if rounds is not None:
            n_wraps = int(np.diff(rounds, prepend=0).clip(min=0).sum())
            ordered = ordered.astype(np.int64) + 2**bits * rounds
            stamps = np.empty(len(ordered), np.int64)
            stamps[order] = ordered
            break
    n_back = int((follows & (ordered[1:] < ordered[:-1])).sum())
    return InOrder(stamps, n_back if n_back <= NO_ORDER * follows.sum() else 0, n_wraps)


def _rounds(stamps: np.ndarray, follows: np.ndarray, bits: int) -> np.ndarray | None:
    """How often a counter of so many bits has begun again before each stamp of its trial; None if it is none.

    follows: whether the next stamp is of the same trial. A counter goes from its last values to its first ones; that of
    few bits by no more than it goes elsewhere, since a clock that is set back may have any of so few values.
    """
    period = 2**bits
    lowest, highest = int(stamps.min()), int(stamps.max())
    if not ((lowest >= 0 and highest < period) or (bits == 32 and -period // 2 <= lowest and highest < period)):
        return None
    change = np.diff(stamps.astype(np.int64))
    turns = np.where(follows, (change < -period // 2).astype(np.int64) - (change > period // 2), 0)
    total = np.concatenate([[0], np.cumsum(turns)])
    starts = np.maximum.accumulate(np.where(np.concatenate([[True], ~follows]), np.arange(len(stamps)), 0))
    rounds = total - total[starts]
    over = np.abs(change + period * turns)
    most = period // 4 if bits >= SURE_BITS else WRAP_STEPS * over[follows & (turns == 0)].max(initial=0)
    is_one = turns.any() and rounds.min() >= 0 and over[turns != 0].max() <= most
    return rounds if is_one else None


def rounding_of(times: EventTimes, step_s: float, least: float = KNOWN) -> Rounding | None:
    """How stamps that are on a clock of steps of `step_s` were rounded; None if they are not on it.

    least: evidence that any rounding needs.

    >>> whole_us = event_times(np.rint(np.arange(100) * 1000 / 30).astype(int), 1e-6)
    >>> rounding_of(whole_us, 1 / 30_000), rounding_of(whole_us, 7e-5)
    (Rounding(shift_s=0.0, width_s=5e-07), None)
    """
    some = times.at(_some(np.flatnonzero(times.time_s)))  # the origin is on every clock
    position, tolerance = _place(some, step_s)
    held = np.floor(position + tolerance)
    best, best_fit, least_apart = None, (ON_CLOCK, 0.0), _apart(some.time_s, held)
    for rounding, unit_s, evidence in _roundings(times.resolutions, step_s):
        nearest, is_near = _nearest(some, step_s, rounding)
        chance = np.clip(_chance(rounding, unit_s, step_s) + 2 * some.error_s / step_s, 1e-12, 1.0)
        fit = _share(is_near, chance, is_of_unit=unit_s > 0), _apart(some.time_s, np.where(is_near, nearest, held))
        is_odd = rounding.width_s == unit_s > 0 and _is_whole(step_s / unit_s)
        if (
            fit <= best_fit
            or fit[1] < least_apart
            or -np.log(chance[is_near]).sum() < max(evidence, least)
            or (is_odd and not _separates(some, step_s))
        ):
            continue
        best, best_fit = rounding, fit
        if fit == (1.0, 1.0):
            break
    return best


def _share(is_near: np.ndarray, chance: np.ndarray, *, is_of_unit: bool) -> float:
    """The share of the stamps near a beginning of a step among those that are not by chance.

    Of a unit nearly as long as a step all may be near by chance, but if all are, the unit explains it.
    """
    if is_of_unit and is_near.all():
        return 1.0
    others = float((1 - chance).sum())
    return (float(is_near.sum()) - float(chance.sum())) / others if others > 0 else 0.0


def _apart(time_s: np.ndarray, steps: np.ndarray) -> float:
    """The share of different stamps that are in different steps: a clock gives the stamps of a step one value."""
    return len(np.unique(steps)) / max(1, len(np.unique(time_s)))


def _is_whole(number: float) -> bool:
    return abs(number - round(number)) <= NOISE * number


def _separates(times: EventTimes, step_s: float) -> bool:
    """Whether stamps that share a step each have a nearest beginning of a step of their own, as those of a clock have.

    Stamps that can show the beginnings of steps are a unit off only where a program cut off a product of floats
    (`int(1.001 * 1e6)`); else the last microsecond of a step is in it.
    """
    position = times.time_s / step_s
    by_stamp, by_nearest = (_apart(position, steps) for steps in (np.floor(position + NOISE), np.rint(position)))
    return by_stamp < by_nearest == 1.0


def _roundings(resolutions: Sequence[_Resolution], step_s: float) -> Iterator[tuple[Rounding, float, float]]:
    """Ways to round, with the resolution and the evidence that each needs, from the least to the most deviation."""
    yield Rounding(0.0, 0.0), 0.0, KNOWN
    for unit_s, evidence in resolutions:
        if 0 < unit_s < step_s * (1 - NOISE):
            yield Rounding(0.0, unit_s / 2), unit_s, evidence  # to the nearest
            yield Rounding(CUT / 2 * unit_s, CUT / 2 * unit_s), unit_s, SURE  # cut off, by less than a unit
            yield Rounding(0.0, unit_s), unit_s, SURE  # either, from an origin that is itself rounded


@lru_cache
def _chance(rounding: Rounding, unit_s: float, step_s: float) -> float:
    """The share of all multiples of `unit_s` that are so near to the beginning of a step."""
    if unit_s == 0.0 or step_s / unit_s > LATTICE / 4:
        return (2 * rounding.width_s + unit_s) / step_s
    return float(_nearest(EventTimes(np.arange(LATTICE) * unit_s, np.zeros(LATTICE)), step_s, rounding)[1].mean())


def _nearest(times: EventTimes, step_s: float, rounding: Rounding) -> tuple[np.ndarray, np.ndarray]:
    """The step whose beginning is nearest to each stamp, and whether it is as near as the rounding makes it."""
    position = (times.time_s + rounding.shift_s) / step_s
    nearest = np.rint(position)
    width = (rounding.width_s + times.error_s) / step_s + NOISE + 4 * np.finfo(float).eps * np.abs(position)
    return nearest, np.abs(position - nearest) <= width


def steps_of(times: EventTimes, step_s: float, rounding: Rounding | None) -> np.ndarray:
    """The step of each event of a trial, `(event,)` int64; `rounding`: as by `rounding_of` for all events of a file.

    A trial that begins anywhere between two steps has stamps at its own distance from the clock, which are rounded by
    themselves.

    >>> times = event_times((np.arange(3) / 1000).astype("f4"), 1.0)
    >>> steps_of(times, 0.001, rounding_of(times, 0.001)).tolist()
    [0, 1, 2]
    """
    position, tolerance = _place(times, step_s)
    if rounding is None or not _nearest(times, step_s, rounding)[1].all():
        rounding = rounding_of(times, step_s, least=SURE) or rounding
    return _as_rounded(times, step_s, rounding, np.floor(position + tolerance))


def lengths_of(ends: EventTimes, step_s: float, rounding: Rounding | None) -> np.ndarray:
    """The steps of trials that last until `ends` from their origin, `(trial,)` int64, at least one.

    rounding: that of their events; a trial that ends on the clock has no step of which only rounding is left.

    >>> ends = event_times(np.array([0.006667, 0.0069]), 1.0)
    >>> lengths_of(ends, 1 / 30_000, Rounding(0.0, 5e-7)).tolist()
    [200, 207]
    """
    position, tolerance = _place(ends, step_s)
    return np.maximum(1, _as_rounded(ends, step_s, rounding, np.ceil(position - np.maximum(tolerance, SLACK))))


def _place(times: EventTimes, step_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Times in steps, and the tolerance of each where it is negligible."""
    position, error = times.time_s / step_s, times.error_s / step_s
    return position, NOISE + 4 * np.finfo(float).eps * np.abs(position) + np.where(error <= 1e-3, error, 0.0)


def _as_rounded(times: EventTimes, step_s: float, rounding: Rounding | None, others: np.ndarray) -> np.ndarray:
    """The nearest beginning of a step where rounding explains the distance from it, else the given step."""
    if rounding is not None:
        nearest, is_near = _nearest(times, step_s, rounding)
        others = np.where(is_near, nearest, others)
    return others.astype(np.int64)
