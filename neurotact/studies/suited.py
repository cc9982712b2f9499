"""Values of a study that depend on its recordings: its file, the length and the start of its windows, its seeds, folds.

A study file leaves such a value open with `"auto"`; the rules below choose it before any cell runs. The resolved study
contains the chosen values and, in `notes`, the reasons.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from neurotact.data import hdf5
from neurotact.data.conditioning import conditioned_length
from neurotact.data.onset import common_onset_s
from neurotact.data.recordings import LABEL
from neurotact.data.sources import expand
from neurotact.data.trial_choice import EVERY, TrialChoice, chosen_trials
from neurotact.data.window_choice import Timing, Words, choose
from neurotact.encoders.calibration import CLOCK_HZ
from neurotact.errors import InputError
from neurotact.spec import override

AUTO = "auto"
SMALL = 1000
"""Number of trials up to which three seeds are trained."""
FOLDS, FOLDED = 5, 300
"""Folds that test each trial once, and the most trials for which they are used: 15 % of 300 are 45 test trials."""
SOURCES = ("simulate", "read", "file")
WORDS = Words(
    "--window-ms",
    "--set window.start_ms=",
    "--set window.align=onset",
    "--set window.align=onset --set window.per_trial=1 --set window.onset.rest_ms={:g}",
)
"""How the keys of a window are given to a study."""
WINDOW, DATASET = "window.", "dataset."
CHOICE = ("dataset.where", "dataset.leave_out")
"""The keys of the trials that a study uses."""


class Recorded(NamedTuple):
    """The properties of recordings that the rules use.

    timing: of the trials, on the clock of their windows. rarest: number of trials of the smallest class.
    """

    timing: Timing
    sampling_rate_Hz: float
    rarest: int = 0


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
    recorded = look(expand(file), clock_of(table, overrides), choice_of(dataset, overrides))
    if table.get("window") == AUTO:
        table["window"], more = window(recorded.timing, overrides)
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


def choice_of(dataset: Mapping[str, Any], given: Mapping[str, Any]) -> TrialChoice:
    """The trials that a study uses, from the given dotted keys or from its table of the data set."""
    own = {key.removeprefix(DATASET): value for key, value in given.items() if key.startswith(DATASET)}
    table = override(dataset, own)
    return TrialChoice.of(table.get("where"), table.get("leave_out"))


def with_choice(table: dict[str, Any]) -> dict[str, Any]:
    """The table of a study with a note of the trials that it uses, if these are not all."""
    dataset = table.get("dataset")
    note = note_of(choice_of(dataset, {})) if isinstance(dataset, Mapping) else None
    notes = table.get("notes", [])
    return table if note is None or note in notes else {**table, "notes": [note, *notes]}


def note_of(choice: TrialChoice) -> str | None:
    """The trials that a study uses, in words; None for all."""
    return f"Trials: {choice}." if choice else None


def look(path: str | Path, clock_Hz: float | None = None, choice: TrialChoice = EVERY) -> Recorded:
    """The properties of the chosen trials in a file of recordings, with trial durations on a clock.

    clock_Hz: of the encoder; if absent, the sampling rate of the recordings, but at least the clock of calibration.
    """
    if hdf5.kind_of(path) != "recordings":
        raise InputError(
            f"{path}: holds spikes, but this study encodes recordings; for spikes, neurotact train and then "
            "neurotact infer --early-exit report the accuracy of a network, and its SOPs and ms per decision"
        )
    with hdf5.open_recordings(path) as every:
        stored = chosen_trials(every, choice, str(path), tell=False)
        rate_Hz = stored.sampling_rate_Hz
        on_Hz = clock_Hz or max(rate_Hz, CLOCK_HZ)
        n_steps = [conditioned_length(n_samples, rate_Hz, on_Hz) for n_samples in stored.lengths.tolist()]
        rarest = int(stored.conditions[LABEL].value_counts().min())
        return Recorded(Timing(np.array(n_steps) / on_Hz, on_Hz, common_onset_s(stored)), rate_Hz, rarest)


def window(timing: Timing, given: Mapping[str, Any] = {}) -> tuple[dict[str, Any], list[str]]:
    """The window of a study, as `data.window_choice.choose`; given: dotted keys such as `window.length_ms`."""
    known = {key.removeprefix(WINDOW): value for key, value in given.items() if key.startswith(WINDOW)}
    for key in ("length_ms", "start_ms", "hop_ms"):
        value = known.get(key, 0.0)
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not value >= 0:
            raise InputError(f"--set {WINDOW}{key}: must be a number of ms; got {value!r}")
    return choose(timing, known, WORDS)


def seeds(n_trials: int) -> tuple[list[int], str]:
    """Three seeds for up to 1000 trials, one for more, and the rule in words.

    >>> seeds(300)[0]
    [0, 1, 2]
    """
    if n_trials <= SMALL:
        return [0, 1, 2], f"Seeds: 3, since there are no more than {SMALL:,} trials ({n_trials:,})."
    return [0], f"Seeds: 1, since there are more than {SMALL:,} trials ({n_trials:,})."


def _with_seeds(table: dict[str, Any], given: Mapping[str, Any], recorded: Recorded) -> tuple[dict[str, Any], str]:
    """A study's table with its seeds, and with folds if trials are few and no split is given; the rule in words.

    A few test trials give an uncertain accuracy; with folds, every trial is a test trial once.
    """
    n_trials = len(recorded.timing.durations_s)
    found, note = seeds(n_trials)
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
