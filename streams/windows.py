"""Where windows start in a signal without an end: back to back, hop by hop, or at each contact."""

from dataclasses import dataclass

import numpy as np
from neurotact_parts.streams.streamed import StreamedSpec

from neurotact.data.windows import WindowSpec, steps_of
from neurotact.errors import InputError

MOST_AT_ONCE = 64
"""Maximum number of windows that overlap; each is a separate network."""
LONGEST_QUIET = 2**31
"""Steps; it is counted in 32 bits."""


@dataclass(frozen=True)
class WindowPlan:
    """Windows on the encoder's clock, in steps.

    length: of a window. start: steps skipped at the beginning, until filters and membranes have settled.
    hop: from one window's start to the next; 0: a window starts at a contact, if no other window is open. A contact is
        the first step at which an afferent spikes after `quiet` steps without any spike.
    """

    length: int
    start: int
    hop: int
    quiet: int = 0

    @staticmethod
    def of(clock_Hz: float, streamed: StreamedSpec, trained: WindowSpec = WindowSpec()) -> "WindowPlan":
        """A plan from milliseconds; values that are None are those of `trained`.

        >>> WindowPlan.of(2000.0, StreamedSpec(length_ms=150, hop_ms=50))
        WindowPlan(length=300, start=0, hop=100, quiet=0)
        """
        given = {key: getattr(streamed, key) for key in ("length_ms", "start_ms", "hop_ms")}
        window = {key: getattr(trained, key) if value is None else value for key, value in given.items()}
        length, start, hop = steps_of(WindowSpec(**window), clock_Hz)
        if not streamed.contact:
            if -(-length // hop) > MOST_AT_ONCE:
                raise InputError(
                    f"hop_ms: {-(-length // hop)} windows would overlap, more than {MOST_AT_ONCE}; lengthen the hop"
                )
            return WindowPlan(length, start, hop)
        quiet = streamed.quiet_ms * 1e-3 * clock_Hz
        if not (quiet < LONGEST_QUIET and round(quiet) >= 1):
            raise InputError(
                f"quiet_ms: {streamed.quiet_ms:g} ms is less than one step at {clock_Hz:g} Hz, or too long"
            )
        return WindowPlan(length, start, 0, round(quiet))

    @property
    def at_once(self) -> int:
        """Maximum number of windows that overlap."""
        return -(-self.length // self.hop) if self.hop else 1

    def begin(self) -> "Opening":
        """The state before the first step, after `quiet` steps without a spike."""
        return Opening(self, 0, self.quiet, 0)

    def starts(self, raster: np.ndarray) -> np.ndarray:
        """First steps of the windows that fit into a whole trial, `(window,)`; raster `(time, afferent)`.

        >>> WindowPlan(length=3, start=1, hop=2).starts(np.zeros((8, 2))).tolist()
        [1, 3, 5]
        >>> WindowPlan(length=3, start=0, hop=0, quiet=2).starts(np.eye(9, 1, k=-4)).tolist()
        [4]
        """
        opening, starts = self.begin(), []
        for step, row in enumerate(np.asarray(raster)):
            opens, opening = opening.after(bool(row.any()))
            if opens and step + self.length <= len(raster):
                starts.append(step)
        return np.array(starts, np.int64)


@dataclass(frozen=True)
class Opening:
    """The next step, the number of steps without a spike, and the first step at which a window may start."""

    plan: WindowPlan
    step: int
    silent: int
    free_at: int

    def after(self, has_spike: bool) -> tuple[bool, "Opening"]:
        """Whether a window starts at this step, and the state after it."""
        plan, step = self.plan, self.step
        if plan.hop:
            opens = step >= plan.start and (step - plan.start) % plan.hop == 0
        else:
            opens = has_spike and self.silent >= plan.quiet and step >= max(plan.start, self.free_at)
        silent = 0 if has_spike else min(self.silent + 1, plan.quiet)
        return opens, Opening(plan, step + 1, silent, step + plan.length if opens else self.free_at)
