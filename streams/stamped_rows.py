"""Rows with a time stamp as samples in a row: what was lost between them, and what a clock at fault stamps.

The rule. A row whose stamp lies up to `AT_ONCE` samples after the next expected one is used at once, and the samples in
between are missing. Any other row is held back:

- Rows held back that were followed by a stamp that fits take the samples before it, in their order: a stamp that fits
  no other costs no sample, and a clock of whole milliseconds may stamp several rows alike. Rows for which there is no
  room are repeats, and are dropped.
- Stamps that jump ahead are believed when `AHEAD` of them advance one after the other: samples are missing.
- Stamps that jump back are believed when `BEHIND` of them do: the clock has started again, after an unknown time. So
  has one that jumps ahead by more than a day. A row that repeats the stamp and the values of an earlier one is dropped.
- A jump from the end of a counter to its beginning is none: the counter has wrapped, and its stamps go on. Counters
  have 16 or 32 bits, signed or not, and count in the unit of the stamps; or are the usual ones of `COUNTERS_S`.
- If no stamp fits for a second, and at least `MOST_HELD` rows, the rows are used in their order.

So a row waits for `BEHIND` others, or for as long as a coarse clock stands still. Stamps that advance at another rate
than samples come, as of a wrong unit, are refused after the first `FIRST_ROWS`.
"""

import math
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from neurotact.data.readers.clock.units import DAY_S
from neurotact.errors import InputError
from neurotact.progress import say

AT_ONCE = 2
"""Number of lost samples that one stamp is believed."""
AHEAD, BEHIND = 3, 20
"""Number of rows that show that a clock has jumped ahead, or has started again. Late rows look like the latter."""
MOST_HELD = 100
"""Number of rows, or those of a second if more, after which rows without a fitting stamp are used in their order."""
RECENT = 100
"""Number of rows among which repeats are looked for."""
NEAR_S, NEAR_ROWS = 1.0, 10
"""Stamps that follow one another are at most this far apart."""
COUNTERS_S = (2**16 * 1e-3, 2**32 * 1e-6, 2**32 * 1e-3)
"""Seconds after which 16 bits of milliseconds, 32 bits of microseconds and 32 bits of milliseconds wrap."""
FIRST_ROWS, FIRST_STEPS, MOST_FIRST = 500, 20, 50_000
"""Number of rows, and of times at which their stamp changed, that show the rate; without them it stays unknown."""
WRONG_RATE = 2.5
"""Factor by which the rate of the first stamps may differ from that of the samples: rows may be lost or repeated."""


def counters_of(unit_s: float) -> list[float]:
    """The lengths of usual counters, in stamps of this unit."""
    return [2.0**16, 2.0**32, *(seconds / unit_s for seconds in COUNTERS_S)]


def wrap_of(stamp: float, last: float, counters: Sequence[float], near: float) -> float:
    """The length of the counter, if it has wrapped between the last stamp and this one, `near` at most; else 0.

    >>> wrap_of(3.0, 65_534.0, counters_of(1e-6), 1e6), wrap_of(3.0, 7.0, counters_of(1e-6), 1e6)
    (65536.0, 0.0)
    """
    for length in counters:
        is_next = stamp < last and 0 < stamp + length - last <= min(near, length / 8)
        is_unsigned = last < length and stamp >= 0
        is_signed = last < length / 2 and stamp >= -length / 2
        if is_next and (is_unsigned or is_signed):
            return length
    return 0.0


@dataclass
class Faults:
    """Counts of errors in a source, which is not changed by them.

    bad_rows: rows that were not used: no samples, repeats, or of a time that fits no other. cut_off: an incomplete end.
    restarts, wraps: of the clock that writes time stamps. outliers: time stamps that fit no other.
    stalls, late_blocks, late_ms: of the arrival.
    """

    bad_rows: int = 0
    cut_off: int = 0
    stalls: int = 0
    late_blocks: int = 0
    late_ms: float = 0.0
    restarts: int = 0
    wraps: int = 0
    outliers: int = 0

    def trouble(self) -> str:
        """The counts that are not zero, in words.

        >>> Faults(bad_rows=2, restarts=1).trouble()
        'bad rows 2, clock restarts 1'
        """
        words = (
            (self.bad_rows, "bad rows"), (self.cut_off, "cut off at the end"), (self.restarts, "clock restarts"),
            (self.wraps, "clock wraps"), (self.outliers, "time stamps ignored"), (self.stalls, "stalls"),
        )  # fmt: skip
        counts = [f"{what} {n}" for n, what in words if n]
        late = [f"late blocks {self.late_blocks} (by up to {self.late_ms:.1f} ms)"] if self.late_blocks else []
        return ", ".join(counts + late)


class Placed(NamedTuple):
    """A row in its place; before it `lost` samples are missing, or an unknown number if the clock `restarts`.

    values: None for a row that is not a sample.
    """

    values: list[float] | None
    lost: int = 0
    restarts: bool = False


class Stamped(NamedTuple):
    """A time stamp, in its unit, and the values of its row."""

    stamp: float
    values: list[float]


class StampedRows:
    """The rows of one source, one after the other; the module has the rule.

    where: name of the source, for messages. rate_Hz: of the samples. unit_s: of the stamps. faults: gets the counts.
    Each kind of fault is said once.

    >>> rows = StampedRows("pipe", 1000.0, 1e-3, Faults())
    >>> [placed for stamp in (5, 6, 99999, 8, 10) for placed in rows.take(stamp, [stamp])][2:]
    [Placed(values=[99999], lost=0, restarts=False), Placed(values=[8], lost=0, restarts=False), \
Placed(values=[10], lost=1, restarts=False)]
    """

    def __init__(self, where: str, rate_Hz: float, unit_s: float, faults: Faults) -> None:
        self._where, self._rate_Hz, self._unit_s, self._noted = where, rate_Hz, unit_s, faults
        self._per_unit = rate_Hz * unit_s
        self._near = max(NEAR_S * rate_Hz, NEAR_ROWS) / self._per_unit
        self._most_held = max(MOST_HELD, min(int(rate_Hz), 100 * MOST_HELD))
        self._counters = counters_of(unit_s)
        self._said: set[str] = set()
        self._first: list[float] | None = []
        self._n_steps = 0
        self._begin()

    def _begin(self) -> None:
        """As before the first stamp of a clock."""
        self._origin: float | None = None
        self._place, self._last, self._offset = -1, math.nan, 0.0
        self._recent: deque[Stamped] = deque(maxlen=RECENT)
        self._hold([])

    def _hold(self, rows: list[Stamped]) -> None:
        """Hold back these rows alone; none of them begins a run of stamps that agree."""
        self._held = rows
        self._run, self._agreed, self._run_stamp = 0, 0, math.nan

    def take(self, stamp: float, values: list[float]) -> Iterator[Placed]:
        """The rows, held back until now or this one, that are used."""
        self._note_rate(stamp)
        yield from self._place_row(Stamped(stamp, values))

    def rest(self) -> Iterator[Placed]:
        """When the source has ended: the rows that were held back with the last stamp; the others are dropped."""
        if self._first is not None and self._n_steps >= FIRST_STEPS:
            self._check_rate(np.array(self._first))
        alike = [row for row in self._held if self._lost(row.stamp) == -1]
        self._ignore([], [row for row in self._held if self._lost(row.stamp) != -1])
        self._hold([])
        yield from (Placed(row.values) for row in alike)

    def _place_row(self, row: Stamped) -> Iterator[Placed]:
        lost = self._lost(row.stamp)
        if lost is not None and 0 <= lost <= len(self._held) + AT_ONCE:
            yield from self._use(row, lost)
        elif lost is not None and lost < -1 and row in self._recent:
            self._noted.bad_rows += 1
        else:
            yield from self._hold_back(row, lost)

    def _lost(self, stamp: float) -> int | None:
        """Number of samples between the last row and a stamp; -1 if it stands for the same one; None for no number."""
        if self._origin is None:
            return len(self._held) if math.isfinite(stamp) else None
        position = (stamp + self._offset + self._wrap(stamp) - self._origin) * self._per_unit
        return round(position) - self._place - 1 if math.isfinite(position) else None

    def _wrap(self, stamp: float) -> float:
        """The length of the counter, if it has wrapped between the last row and this stamp; else 0."""
        return wrap_of(stamp, self._last, self._counters, self._near)

    def _use(self, row: Stamped, lost: int) -> Iterator[Placed]:
        """A row whose stamp is believed, and before it those held back for which it leaves room."""
        filled = self._held[:lost]
        self._ignore(filled, self._held[lost:])
        if wrapped := self._wrap(row.stamp):
            self._noted.wraps += 1
            self._say("wraps", f"wrap from {self._last:.12g} to {row.stamp:.12g}; they go on from there")
            self._offset += wrapped
        if self._origin is None:
            self._origin = row.stamp - lost / self._per_unit
        self._place, self._last = self._place + lost + 1, row.stamp
        self._recent.append(row)
        self._hold([])
        yield from (Placed(row.values) for row in filled)
        yield Placed(row.values, lost - len(filled))

    def _ignore(self, used: list[Stamped], dropped: list[Stamped]) -> None:
        """Count rows that were held back: those not used, and stamps that fit no other; a row may also just be late."""
        self._noted.bad_rows += len(dropped)
        outliers = [row.stamp for row in used if self._lost(row.stamp) != -1]
        outliers += [row.stamp for row in dropped if (lost := self._lost(row.stamp)) is None or lost > 0]
        self._noted.outliers += len(outliers)
        if outliers:
            self._say("outliers", f"fit no other: {outliers[0]:.12g} after {self._last:.12g}; such stamps are ignored")

    def _hold_back(self, row: Stamped, lost: int | None) -> Iterator[Placed]:
        self._held.append(row)
        if lost is not None and lost != -1:
            step = row.stamp - self._run_stamp
            if 0 <= step <= self._near:
                self._agreed += step > 0
            else:
                self._run, self._agreed = len(self._held) - 1, 1
            self._run_stamp = row.stamp
            if self._agreed >= (AHEAD if lost > 0 else BEHIND):
                yield from self._believe_run()
                return
        if len(self._held) > self._most_held:
            yield from self._use_in_order()

    def _believe_run(self) -> Iterator[Placed]:
        """The last rows agree on another time."""
        before, (first, *others) = self._held[: self._run], self._held[self._run :]
        lost = self._lost(first.stamp)
        assert lost is not None
        if 0 <= lost <= DAY_S * self._rate_Hz:
            self._hold(before)
            yield from self._use(first, lost)
        else:
            self._ignore([], before)
            self._noted.restarts += 1
            self._say(
                "restarts",
                f"jump from {self._last:.12g} to {first.stamp:.12g}: the clock has started again, and so does "
                "the chain",
            )
            self._begin()
            yield from (placed._replace(restarts=True) for placed in self._use(first, 0))
        for row in others:
            yield from self._place_row(row)

    def _use_in_order(self) -> Iterator[Placed]:
        """No stamp has fitted for long: each row counts as one sample."""
        held = self._held
        self._noted.outliers += len(held)
        self._say("in order", f"have fitted no other for {len(held)} rows, which are used as successive samples")
        self._place += len(held)
        self._recent.clear()
        self._hold([])
        yield from (Placed(row.values) for row in held)

    def _say(self, kind: str, what: str) -> None:
        if kind not in self._said:
            self._said.add(kind)
            say(f"{self._where}: time stamps {what} (said once; the counts come at the end)")

    def _note_rate(self, stamp: float) -> None:
        if self._first is None:
            return
        self._n_steps += bool(self._first) and stamp != self._first[-1]
        self._first.append(stamp)
        if len(self._first) >= FIRST_ROWS and self._n_steps >= FIRST_STEPS:
            self._check_rate(np.array(self._first))
        elif len(self._first) >= MOST_FIRST:
            self._first = None

    def _check_rate(self, stamps: np.ndarray) -> None:
        """InputError if the stamps advance at another rate, over any distance: repeats, jumps and restarts do not."""
        self._first = None
        stamps = stamps[np.isfinite(stamps)]
        step = 0.0
        for distance in sorted({1, max(1, len(stamps) // 50), max(1, len(stamps) // 5)}):
            with np.errstate(over="ignore"):
                steps = np.abs(stamps[distance:] - stamps[:-distance])
            step = float(np.median(steps)) / distance if len(steps) else 0.0
            if 1 / WRONG_RATE <= step * self._per_unit <= WRONG_RATE:
                return
        raise InputError(
            f"{self._where}: the time stamps advance by {step * self._unit_s:.3g} s a row, but samples come every "
            f"{1 / self._rate_Hz:.3g} s; give the unit of the stamps with `time_column`, and the rate of the samples "
            "with `sampling_rate_Hz`"
        )
