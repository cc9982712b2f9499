"""Values of a study that depend on its recordings: its file, the length and the start of its windows, its seeds, folds.

A study file leaves such a value open with `"auto"`; the rules below choose it before any cell runs. They read a study
that was built with a default in its place, so that every other value is checked. The resolved study contains the chosen
values and, in `notes`, the reasons.
"""

import os
from collections.abc import Mapping, Sequence, Set
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from neurotact import files
from neurotact.data import hdf5
from neurotact.data.augmentation import AUTO as ANY_KIND
from neurotact.data.augmentation import NONE, AugmentationSpec, in_words
from neurotact.data.conditioning import conditioned_length
from neurotact.data.copies import copies_of
from neurotact.data.dataset import SOURCES
from neurotact.data.onset import common_onset_s, onsets_s
from neurotact.data.recordings import LABEL
from neurotact.data.splits import SplitSpec, check_each, split_conditions, turns_of, validation_note
from neurotact.data.trial_choice import EVERY, TrialChoice, chosen_trials, fewer_trials
from neurotact.data.window_choice import FOUND, LATE, RESTS, Timing, Words, choose, left_after
from neurotact.data.windows import WindowSpec
from neurotact.encoders.specs import CLOCK_HZ, exact_note
from neurotact.errors import InputError
from neurotact.networks.training import balancing
from neurotact.spec import Spec, build, override, read, unsaved
from neurotact.studies import sweeps
from neurotact.studies.calibration_keys import is_period

AUTO = "auto"
SMALL = 1000
"""Number of trials up to which three seeds are trained."""
FOLDS, FOLDED = 5, 300
"""Folds that test each trial once, and the most trials for which they are used: 15 % of 300 are 45 test trials."""
TURNS = 3
"""Values of a tested condition that validation leaves out at most, one after the other."""
WORDS = Words(
    "`settings={'window.length_ms': ...}`",
    "`settings={{'window.start_ms': {}}}`",
    "`settings={'window.align': 'onset'}`",
    "`settings={{'window.align': 'onset', 'window.per_trial': 1, 'window.onset.rest_ms': {:g}}}`",
)
"""How the keys of a window are given to a study."""
WINDOW, SEED = "window.", "sweep.seed"
INTEGRATION, MEMBRANE = "encoder.integration", "encoder.tau_mem_ms"
OPEN = (INTEGRATION, MEMBRANE)
"""Keys of an encoder that a study may leave open."""
LONGEST_MS, OF_WINDOW = 50.0, 20.0
"""Of an afferent's membrane: its longest time constant, and how many of them a window lasts."""
SWEPT, TESTED = "sweep.", "split.test_where."
FEWER: dict[str, list[Any]] = {"network.hidden": [50]}
"""What is swept where each network is trained with several kinds of varied copies; of periods those `_equal`."""
EQUAL = "auto equal"
"""In place of refractory periods: those of "auto" that are the same for both populations."""
USUAL_MS = (5.0, 10.0)
"""Refractory periods that follow a step of the clock, of a sensor whose samples last no longer than the first."""
PARTS = {20.0: 4, 10.0: 2, 5.0: 1}
"""For a slower one, parts of a sample that the next period lasts, by how many ms a sample lasts more than."""
MANY = 2000
"""Trials from which on each has one varied copy of a kind: with three, encoding and opponents take hours."""
CHOICE = ("dataset.where", "dataset.leave_out")
"""The keys of the trials that a study uses."""


class _Given(Spec):
    window: WindowSpec = WindowSpec()


class Recorded(NamedTuple):
    """The properties of recordings that the rules use.

    timing: of the trials, on the clock of their windows. rarest: number of trials of the smallest class, without
    copies. conditions: of the trials. onsets_s: of contact, from the start of each trial; NaN without one, None if not
    looked for. n_chosen: trials of the file that may be used, if not all of them are.
    """

    timing: Timing
    sampling_rate_Hz: float
    rarest: int = 0
    conditions: pd.DataFrame = pd.DataFrame()
    onsets_s: np.ndarray | None = None
    n_chosen: int = 0


def table_of(path: Path) -> dict[str, Any]:
    """The table of a study file, which may be one that a run saved."""
    table = read(path)
    return unsaved(table, f"{path}: is a study", "run the study by its name") if "schema" in table else table


def is_period_axis(axis: str) -> bool:
    """Whether an axis of a sweep is of refractory periods alone."""
    return all(map(is_period, axis.split(sweeps.JOIN)))


def _equal(values: Sequence[Any]) -> list[Any]:
    """Of values of an axis, those whose numbers are the same."""
    return [value for value in values if not isinstance(value, list) or len({*value}) == 1]


def closed_periods(sweep: Any) -> dict[str, str]:
    """The axes of refractory periods that a sweep leaves open, which get a default in `sweep`, and by which word."""
    left = {}
    for axis, value in sweep.items() if isinstance(sweep, dict) else ():
        if value in (AUTO, EQUAL) and is_period_axis(axis):
            left[axis], sweep[axis] = value, periods_of(axis, value, USUAL_MS[0])
    return left


def periods_of(axis: str, word: str, sample_ms: float, step_ms: float = 1.0) -> list[Any]:
    """The refractory periods that are tried for a sensor: whole steps of the clock, the shortest one step.

    A step, 5 and 10 ms. For a sensor of less than 200 Hz a step and then a sample, two and four; a half, one and two
    where a sample lasts more than 10 ms; a quarter, a half and one above 20 ms. Those shorter than a sample save
    spikes, too, and lose the least. Pairs of both populations are of the three shortest, the first no longer than the
    second, and the longest with itself.

    >>> [periods_of("encoder.t_ref_ms", "auto", 1e3 / rate_Hz) for rate_Hz in (1000.0, 150.0, 35.6)]
    [[1.0, 5.0, 10.0], [1.0, 7.0, 14.0, 27.0], [1.0, 8.0, 15.0, 29.0]]
    """
    parts = _parts(sample_ms)
    longer = [times * sample_ms / parts for times in (1, 2, 4)] if parts else USUAL_MS
    steps = [1.0, *(float(np.ceil(round(one / step_ms, 6))) for one in longer)]
    every = [step_ms * n_steps for n_steps in dict.fromkeys(steps)]  # of a slow clock, several may be one step
    n = len(axis.split(sweeps.JOIN))
    if n == 1:
        return every
    mixed = [] if word == EQUAL else [(a, b) for b in every[:3] for a in every[:3] if a < b]
    return [[a, *[b] * (n - 1)] for a, b in sorted([*mixed, *zip(every, every, strict=True)], key=lambda ab: ab[::-1])]


def _parts(sample_ms: float) -> int:
    """Parts of a sample that the second shortest period lasts; 0 for the usual periods."""
    return next((parts for more_ms, parts in PARTS.items() if sample_ms > more_ms), 0)


def of_periods(sample_ms: float, step_ms: float = 1.0) -> list[str]:
    """The note on refractory periods that follow the sensor's rate; none where they are the usual ones.

    >>> print(*of_periods(1e3 / 150))
    Refractory periods: 1, 7, 14, 27 ms: a step of the clock; then 1, 2 and 4 samples of 6.67 ms. Shorter than a sample, which lowers rates of spikes alone: 1 ms.
    """  # noqa: E501
    if not (parts := _parts(sample_ms)):
        return []
    every = periods_of("encoder.t_ref_ms", AUTO, sample_ms, step_ms)
    short = ", ".join(f"{one:g}" for one in every if one < sample_ms)
    first, second, third = (f"{times / parts:g}" for times in (1, 2, 4))
    return [
        f"Refractory periods: {', '.join(f'{one:g}' for one in every)} ms: a step of the clock; then {first}, {second} "
        f"and {third} samples of {sample_ms:.3g} ms. Shorter than a sample, which lowers rates of spikes alone: "
        f"{short} ms."
    ]


def closed(table: dict[str, Any]) -> tuple[dict[str, Any], set[str]]:
    """The table of a study file with a default in place of each `"auto"`, and the keys that have it."""
    left, sweep = set(), table.get("sweep")
    if table.get("window") == AUTO:
        table, left = {**table, "window": {}}, {"window"}
    if isinstance(sweep, dict) and sweep.get("seed") == AUTO:
        table, left = {**table, "sweep": {**sweep, "seed": [0]}}, {*left, SEED}
    return table, left


def placed(table: Any, path: Path) -> Any:
    """A table of a study file with the whole paths of what it names: files and folders beside it, or in this folder.

    path: of the study file. A name of nothing that exists, or with `$NEUROTACT_DATA`, stays as it is.
    """
    if not isinstance(table, Mapping):
        return table
    settings = {key: placed(value, path) for key, value in table.items()}
    for key in {"file", "path"} & {*settings}:
        near = files.place_of(path, settings[key]) if isinstance(settings[key], str) and settings[key] else None
        if near is not None:
            settings[key] = str(near.absolute())
    return settings


def with_file(table: dict[str, Any], data: str | Path | None, path: Path) -> dict[str, Any]:
    """The table of a study with the file of recordings that `data` names; path: of the study file, for messages.

    Raises InputError if `data` is missing, or is given although the study names its own recordings.
    """
    dataset = table.get("dataset", {})
    if not isinstance(dataset, dict):
        return table  # building the study raises the error, with the other keys
    named = [key for key in SOURCES if dataset.get(key) is not None]
    if data is not None:
        if named:
            raise InputError(f"`data`: {path.name} names its own recordings (dataset.{named[0]}); leave `data` out")
        return {**table, "dataset": {**dataset, "file": str(file_of(data))}}
    if not named:
        raise InputError(
            f"{path.stem}: names no recordings; give a file with `data='touches.h5'`; "
            "`nt.read_folder` makes one from your files"
        )
    return table


def suit(
    table: dict[str, Any], recorded: Recorded, left: Set[str], given: Mapping[str, Any], *, split: SplitSpec
) -> tuple[dict[str, Any], list[str]]:
    """The table of a study with values that suit its recordings, in place of those `left` open, and the rules in words.

    given: dotted keys, which stay. split: how the study divides trials.
    """
    notes = []
    if "window" in left - given.keys():
        chosen, notes = window(recorded.timing, given)
        is_placed = any(f"{WINDOW}{key}" in given for key in ("align", "start_ms"))
        aligned = None if is_placed else _from_onset(recorded, chosen, given)
        chosen, notes = aligned or (chosen, notes)
        table = {**table, "window": override(chosen, _of_window(given))}
    if "augmentation" in table and "search" not in table and (columns := untrained_conditions(table)):
        table, note = _for_remedies(table, recorded, given, columns)
        notes += note
    if table.get("balance", "none") != "none":
        notes += _of_balance(table, recorded)
    if split.leave_aside:
        first, *_ = tested = _tested(table)
        chooses = validation_note(recorded.conditions, first)
        lines = check_each(recorded.conditions, [spec.test_where for spec in tested], split)
        notes += [f"Split: {line}. For the first one: {chooses[0].lower()}{chooses[1:]}." for line in lines]
    if SEED in left:
        table, note = _with_seeds(table, recorded, given, split=split)
        notes += [] if {"seed", SEED} & given.keys() else [note]
    return table, notes


def untrained_conditions(table: Mapping[str, Any]) -> list[str]:
    """The conditions whose values a study tests and does not train on.

    >>> untrained_conditions({"sweep": {"split.test_where.speed & split.test_where.force": [[150, 3], [300, 6]]}})
    ['speed', 'force']
    """
    split = table.get("split")
    fixed = split.get("test_where") if isinstance(split, Mapping) else None
    swept = [key.removeprefix(TESTED) for key in sweeps.keys(table.get("sweep", {})) if key.startswith(TESTED)]
    return [*(fixed or {}), *swept]


def _from_onset(
    recorded: Recorded, chosen: Mapping[str, Any], given: Mapping[str, Any]
) -> tuple[dict[str, Any], list[str]] | None:
    """Windows from the onset of contact, where touches begin at different times; None where they do not.

    chosen: the keys of windows at a fixed time. At another speed a touch begins at another time, so a study that tests
    conditions that it does not train on uses this rule.
    """
    onsets_s, touch_s = recorded.onsets_s, recorded.timing.touch_s
    if onsets_s is None or np.isnan(onsets_s).mean() > 1 - FOUND:
        return None
    begin_s = np.nan_to_num(onsets_s)
    middle_s = 1e-3 * (chosen.get("start_ms", 0.0) + chosen["length_ms"] / 2)
    n_late = int((begin_s > middle_s).sum())
    if n_late <= LATE * len(begin_s):
        return None
    left_s = left_after(recorded.timing.durations_s, begin_s)
    timing = Timing(left_s, recorded.timing.clock_Hz, from_onset=True, classes=recorded.timing.classes)
    table, notes = window(timing, {f"{WINDOW}per_trial": 1, **given})
    note = (
        f"Windows start at the onset of contact: touches begin at different times, in {n_late} of {len(begin_s)} "
        "trials after the middle of a window at a fixed time, and at other conditions at others; "
        "for a fixed time: `settings={'window.align': 'trial'}`."
    )
    rest_ms = float(np.floor(RESTS * 1e3 * touch_s))
    return {**table, "align": "onset", "onset": {"rest_ms": rest_ms}}, [*notes, note]


def _for_remedies(
    table: dict[str, Any], recorded: Recorded, given: Mapping[str, Any], columns: Sequence[str]
) -> tuple[dict[str, Any], list[str]]:
    """A study that trains on varied copies, too, with fewer periods and sizes: each takes several trainings."""
    copies, of_each = table["augmentation"], ""
    if len(recorded.timing.durations_s) > MANY and "copies" not in copies:
        copies, of_each = {"copies": 1, **copies}, ", one of each trial since there are many"
    if copies.get("kind", ANY_KIND) == ANY_KIND:
        copies = {**_starts(table.get("window", {})), **copies}
    augmentation = build(AugmentationSpec, copies, source="augmentation")
    if augmentation.kind == NONE:
        return table, []
    sweep, fewer = {**table["sweep"]}, []
    own = {key: _equal(values) for key, values in sweep.items() if is_period_axis(key) and _equal(values)}
    for key, values in {**FEWER, **own}.items():
        if key in sweep and len(sweep[key]) > len(values) and f"{SWEPT}{key}" not in given:
            sweep[key], fewer = values, [*fewer, key]
    names = " and ".join(columns)
    if augmentation.kind != ANY_KIND:
        what = f"also on copies {in_words(augmentation.kind, augmentation)}"
    elif _can_rank(recorded, table):
        every = in_words(augmentation.candidates[-1], augmentation)
        what = f"also on copies {every}, or some of these, where that is best on validation trials of another {names}"
    else:
        every = in_words(augmentation.candidates[-1], augmentation)
        what = f"also on copies {every}, since training trials have too few values of {names} to choose"
    what += of_each
    note = f"Training: on the recorded trials and {what}; without copies: `settings={{'augmentation.kind': 'none'}}`."
    less = " Fewer sizes and refractory periods are trained, because of that." if fewer else ""
    return {**table, "augmentation": copies, "sweep": sweep}, [note + less]


def _of_balance(table: Mapping[str, Any], recorded: Recorded) -> list[str]:
    """What the balance of training trials changes in the first test."""
    stratify = table.get("dataset", {}).get("stratify", ())
    first = _tested(table)[0]
    columns = balancing.columns_of(table["balance"], first, stratify, balancing.SETTINGS)
    training = recorded.conditions.iloc[split_conditions(recorded.conditions, stratify, first).train]
    line = balancing.note(training, table["balance"], columns, balancing.SETTINGS)
    return [f"{line[0].upper()}{line[1:]}."]


def _starts(window: Mapping[str, Any]) -> dict[str, Any]:
    """Whether copies may begin later, and how much: up to a window, where windows do not begin at contact."""
    if window.get("align") == "onset" or "length_ms" not in window:
        return {}
    return {"any_start": True, "shift_ms": min(AugmentationSpec().shift_ms, float(window["length_ms"]))}


def _can_rank(recorded: Recorded, table: Mapping[str, Any]) -> bool:
    """Whether validation can leave out a value of the tested conditions, whichever of them is tested."""
    return all(turns_of(recorded.conditions, spec) for spec in _tested(table))


def _tested(table: Mapping[str, Any]) -> list[SplitSpec]:
    """The split of each test on other conditions."""
    split = table.get("split") or {}
    swept = {axis: values for axis, values in table["sweep"].items() if TESTED in axis}
    points = ({key.removeprefix(TESTED): value for key, value in point.items() if key.startswith(TESTED)}
              for point in sweeps.points(swept))  # fmt: skip
    tests = ({**(split.get("test_where") or {}), **point} for point in points)
    return [build(SplitSpec, {**split, "test_where": test}, source="split") for test in tests]


def file_of(data: str | Path) -> Path:
    """The absolute path of the file that `data` names; InputError if it does not exist."""
    if not os.path.isfile(data):  # as of `files.existing`: a name may be too long
        raise InputError(f"`data={str(data)!r}`: there is no such file; `nt.read_folder` makes one from your files")
    return Path(data).absolute()


def note_of(choice: TrialChoice) -> str | None:
    """The trials that a study uses, in words; None for all."""
    return f"Trials: {choice}." if choice else None


def membrane_ms(length_ms: float, own_ms: float) -> float:
    """The time constant of the afferents' membranes, for windows of a length: a twentieth of it, at most `LONGEST_MS`.

    It is not below the encoder's own. A membrane of 10 ms sends its spikes far above threshold or not at all; a longer
    one averages noise and sends a half to a third of them at the accuracy of before, in windows of 1 s or more.

    >>> membrane_ms(2000.0, 10.0), membrane_ms(500.0, 10.0), membrane_ms(150.0, 10.0)
    (50.0, 25.0, 10.0)
    """
    return max(own_ms, min(LONGEST_MS, round(length_ms / OF_WINDOW, 1)))


def of_membrane(tau_ms: float, own_ms: float, window: str = "window") -> list[str]:
    """The note on other membranes than the encoder's own; window: which of them they follow, in words."""
    if tau_ms == own_ms:
        return []
    return [
        f"Afferents: membranes of {tau_ms:g} ms, a twentieth of the {window} and at most {LONGEST_MS:g} ms, which send "
        f"fewer spikes; those of the encoder: `settings={{'{MEMBRANE}': {own_ms:g}}}`."
    ]


def of_fewer(recorded: Recorded) -> list[str]:
    """How many trials are used, in words; nothing if none but the chosen ones are left out."""
    n = len(recorded.conditions)
    if n >= recorded.n_chosen:
        return []
    return [
        f"Trials: {n:,} of {recorded.n_chosen:,}, evenly spaced within each class and condition, for an answer in one "
        f"sitting; all: `settings={{'dataset.at_most': {recorded.n_chosen}}}`."
    ]


def look(
    path: str | Path,
    clock_Hz: float | None = None,
    choice: TrialChoice = EVERY,
    *,
    at_most: int | None = None,
    onsets: bool = False,
) -> Recorded:
    """The properties of the chosen trials in a file of recordings, with trial durations on a clock.

    clock_Hz: of the encoder; if absent, the sampling rate of the recordings, but at least the clock of calibration.
    at_most: as of a study's data set.
    """
    if hdf5.kind_of(path) != "recordings":
        raise InputError(
            f"{path}: holds spikes, but this study encodes recordings; for spikes, `nt.train` and then "
            "`nt.infer(..., early_exit=True)` report the accuracy of a network, and its SOPs and ms per decision"
        )
    with hdf5.open_recordings(path) as every:
        chosen = chosen_trials(every, choice, str(path), tell=False)
        stored = fewer_trials(chosen, at_most)
        rate_Hz = stored.sampling_rate_Hz
        on_Hz = clock_Hz or max(rate_Hz, CLOCK_HZ)
        n_steps = [conditioned_length(n_samples, rate_Hz, on_Hz) for n_samples in stored.lengths.tolist()]
        distinct = np.unique(copies_of(stored).first)
        rarest = int(stored.conditions[LABEL].iloc[distinct].value_counts().min())
        touch_s = common_onset_s(stored)
        begin_s = onsets_s(stored, RESTS * touch_s) if onsets else None
        timing = Timing(np.array(n_steps) / on_Hz, on_Hz, touch_s, classes=stored.labels)
        return Recorded(timing, rate_Hz, rarest, stored.conditions, begin_s, len(chosen))


def window(timing: Timing, given: Mapping[str, Any] = {}) -> tuple[dict[str, Any], list[str]]:
    """The window of a study, as `data.window_choice.choose`; given: dotted keys such as `window.length_ms`."""
    given_window = build(_Given, {"window": override({}, _of_window(given))}, source="`settings`").window
    return choose(timing, {key: getattr(given_window, key) for key in given_window.model_fields_set}, WORDS)


def _of_window(given: Mapping[str, Any]) -> dict[str, Any]:
    return {key.removeprefix(WINDOW): value for key, value in given.items() if key.startswith(WINDOW)}


def seeds(n_trials: int) -> tuple[list[int], str]:
    """Three seeds for up to 1000 trials, one for more, and the rule in words.

    >>> seeds(300)[0]
    [0, 1, 2]
    """
    if n_trials <= SMALL:
        return [0, 1, 2], f"Seeds: 3, since there are no more than {SMALL:,} trials ({n_trials:,})."
    return [0], f"Seeds: 1, since there are more than {SMALL:,} trials ({n_trials:,})."


def _with_seeds(
    table: dict[str, Any], recorded: Recorded, given: Mapping[str, Any], *, split: SplitSpec
) -> tuple[dict[str, Any], str]:
    """A study's table with its seeds, and with folds if trials are few and no split is given; the rule in words.

    A few test trials give an uncertain accuracy; with folds, every trial is a test trial once. If the test is on other
    conditions, each seed of the split validates on another one that training leaves out.
    """
    n_trials = len(recorded.timing.durations_s)
    seeds_found, note = seeds(n_trials)
    if any(key.startswith(TESTED) for key in sweeps.keys(table["sweep"])):
        seeds_found, note = [0], "Seeds: 1 for each tested condition."
    sweep = {**table["sweep"]} if {"seed", SEED} & given.keys() else {**table["sweep"], "seed": seeds_found}
    if split.test_where and not {"split.seed", "sweep.split.seed", "seed", SEED} & given.keys():
        turns = turns_of(recorded.conditions, split)[:TURNS]
        if len(turns) > 1:
            sweep |= {"split.seed": [*range(len(turns))], "seed": [0]}
        return {**table, "sweep": sweep}, f"Split: {validation_note(recorded.conditions, split, at_most=TURNS)}."
    is_given = any(key == "seed" or key.startswith(("split", SEED, "sweep.split")) for key in given)
    if is_given or split.model_fields_set or n_trials > FOLDED or recorded.rarest < FOLDS:
        return {**table, "sweep": sweep}, note
    note = (
        f"Split: {FOLDS} folds with one random seed each, so that each of the {n_trials} trials is tested once; for "
        "one split with three seeds: `settings={'sweep.seed': [0, 1, 2]}`."
    )
    sweep |= {"split.fold": [*range(FOLDS)], "seed": [0]}
    return {**table, "split": {"folds": FOLDS}, "sweep": sweep}, note


def clock(recorded: Recorded, clock_Hz: float | None, *, exact: bool = False) -> list[str]:
    """The effect of the encoder's clock on these recordings, in words; empty if it equals their sampling rate.

    exact: whether membranes are in closed form, so that the clock is that of the spikes alone.
    """
    rate_Hz = recorded.sampling_rate_Hz
    if clock_Hz is None or clock_Hz == rate_Hz:
        return []
    note = f"Clock: {clock_Hz:g} Hz, so that refractory periods of whole ms are exact; recorded at {rate_Hz:g} Hz"
    if exact:
        computed = exact_note(clock_Hz, rate_Hz)
        return [f"{computed[0].upper()}{computed[1:]}."]
    if rate_Hz >= clock_Hz:
        return [f"{note}, smoothed and resampled."]
    sample_ms = 1e3 / rate_Hz
    between = f"{note}, where a sample lasts {sample_ms:.3g} ms; between samples the signal is interpolated"
    return [f"{between}; refractory periods below {sample_ms:.3g} ms limit rates, but show no finer detail."]
