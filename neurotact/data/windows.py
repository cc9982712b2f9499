"""Windows of trials, with the trial of each."""

import logging
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from pydantic import Field

from neurotact import effects
from neurotact.data.contact import OnsetSpec
from neurotact.errors import InputError, some
from neurotact.files import check_size
from neurotact.spec import Spec, chosen

log = logging.getLogger("neurotact")

Align = Literal["trial", "onset"]
LONGEST_STEPS = 2**40
"""Longest trial or window: at 1 MHz twelve days. A larger number is damaged, and would overflow."""
BYTES_PER_WINDOW = 40
"""Memory per window while they are cut."""
SHORTEST_STEP_MS, SHORTEST_TOUCH_MS = 1.0, 5.0
LONGEST_MS = 2000.0
"""Maximum length of a window that is chosen: longer trials are cut into several."""
SHORTER, OF_CLASS = 0.05, 0.2
"""Share of the trials, and of those of a class, that are left out at most since they are shorter than a window."""
IN_PART = 0.25
"""As `SHORTER`, of a part of the trials, such as those of a test: there it is only what chance may put together."""


class WindowSpec(Spec):
    """The stretches of each trial that a network receives; `nt.Window`.

    Where no length is given to a command or a function, windows are chosen from the trials, without labels, and the
    choice is logged: from the begin of the touch to the end of the shortest trial, at most 2 s each, and up to 4 s of
    each trial. Few trials that are far shorter than the others are left out, and named.

    >>> WindowSpec(length_ms=100, align="onset")
    Window(length_ms=100.0, align='onset')
    """

    public = "Window"
    length_ms: float = Field(
        default=150.0, gt=0, json_schema_extra=chosen("the shortest trial from the touch on, at most 2000")
    )
    """Length of a window, the unit that is classified."""
    start_ms: float = Field(default=0.0, ge=0, json_schema_extra=chosen("where the touch begins; 0 with `length_ms`"))
    """Start of the first window in each trial. What is before it is skipped, so that filters and membranes have
    settled."""
    hop_ms: float | None = Field(default=None, gt=0)
    """Time between the starts of windows; the window's length when absent."""
    per_trial: int | None = Field(
        default=None, ge=1, json_schema_extra=chosen("up to 4 s of windows; all that fit with `length_ms`")
    )
    """Maximum number of windows per trial, the first ones. All that fit when absent."""
    align: Align = "trial"
    """What `start_ms` counts from: the trial's beginning, or the onset of contact."""
    onset: OnsetSpec = OnsetSpec()

    def check_given(self) -> None:
        """Refuse a rule for onsets without any; log a window that is likely meant in seconds.

        `steps_of` refuses one of less than a step.
        """
        effects.check_given(self.given(), align=self.align)
        if SHORTEST_STEP_MS <= self.length_ms < SHORTEST_TOUCH_MS:
            log.warning(
                "`length_ms=%g`: a window of %g ms is shorter than a touch; is it meant in seconds?",
                self.length_ms,
                self.length_ms,
            )


@dataclass(frozen=True)
class Windows:
    """trial: index of each window's trial; start: its first step; n_steps: the length of all."""

    trial: np.ndarray
    start: np.ndarray
    n_steps: int

    def __len__(self) -> int:
        return len(self.trial)


def cut(
    trial_steps: np.ndarray,
    sampling_rate_Hz: float,
    spec: WindowSpec,
    trials: np.ndarray | None = None,
    onsets: np.ndarray | None = None,
) -> Windows:
    """The windows that fit into trials of `trial_steps` steps.

    A trial that is shorter than a window has none. InputError where that is so of more than a quarter of them
    (`IN_PART`), and for too many windows.

    trials: numbers that name the trials; 0, 1, ... when absent.
    onsets: the step of each trial from which `start_ms` counts; 0 when absent. If no window fits after it, the trial's
    only window is the last that fits.

    >>> windows = cut(np.array([10, 7]), 1000.0, WindowSpec(length_ms=3, start_ms=1))
    >>> windows.trial.tolist(), windows.start.tolist()
    ([0, 0, 0, 1, 1], [1, 4, 7, 1, 4])
    >>> cut(np.array([10, 7]), 1000.0, WindowSpec(length_ms=3), onsets=np.array([2, 5])).start.tolist()
    [2, 5, 4]
    """
    trials = np.arange(len(trial_steps)) if trials is None else trials
    fits = check_fit(trial_steps, sampling_rate_Hz, spec, trials, most=IN_PART)
    trial_steps, trials = np.asarray(trial_steps)[fits], trials[fits]
    onsets = None if onsets is None else onsets[fits]
    length, first, hop = steps_of(spec, sampling_rate_Hz)
    last = trial_steps - length
    begin = np.full(len(last), first) if onsets is None else np.minimum(first + onsets, last)
    fitting = (last - begin) // hop + 1
    if spec.per_trial is not None:
        fitting = np.minimum(fitting, spec.per_trial)
    n_windows = sum(fitting.tolist())
    check_size(f"the cut into {n_windows} windows", BYTES_PER_WINDOW * n_windows)
    trial = np.repeat(np.arange(len(fitting)), fitting)
    rank = np.arange(len(trial)) - np.repeat(np.cumsum(fitting) - fitting, fitting)
    return Windows(trials[trial], begin[trial] + rank * hop, length)


def check_fit(
    trial_steps: np.ndarray,
    sampling_rate_Hz: float,
    spec: WindowSpec,
    trials: np.ndarray | None = None,
    most: float = SHORTER,
) -> np.ndarray:
    """Which trials of `trial_steps` are as long as a window, `(trial,)`; trials: as for `cut`.

    Raises InputError if more than the share `most` of them are shorter.

    >>> check_fit(np.array([2000]), 1000.0, WindowSpec(length_ms=2000)).tolist()
    [True]
    """
    length, first, _ = steps_of(spec, sampling_rate_Hz)
    fits = np.asarray(trial_steps) >= first + length
    if np.count_nonzero(~fits) > most * len(fits):
        shortest = int(np.argmin(trial_steps))
        steps = trial_steps[shortest]
        raise InputError(
            f"window: trial {shortest if trials is None else trials[shortest]} lasts {steps / sampling_rate_Hz:.3f} s, "
            f"less than the {(spec.start_ms + spec.length_ms) / 1e3:.3f} s of start_ms + length_ms; shorten the window"
        )
    return fits


def long_enough(durations_ms: np.ndarray, classes: np.ndarray | None = None) -> np.ndarray:
    """Which trials windows of one length are cut from, `(trial,)`: those that then give the most signal in all.

    The shortest trial decides the length, up to `LONGEST_MS`. Trials are left out, the shortest ones first, if windows
    as long as the next one times the number of trials that are left is more; but no more than `SHORTER` of all, and
    `OF_CLASS` of a class. So a short trial shortens no other window, and trials of similar lengths all stay.

    classes: of the trials, so that none is lost.

    >>> long_enough(np.array([100.0, *[800.0] * 40])).tolist().index(True)
    1
    >>> long_enough(np.array([100.0, 800.0, 800.0])).tolist()
    [True, True, True]
    """
    order = np.argsort(durations_ms, kind="stable")
    if classes is None:
        classes = np.zeros(len(order), np.int64)
    names, of = np.unique(classes, return_inverse=True)
    spare = OF_CLASS * np.bincount(of) if len(names) > 1 else np.full(1, np.inf)
    n_left_out, most = 0, -np.inf
    for n, trial in enumerate(order[: 1 + int(SHORTER * len(order) + 1e-9)].tolist()):
        in_all = (len(order) - n) * min(float(durations_ms[trial]), LONGEST_MS)
        if in_all > most * (1 + 1e-9 * np.sign(most)):
            n_left_out, most = n, in_all
        spare[of[trial]] -= 1
        if spare[of[trial]] < -1e-9:
            break
    kept = np.ones(len(order), bool)
    kept[order[:n_left_out]] = False
    return kept


def left_out(fits: np.ndarray, durations_ms: np.ndarray) -> Iterator[str]:
    """The note on trials that are shorter than a window; nothing without any.

    fits: of each trial, as of `check_fit`. durations_ms: `(trial,)`.

    >>> print(*left_out(np.array([True, False, True]), np.array([800.0, 100.0, 900.0])))
    1 of 3 trials is shorter than a window and left out: trial 1, 100 ms
    """
    short = np.flatnonzero(~fits)
    if len(short):
        which = some([f"trial {trial}, {durations_ms[trial]:,.0f} ms" for trial in short.tolist()], 3)
        verb = "is" if len(short) == 1 else "are"
        yield f"{len(short)} of {len(fits)} trials {verb} shorter than a window and left out: {which}"


def steps_of(spec: WindowSpec, sampling_rate_Hz: float) -> tuple[int, int, int]:
    """Length, start and hop in steps; InputError if one is less than a step or longer than any trial may be.

    >>> steps_of(WindowSpec(length_ms=150, start_ms=250), 2000.0)
    (300, 500, 300)
    """
    length, first = whole_steps(spec.length_ms, sampling_rate_Hz), whole_steps(spec.start_ms, sampling_rate_Hz)
    hop = length if spec.hop_ms is None else whole_steps(spec.hop_ms, sampling_rate_Hz)
    for key, n_steps, duration_ms in (
        ("length_ms", length, spec.length_ms),
        ("start_ms", first + 1, spec.start_ms),
        ("hop_ms", hop, spec.hop_ms),
    ):
        steps = (duration_ms or 0.0) * 1e-3 * sampling_rate_Hz
        is_broken = duration_ms is not None and key != "start_ms" and steps < 1 - 1e-9
        if n_steps < 1 or is_broken:
            raise InputError(
                f"window.{key}: {duration_ms:g} ms is less than one step at {sampling_rate_Hz:g} Hz; lengthen it "
                "(in milliseconds, not in seconds)"
            )
        if n_steps > LONGEST_STEPS:
            raise InputError(f"window.{key}: {duration_ms:g} ms is longer than any trial may be; shorten it")
    return length, first, hop


def whole_steps(duration_ms: float, sampling_rate_Hz: float) -> int:
    """The number of steps nearest to a duration.

    >>> whole_steps(150.3, 2000.0)
    301
    """
    return round(min(duration_ms * 1e-3 * sampling_rate_Hz, 2.0 * LONGEST_STEPS))  # infinity cannot be rounded
