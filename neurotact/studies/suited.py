"""Values of a study that depend on its recordings: its file, the length and the start of its windows, its seeds, folds.

A study file leaves such a value open with `"auto"`; the rules below choose it before any cell runs. The resolved study
contains the chosen values and, in `notes`, the reasons.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from neurotact.data import hdf5
from neurotact.data.conditioning import conditioned_length
from neurotact.data.onset import common_onset_s
from neurotact.data.recordings import LABEL
from neurotact.data.sources import expand
from neurotact.encoders.calibration import CLOCK_HZ
from neurotact.errors import InputError

AUTO = "auto"
LONGEST_MS = 2000.0
"""Maximum length of a window: longer trials are cut into several."""
MOST_PER_TRIAL, MOST_OF_TRIAL_MS, MOST_MS = 4, 4000.0, 4e6
"""Maximum number of windows of one trial, their total length, and that of all trials: more windows take time and add
little information."""
SMALL = 1000
"""Number of trials up to which three seeds are trained."""
FOLDS, FOLDED = 5, 300
"""Folds that test each trial once, and the most trials for which they are used: 15 % of 300 are 45 test trials."""
SOURCES = ("simulate", "read", "file")
SHORT = 0.5
"""A shortest trial below this share of the median trial gives a note."""
SEEN = 0.5
"""Windows that cover less than this share of the median trial give a note."""
STARTS = {"window.start_ms", "window.align"}
"""Keys that place the beginning of the windows in the trial."""


class Recorded(NamedTuple):
    """The properties of recordings that the rules use: durations in seconds, `(trial,)`, sampling rate, class size.

    rarest: number of trials of the smallest class. touch_s: when the touch begins, from the start of the trials.
    """

    durations_s: np.ndarray
    sampling_rate_Hz: float
    rarest: int = 0
    touch_s: float = 0.0


def suit(table: dict[str, Any], overrides: Mapping[str, Any], data: str | Path | None, path: Path) -> dict[str, Any]:
    """The table of a study file, with its file of recordings and with chosen values in place of `"auto"`.

    overrides: dotted keys that are given; a given value is not chosen. data: the file that `--data` names.
    path: of the study file, for messages.
    Raises InputError if `data` is missing, or is given although the study names its own recordings.
    """
    table = _with_file(table, overrides, data, path)
    dataset, notes = table["dataset"], []
    sweep = table.get("sweep", {})
    is_open = table.get("window") == AUTO or (isinstance(sweep, dict) and sweep.get("seed") == AUTO)
    if not is_open:
        return table
    file = dataset.get("file")
    if not isinstance(file, str):
        raise InputError(f"{path}: '{AUTO}' is chosen from a file of recordings; name one with --data or dataset.file")
    recorded = look(expand(file), clock_of(table, overrides))
    if table.get("window") == AUTO:
        table["window"], more = window(recorded, overrides)
        notes += more
    if table.get("sweep", {}).get("seed") == AUTO:
        table, note = _with_seeds(table, overrides, recorded)
        notes += [] if {"seed", "sweep.seed"} & {*overrides} else [note]
    notes += clock(recorded, clock_of(table, overrides))
    return {**table, "notes": [*table.get("notes", []), *notes]}


def _with_file(
    table: dict[str, Any], overrides: Mapping[str, Any], data: str | Path | None, path: Path
) -> dict[str, Any]:
    dataset = table.get("dataset")
    dataset = {} if dataset is None else dataset
    if not isinstance(dataset, dict):
        return table  # building the study raises the error, with the other keys
    named = [key for key in SOURCES if dataset.get(key) is not None or f"dataset.{key}" in overrides]
    if data is not None:
        if named:
            raise InputError(f"--data: {path.name} names its own recordings (dataset.{named[0]}); leave --data out")
        return {**table, "dataset": {**dataset, "file": str(file_of(data))}}
    if not named:
        raise InputError(
            f"{path.stem}: names no recordings; give a file with --data touches.h5 (in Python, data='touches.h5'); "
            "neurotact import folder makes one from your files"
        )
    given = {key.removeprefix("dataset."): value for key, value in overrides.items() if key == "dataset.file"}
    return {**table, "dataset": {**dataset, **given}}


def file_of(data: str | Path) -> Path:
    """The absolute path of the file that `--data` names; InputError if it does not exist."""
    if not Path(data).is_file():
        raise InputError(f"--data {data}: there is no such file; neurotact import folder makes one from your files")
    return Path(data).absolute()


def clock_of(table: Mapping[str, Any], given: Mapping[str, Any]) -> float | None:
    """The clock of a study's encoder, from the given dotted keys or from the study's table."""
    encoder = table.get("encoder")
    own = encoder.get("conditioning", {}).get("resample_Hz") if isinstance(encoder, dict) else None
    return given.get("encoder.conditioning.resample_Hz", own)


def look(path: str | Path, clock_Hz: float | None = None) -> Recorded:
    """The properties of a file of recordings, with trial durations on a clock.

    clock_Hz: of the encoder; if absent, the sampling rate of the recordings, but at least the clock of calibration.
    """
    if hdf5.kind_of(path) != "recordings":
        raise InputError(
            f"{path}: holds spikes, but this study encodes recordings; for spikes, neurotact train and then "
            "neurotact infer --early-exit report the accuracy of a network, and its SOPs and ms per decision"
        )
    with hdf5.open_recordings(path) as stored:
        rate_Hz = stored.sampling_rate_Hz
        on_Hz = clock_Hz or max(rate_Hz, CLOCK_HZ)
        n_steps = [conditioned_length(n_samples, rate_Hz, on_Hz) for n_samples in stored.lengths.tolist()]
        rarest = int(stored.conditions[LABEL].value_counts().min())
        return Recorded(np.array(n_steps) / on_Hz, rate_Hz, rarest, common_onset_s(stored))


def window(recorded: Recorded, given: Mapping[str, Any] = {}) -> tuple[dict[str, Any], list[str]]:
    """The window of a study, and the rule in words.

    Windows start where the touch begins. A window is as long as the shortest trial from there on, rounded down to whole
    ms, but at most 2 s. A longer trial has as many windows as fit: at most 4, and at most 4 s together. If the windows
    of all trials would last more than 4,000 s, a trial has fewer. given: dotted keys such as `window.length_ms`.

    >>> window(Recorded(np.array([0.8, 1.2]), 1000.0))[0]
    {'length_ms': 800.0, 'per_trial': 1}
    >>> window(Recorded(np.array([2.5, 59.0]), 1000.0, touch_s=0.4))[0]
    {'length_ms': 2000.0, 'per_trial': 2, 'start_ms': 400.0}
    """
    start_ms = _start_ms(recorded, given)
    room_ms = 1e3 * recorded.durations_s - start_ms
    shortest_ms, longest_ms = float(room_ms.min()), float(room_ms.max())
    whole_ms = max(np.floor(shortest_ms + 1e-6), min(shortest_ms, 1.0))
    length_ms = _number(given, "window.length_ms", min(LONGEST_MS, float(whole_ms)))
    asked = given.get("window.per_trial")  # a wrong value raises an error with the study
    divisor_ms = max(length_ms, 1e-9)  # a length of 0 raises an error with the study
    if not isinstance(asked, int):
        asked = min(MOST_PER_TRIAL, min(MOST_OF_TRIAL_MS, MOST_MS / len(room_ms)) // divisor_ms)
    per_trial = int(max(1, min(asked, longest_ms // divisor_ms)))
    table = {"length_ms": length_ms, "per_trial": per_trial}
    later = f" from {start_ms:g} ms on" if start_ms else ""
    if "window.length_ms" in given:
        why = "as given"
    elif length_ms == LONGEST_MS:
        why = f"{LONGEST_MS / 1e3:g} s at most"
    else:
        why = f"the shortest trial, {shortest_ms:,.0f} ms{later}"
    up_to = f"up to {per_trial} windows per trial" if per_trial > 1 else "one window per trial"
    notes = [f"Window: {length_ms:g} ms ({why}), {up_to}; change it with --window-ms."]
    if start_ms > 0 and not STARTS & {*given}:
        table["start_ms"] = start_ms
        notes.append(
            f"Windows start {start_ms:g} ms after the start of a trial: before, trials differ less than half as much "
            "from one another as later, as if nothing was touched; change it with --set window.start_ms=0."
        )
    hop_ms = _number(given, "window.hop_ms", length_ms)
    covered_ms = length_ms + (per_trial - 1) * min(hop_ms, length_ms)
    return table, [*notes, *_on_coverage(room_ms, start_ms, covered_ms, given)]


def _start_ms(recorded: Recorded, given: Mapping[str, Any]) -> float:
    """The start of the windows in whole ms, such that a given length fits into the shortest trial."""
    if STARTS & {*given}:
        return _number(given, "window.start_ms", 0.0)
    left_ms = 1e3 * float(recorded.durations_s.min()) - _number(given, "window.length_ms", 0.0)
    return float(np.floor(max(0.0, min(1e3 * recorded.touch_s, left_ms))))


def _on_coverage(room_ms: np.ndarray, start_ms: float, covered_ms: float, given: Mapping[str, Any]) -> Iterator[str]:
    """The note on a trial that makes all windows short, or on windows that use little of the trials.

    room_ms: of each trial from `start_ms` on, `(trial,)`. covered_ms: of a trial by its windows.
    """
    if "window.length_ms" in given:
        return
    shortest_ms, median_ms = float(room_ms.min()), float(np.median(room_ms))
    if shortest_ms < min(SHORT * median_ms, LONGEST_MS):
        yield (
            f"Trial {int(room_ms.argmin())} lasts {shortest_ms + start_ms:,.0f} ms, the median trial "
            f"{median_ms + start_ms:,.0f} ms, and every window must fit into it; leave such trials out when you "
            "import, or accept it."
        )
    elif covered_ms < SEEN * median_ms and not STARTS & {*given}:
        if start_ms:
            yield (
                f"Only {covered_ms:,.0f} ms of the median trial, {median_ms:,.0f} ms from there on, are used; if its "
                "touch lasts longer, give a longer --window-ms."
            )
        else:
            yield (
                f"Only the first {covered_ms:,.0f} ms of the median trial, {median_ms:,.0f} ms, are used; if its touch "
                "comes later, give a longer --window-ms, --set window.start_ms=MS or --set window.align=onset."
            )


def seeds(recorded: Recorded) -> tuple[list[int], str]:
    """Three seeds for up to 1000 trials, one for more, and the rule in words.

    >>> seeds(Recorded(np.ones(300), 1000.0))[0]
    [0, 1, 2]
    """
    n_trials = len(recorded.durations_s)
    if n_trials <= SMALL:
        return [0, 1, 2], f"Seeds: 3, since there are no more than {SMALL:,} trials ({n_trials:,})."
    return [0], f"Seeds: 1, since there are more than {SMALL:,} trials ({n_trials:,})."


def _with_seeds(table: dict[str, Any], given: Mapping[str, Any], recorded: Recorded) -> tuple[dict[str, Any], str]:
    """A study's table with its seeds, and with folds if trials are few and no split is given; the rule in words.

    A few test trials give an uncertain accuracy; with folds, every trial is a test trial once.
    """
    found, note = seeds(recorded)
    n_trials = len(recorded.durations_s)
    is_given = any(key == "seed" or key.startswith(("split", "sweep.seed", "sweep.split")) for key in given)
    if is_given or table.get("split") or n_trials > FOLDED or recorded.rarest < FOLDS:
        return {**table, "sweep": {**table["sweep"], "seed": found}}, note
    note = (
        f"Split: {FOLDS} folds with one random seed each, so that each of the {n_trials} trials is tested once; for "
        "one split with three seeds: --set sweep.seed=[0,1,2]."
    )
    sweep = {**table["sweep"], "split.fold": [*range(FOLDS)], "seed": [0]}
    return {**table, "split": {"folds": FOLDS}, "sweep": sweep}, note


def clock(recorded: Recorded, clock_Hz: float | None) -> list[str]:
    """The effect of the encoder's clock on these recordings, in words; empty if it equals their sampling rate."""
    rate_Hz = recorded.sampling_rate_Hz
    if clock_Hz is None or clock_Hz == rate_Hz:
        return []
    note = f"Clock: {clock_Hz:g} Hz, so that refractory periods of whole ms are exact; recorded at {rate_Hz:g} Hz"
    if rate_Hz >= clock_Hz:
        return [f"{note}, smoothed and resampled."]
    sample_ms = 1e3 / rate_Hz
    between = f"{note}, where a sample lasts {sample_ms:.3g} ms; between samples the signal is interpolated"
    return [f"{between}; refractory periods below {sample_ms:.3g} ms limit rates, but show no finer detail."]


def _number(given: Mapping[str, Any], key: str, otherwise: float) -> float:
    value = given.get(key, otherwise)
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not value >= 0:
        raise InputError(f"--set {key}: must be a number of ms; got {value!r}")
    return float(value)
