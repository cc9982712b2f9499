"""The windows of trials for which no length or no start is given: chosen from the trials, without their labels."""

import logging
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from neurotact.data.contact import OnsetSpec
from neurotact.data.onset import common_spike_onset_s, evenly
from neurotact.data.spikes import SpikeTrains
from neurotact.data.windows import LONGEST_MS, WindowSpec, check_fit, left_out, long_enough, whole_steps
from neurotact.errors import InputError

log = logging.getLogger("neurotact")

MOST_PER_TRIAL, MOST_OF_TRIAL_MS, MOST_MS = 4, 4000.0, 4e6
"""Maximum number of windows of one trial, their total length, and that of all trials: more windows take time and add
little information."""
SHORT = 0.5
"""A shortest trial below this share of the median trial gives a note."""
SEEN = 0.5
"""Windows that cover less than this share of the median trial give a note."""
LATE = 0.1
"""Share of trials whose onset of contact may be too late for a window that starts there, or for the first window."""
FOUND = 0.95
"""Share of trials in which an onset of contact must be found before windows that start there are proposed."""
RESTS = 0.8
"""Share of the time before the touch that is rest: the touch begins within a bin."""
PLACES = {"start_ms", "align"}
"""Keys that place the beginning of the windows in the trial."""


class Timing(NamedTuple):
    """When trials end and when their touch begins.

    durations_s: of each trial, `(trial,)`; from_onset: from its onset of contact on. clock_Hz: steps per second of the
    windows. touch_s: from the start of the trials. classes: of the trials, none of which may be lost; None if unknown.
    """

    durations_s: np.ndarray
    clock_Hz: float
    touch_s: float = 0.0
    from_onset: bool = False
    classes: np.ndarray | None = None


class Words(NamedTuple):
    """How the user writes the keys of a window.

    length: its length. start: its start, with a place for it. onset: the alignment to the onset. each: one
    window per trial from the onset on, with a place for the length of the rest in ms.
    """

    length: str
    start: str
    onset: str
    each: str


ARGUMENTS = Words(
    "`length_ms`", "`start_ms={}`", "`align='onset'`",
    "`window=nt.Window(align='onset', per_trial=1, onset=nt.Onset(rest_ms={:g}))`",
)  # fmt: skip
"""The parameters of functions that cut windows."""


def suited_window(spikes: SpikeTrains, window: WindowSpec, words: Words = ARGUMENTS) -> WindowSpec:
    """The windows of spike trains, chosen where they are not given; the choice is logged.

    window: the fields that it was made with are given. Without a length, the others are those of `choose`. With a
    length, they keep their defaults, and windows that hold rest before the touch are logged.
    Raises InputError for a start after the end of a trial, and for a window that is longer than a trial.

    >>> import pandas as pd
    >>> from neurotact.data.spikes import from_rasters
    >>> felt = from_rasters(np.zeros((2, 700, 16)), 2000.0, ("SA-I taxel1",) * 16, pd.DataFrame({"label": ["a", "b"]}))
    >>> suited_window(felt, WindowSpec(start_ms=100)).length_ms
    250.0
    """
    if not len(spikes):
        return window
    given = {key: getattr(window, key) for key in window.model_fields_set}
    known = {key: value for key, value in given.items() if value is not None and value != "trial"}
    if "length_ms" not in known:
        timing = timing_of(spikes, window)
        table, notes = choose(timing, known, words)
        if not PLACES & {*known}:
            notes += on_late_onsets(spikes, timing, window.model_copy(update=table), words)
    else:
        fits = check_fit(spikes.trial_steps, spikes.sampling_rate_Hz, window)
        notes = [f"{line}." for line in left_out(fits, 1e3 * spikes.trial_steps / spikes.sampling_rate_Hz)]
        table, notes = {}, notes if PLACES & {*known} else [*notes, *_on_rest(timing_of(spikes), window, words)]
    for note in notes:
        log.warning("%s", note)
    return window.model_copy(update={**table, **known})


def timing_of(spikes: SpikeTrains, window: WindowSpec = WindowSpec()) -> Timing:
    """The timing of spike trains; the touch begins as in their recordings, or where they are unknown as in spikes.

    window: if it is aligned to the onset of contact, durations count from there, and the few trials with a late onset
    (`LATE`) as long as the next one: they use the last window that fits.
    """
    clock_Hz = spikes.sampling_rate_Hz
    begins = spikes.begins(window, np.arange(len(spikes)))
    if begins is not None:
        left_s = left_after(spikes.trial_steps, begins) / clock_Hz
        return Timing(left_s, clock_Hz, from_onset=True, classes=spikes.labels)
    touch_s = common_spike_onset_s(spikes) if spikes.touch_s is None else spikes.touch_s
    return Timing(spikes.trial_steps / clock_Hz, clock_Hz, touch_s, classes=spikes.labels)


def left_after(durations: np.ndarray, onsets: np.ndarray) -> np.ndarray:
    """The time of each trial from its onset on; of the few with a late onset (`LATE`), that of the next one.

    >>> left_after(np.full(11, 10), np.array([9, *[4] * 10])).tolist()
    [6, 6, 6, 6, 6, 6, 6, 6, 6, 6, 6]
    """
    left = durations - onsets
    return np.minimum(np.maximum(left, np.quantile(left, LATE, method="lower")), durations)


def on_late_onsets(spikes: SpikeTrains, timing: Timing, window: WindowSpec, words: Words) -> Iterator[str]:
    """The note on touches that begin at different times, many of them after the middle of the first window.

    Onsets are those of `OnsetSpec`, after a rest that ends before the touch. Without a rest, or if windows are aligned,
    there is no note.
    """
    rest_ms = float(np.floor(RESTS * 1e3 * timing.touch_s))
    if window.align != "trial" or rest_ms < OnsetSpec().bin_ms:
        return
    trials = evenly(len(spikes))
    onsets = spikes.onsets(OnsetSpec(rest_ms=rest_ms), trials)
    onsets_ms = np.array([1e3 * onset / timing.clock_Hz for onset in onsets if onset is not None])
    n_late = int((onsets_ms > window.start_ms + window.length_ms / 2).sum())
    if len(onsets_ms) >= FOUND * len(trials) and n_late > LATE * len(trials):
        yield (
            f"Touches begin at different times, in {n_late} of {len(trials)} trials after the middle of the first "
            f"window; if they are short, try {words.each.format(rest_ms)}."
        )


def choose(timing: Timing, given: Mapping[str, Any] = {}, words: Words = ARGUMENTS) -> tuple[dict[str, Any], list[str]]:
    """The keys of a window that are not given, and the rule in words.

    Windows start where the touch begins. A window is as long as the shortest trial from there on, rounded down to whole
    ms, but at most 2 s and at least one step. Few trials that are far shorter are left out (`long_enough`). A longer
    trial has as many windows as fit: at most 4, and at most 4 s together. If the windows of all trials would last more
    than 4,000 s, a trial has fewer.

    given: keys of `WindowSpec`, with times as numbers. Raises InputError for a start after the end of a trial.

    >>> choose(Timing(np.array([0.8, 1.2]), 1000.0))[0]
    {'length_ms': 800.0, 'per_trial': 1}
    >>> choose(Timing(np.array([2.5, 59.0]), 1000.0, touch_s=0.4))[0]
    {'length_ms': 2000.0, 'per_trial': 2, 'start_ms': 400.0}
    """
    start_ms = _start_ms(timing, given)
    every_ms, kept = _room_ms(timing, start_ms, given)
    room_ms = every_ms[kept]
    shortest_ms, longest_ms = float(room_ms.min()), float(room_ms.max())
    whole_ms = max(float(np.floor(shortest_ms + 1e-6)), 1e3 / timing.clock_Hz)
    length_ms = float(given.get("length_ms", min(LONGEST_MS, whole_ms)))
    per_trial_given = given.get("per_trial")  # a wrong value raises an error with the whole window
    divisor_ms = max(length_ms, 1e-9)  # so does a length of 0
    if not isinstance(per_trial_given, int):
        per_trial_given = min(MOST_PER_TRIAL, min(MOST_OF_TRIAL_MS, MOST_MS / len(room_ms)) // divisor_ms)
    per_trial = int(max(1, min(per_trial_given, longest_ms // divisor_ms)))
    table = {"length_ms": length_ms, "per_trial": per_trial}
    later = " after its onset" if timing.from_onset else ""
    later = f" from {start_ms:g} ms{later} on" if start_ms else later
    if "length_ms" in given:
        why = "as given"
    elif length_ms == LONGEST_MS:
        why = f"{LONGEST_MS / 1e3:g} s at most"
    else:
        why = f"the shortest trial, {shortest_ms:.0f} ms{later}"
    up_to = f"up to {per_trial} windows per trial" if per_trial > 1 else "one window per trial"
    notes = [f"Window: {length_ms:g} ms ({why}), {up_to}; change it with {words.length}."]
    notes += [f"{line}; to use them, shorten {words.length}." for line in left_out(kept, 1e3 * timing.durations_s)]
    if start_ms > 0 and not PLACES & {*given}:
        table["start_ms"] = start_ms
        notes.append(
            f"Windows start {start_ms:g} ms after the start of a trial: before, trials differ much less from one "
            f"another than later, as if nothing was touched; change it with {words.start.format(0)}."
        )
    hop_ms = given.get("hop_ms", length_ms)
    covered_ms = length_ms + (per_trial - 1) * min(hop_ms, length_ms)
    return table, [*notes, *_on_coverage(every_ms, kept, start_ms, covered_ms, given, words)]


def _start_ms(timing: Timing, given: Mapping[str, Any]) -> float:
    """The start of the windows in whole ms, such that a given length fits into the shortest trial."""
    if PLACES & {*given}:
        return float(given.get("start_ms", 0.0))
    left_ms = _shortest_ms(timing) - _on_clock(given.get("length_ms", 0.0), timing)
    return float(np.floor(max(0.0, min(1e3 * timing.touch_s, left_ms))))


def _shortest_ms(timing: Timing) -> float:
    """The shortest trial but for those that are left out."""
    durations_ms = 1e3 * timing.durations_s
    return float(durations_ms[long_enough(durations_ms, timing.classes)].min())


def _room_ms(timing: Timing, start_ms: float, given: Mapping[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """The time of each trial from the step of `start_ms` on, and which trials have windows, `(trial,)` each."""
    room_ms = 1e3 * timing.durations_s - _on_clock(start_ms, timing)
    kept = np.ones(len(room_ms), bool) if "length_ms" in given else long_enough(room_ms, timing.classes)
    shortest = int(np.where(kept, room_ms, np.inf).argmin())
    if room_ms[shortest] * timing.clock_Hz < 1e3 * (1 - 1e-6):
        lasts_ms = 1e3 * timing.durations_s[shortest]
        raise InputError(
            f"window.start_ms: trial {shortest} lasts {lasts_ms:,.0f} ms, so no window can start at {start_ms:g} ms; "
            "start earlier, or leave that trial out"
        )
    return room_ms, kept


def _on_clock(time_ms: float, timing: Timing) -> float:
    """A time rounded to whole steps, as windows are cut."""
    return 1e3 * whole_steps(time_ms, timing.clock_Hz) / timing.clock_Hz


def _on_coverage(
    every_ms: np.ndarray,
    kept: np.ndarray,
    start_ms: float,
    covered_ms: float,
    given: Mapping[str, Any],
    words: Words,
) -> Iterator[str]:
    """The note on a trial that makes all windows short, or on windows that use little of the trials.

    every_ms: of each trial from `start_ms` on, and which have windows, `(trial,)`. covered_ms: of a trial.
    """
    if "length_ms" in given:
        return
    room_ms = np.where(kept, every_ms, np.inf)
    shortest_ms, median_ms = float(room_ms.min()), float(np.median(every_ms[kept]))
    if shortest_ms < min(SHORT * median_ms, LONGEST_MS):
        yield (
            f"Trial {int(room_ms.argmin())} lasts {shortest_ms + start_ms:,.0f} ms, the median trial "
            f"{median_ms + start_ms:,.0f} ms, and every window must fit into it; leave such trials out when you "
            "import, or accept it."
        )
    elif covered_ms < SEEN * median_ms and not PLACES & {*given}:
        if start_ms:
            yield (
                f"Only {covered_ms:,.0f} ms of the median trial, {median_ms:,.0f} ms from there on, are used; if its "
                f"touch lasts longer, give a longer {words.length}."
            )
        else:
            yield (
                f"Only the first {covered_ms:,.0f} ms of the median trial, {median_ms:,.0f} ms, are used; if its touch "
                f"comes later, give a longer {words.length}, {words.start.format('...')} or {words.onset}."
            )


def _on_rest(timing: Timing, window: WindowSpec, words: Words) -> Iterator[str]:
    """The note on windows that end before the touch begins."""
    touch_ms = float(np.floor(1e3 * timing.touch_s))
    fits = touch_ms + window.length_ms <= _shortest_ms(timing)
    if window.length_ms <= touch_ms and fits:
        yield (
            f"The touch seems to begin {touch_ms:g} ms after the start of a trial, and windows before it hold only "
            f"rest; to leave them out, give {words.start.format(f'{touch_ms:g}')}."
        )
