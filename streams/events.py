"""Events of a sensor as the input of a chain: which afferent each one is of, and in which step of the clock it falls.

As at import, an event falls in the step in which its time is, and events of an afferent in one step are one spike,
whatever their order there. A step is over when an event of a later step comes, or when the clock is advanced: an event
of a step that is over is late, and is not used. Import looks at a whole file and can also undo the rounding of its
times; a stream cannot, so the step should be a whole number of the sensor's units of time.
"""

from collections.abc import Iterator, Sequence
from decimal import Decimal
from typing import Any, Literal, NamedTuple

import numpy as np
from neurotact_parts.streams.chain import Chain
from neurotact_parts.streams.stamped_rows import BEHIND, NEAR_S, Faults, counters_of, wrap_of

from neurotact.data.readers.clock.units import DAY_S
from neurotact.errors import InputError, number_of
from neurotact.progress import say

UNKNOWN, LEFT_OUT = -1, -2
"""In place of an afferent's number: of an event of no afferent, and of one whose polarity is not used."""
MOST_CELLS = 1_000_000
"""Of steps without an event that are made at once."""
TOLERANCE = 1e-9
"""Of a step: a time so little before the beginning of one is at it."""
EPS = 4 * float(np.finfo(float).eps)
Origin = Literal["zero", "first"]
"""Where the times of events begin, as at import: at zero, or with the first event."""
Polarity = Literal["merge", "on", "off"]
"""What import made of polarities, if afferents have none: both are one, or only one of them is used."""


class Channels:
    """The afferents of a network by the words of events: a channel, and a polarity (or population) where they have one.

    Channels are numbers from 0 or names, populations names or values: of two, 0 or -1 is the first and 1 the second. A
    channel without a population is an afferent's number, or its whole name.

    >>> channels = Channels(["OFF a", "OFF b", "ON a", "ON b"])
    >>> channels.number("1", "ON"), channels.number("a", -1), channels.number(2), channels.number("ON c")
    (3, 0, 2, -1)
    """

    def __init__(self, afferents: Sequence[str], polarity: Polarity | None = None) -> None:
        self.n, self._polarity = len(afferents), polarity
        self._by_population: dict[str, dict[str, int]] = {}
        for number, name in enumerate(afferents):
            population, _, channel = name.rpartition(" ")
            self._by_population.setdefault(population, {})[channel] = number
        self._whole = {name: number for number, name in enumerate(afferents)}
        self._known: dict[tuple[Any, Any], int] = {}
        if polarity is not None and self.has_populations:
            raise InputError(
                f"`polarity={polarity!r}`: the network has the populations {', '.join(self._by_population)}, which the "
                "polarity of an event chooses; leave it out"
            )

    @property
    def has_populations(self) -> bool:
        return "" not in self._by_population

    def number(self, channel: Any, population: Any = None) -> int:
        """The number of an afferent, or `UNKNOWN` or `LEFT_OUT`.

        InputError for a polarity of which it is not known what it means to the network.
        """
        key = channel, population
        if key not in self._known:
            self._known[key] = self._number(*(part.strip() if isinstance(part, str) else part for part in key))
        return self._known[key]

    def numbers(self, channels: np.ndarray, populations: np.ndarray | None) -> np.ndarray:
        """The same of many events, `(event,)` int64."""
        others = [None] * len(channels) if populations is None else populations.tolist()
        if len(others) != len(channels):
            found, wanted = number_of(len(others), "value"), number_of(len(channels), "event")
            raise InputError(f"polarity: has {found} for {wanted}; give one of each")
        return np.array([self.number(*event) for event in zip(channels.tolist(), others, strict=True)], np.int64)

    def _number(self, channel: Any, population: Any) -> int:
        if population is None or population == "":
            return _placed(channel, self._whole)
        if self.has_populations:
            names = list(self._by_population)
            of_value = {"-1": 0} if len(names) == 2 else {}
            index = of_value.get(_text(population), _placed(population, {name: i for i, name in enumerate(names)}))
            return UNKNOWN if index < 0 else _placed(channel, self._by_population[names[index]])
        if self._polarity is None:
            raise InputError(
                "polarity: events have one, but the network's afferents do not; say with `polarity` what import made "
                "of it: merge, on or off"
            )
        is_on = _text(population).lower() not in ("0", "-1", "off", "false")
        return LEFT_OUT if is_on != (self._polarity == "on") and self._polarity != "merge" else self.number(channel)


def afferents_of(chain: Chain) -> Sequence[str]:
    """The names of the afferents of a network that takes events; `channel0` and so on where they have none."""
    return chain.taxels or [f"channel{number}" for number in range(chain.n_taxels)]


def _text(value: Any) -> str:
    """A value as a word; a whole number as its digits, however it was written.

    >>> _text("+01"), _text(1.0), _text(True), _text("x1y2")
    ('1', '1', '1', 'x1y2')
    """
    try:
        number = float(value)
    except (TypeError, ValueError):
        return str(value)
    return str(int(number)) if number.is_integer() else str(value)


def _placed(value: Any, names: dict[str, int]) -> int:
    """The number of a name, or of the n-th name; `UNKNOWN` if there is none."""
    text = str(value)
    if text in names:
        return names[text]
    digits = _text(value)
    return [*names.values()][int(digits)] if digits.isdecimal() and int(digits) < len(names) else UNKNOWN


def steps_at(time_s: Any, clock_Hz: float) -> np.ndarray:
    """The step in which each time is, `(event,)` int64; InputError for what is no time from 0 on.

    >>> steps_at([0.0, 0.0029, 0.003], 1000.0).tolist()
    [0, 2, 3]
    """
    try:
        times = np.atleast_1d(np.asarray(time_s, float))
    except (TypeError, ValueError) as error:
        raise InputError(f"time_s: is no array of numbers ({error}); give seconds") from error
    position = times * clock_Hz
    if times.ndim != 1 or not (np.isfinite(times) & (times >= 0)).all() or not (position < 2.0**53).all():
        raise InputError("time_s: must be one finite time in s per event, from 0 on; give times since the chain began")
    return np.floor(position + TOLERANCE + EPS * position).astype(np.int64)


class Sorted(NamedTuple):
    """Events by steps: their steps, ascending, and afferents, each pair once; and how many were late or doubled."""

    steps: np.ndarray
    units: np.ndarray
    late: int
    doubled: int


def sorted_events(steps: np.ndarray, units: np.ndarray, step: int, waiting: np.ndarray) -> Sorted:
    """The events that count, of those that arrive in this order while `step` is under way.

    waiting: the afferents with an event in it already, `(afferent,)` bool. Events of no afferent show the time, too.

    >>> sorted_events(np.array([4, 3, 6, 5, 6]), np.array([0, 1, 1, 0, 1]), 3, np.array([False, True]))
    Sorted(steps=array([4, 6]), units=array([0, 1]), late=2, doubled=1)
    """
    is_known = units >= 0
    is_late = steps < np.maximum.accumulate(np.append(step, steps))[:-1]
    counts = is_known & ~is_late
    n = len(waiting)
    pairs = np.unique(steps[counts] * n + units[counts])
    is_new = ~(waiting[pairs % n] & (pairs // n == step))
    pairs = pairs[is_new]
    return Sorted(pairs // n, pairs % n, int((is_known & is_late).sum()), int(counts.sum()) - len(pairs))


def rows_until(events: Sorted, step: int, end: int, waiting: np.ndarray) -> Iterator[np.ndarray]:
    """The steps from `step` on and before `end` as rows `(step, afferent)` float32 of 0 and 1, block by block."""
    n, at = len(waiting), 0
    most = max(1, MOST_CELLS // n)
    for start in range(step, end, most):
        rows = np.zeros((min(most, end - start), n), np.float32)
        if start == step:
            rows[0, waiting] = 1
        until = int(np.searchsorted(events.steps, start + len(rows)))
        rows[events.steps[at:until] - start, events.units[at:until]] = 1
        at = until
        yield rows


class Moment(NamedTuple):
    """A stamp as a time in s since the origin, None if it is not believed; and whether the clock has started again."""

    time_s: float | None
    restarts: bool = False


class EventClock:
    """The clock of a sensor: its stamps as seconds since the origin, whose faults are counted and each said once.

    where: name of the source. unit_s: of the stamps. from_first: the origin is the first event; else time zero.
    Stamps that are more than a second back or a day ahead are not believed, until `BEHIND` of them follow one another:
    the clock has started again. A counter that begins again goes on.

    >>> clock = EventClock("pipe", 1e-3, True, Faults())
    >>> [clock.at(Decimal(stamp)).time_s for stamp in ("5000", "5002", "1", "5001")]
    [0.0, 0.002, None, 0.001]
    """

    def __init__(self, where: str, unit_s: float, from_first: bool, faults: Faults) -> None:
        self._where, self._unit_s, self._from_first, self._faults = where, unit_s, from_first, faults
        self._counters = counters_of(unit_s)
        self._origin: Decimal | None = None
        self._last, self._offset, self._n_off = Decimal(0), Decimal(0), 0
        self._said: set[str] = set()

    def at(self, stamp: Decimal) -> Moment:
        if self._origin is None:
            self._begin(stamp)
        wrapped = wrap_of(float(stamp), float(self._last), self._counters, NEAR_S / self._unit_s)
        if wrapped:
            self._offset += Decimal(wrapped)
            self._faults.wraps += 1
            self._say("wraps", f"wrap from {self._last} to {stamp}; they go on from there")
        change_s = float(stamp + Decimal(wrapped) - self._last) * self._unit_s
        if -NEAR_S <= change_s <= DAY_S:
            self._n_off, self._last = 0, max(stamp, self._last) if not wrapped else stamp
            return self._time(stamp)
        self._n_off += 1
        if self._n_off < BEHIND:
            self._faults.outliers += 1
            self._say("outliers", f"fit no other: {stamp} after {self._last}; such events are not used")
            return Moment(None)
        self._faults.restarts += 1
        self._say("restarts", f"jump from {self._last} to {stamp}: the clock has started again, and so does the chain")
        self._begin(stamp)
        return self._time(stamp)._replace(restarts=True)

    def _begin(self, stamp: Decimal) -> None:
        """As before the first stamp of a clock, which is this one."""
        is_far = not 0 <= float(stamp) * self._unit_s <= DAY_S
        if self._origin is None and is_far and not self._from_first:
            raise InputError(
                f"{self._where}: the first event is at {float(stamp) * self._unit_s:g} s, before zero or more than a "
                "day after it; pass `origin='first'`, or the unit of the times with `time_unit`"
            )
        self._origin = stamp if self._from_first or is_far else Decimal(0)
        self._last, self._offset, self._n_off = stamp, Decimal(0), 0

    def _time(self, stamp: Decimal) -> Moment:
        assert self._origin is not None
        since_s = float(stamp + self._offset - self._origin) * self._unit_s
        return Moment(since_s if since_s >= 0 else None)

    def _say(self, kind: str, what: str) -> None:
        if kind not in self._said:
            self._said.add(kind)
            say(f"{self._where}: time stamps {what} (said once; the counts come at the end)")
