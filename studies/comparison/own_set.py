"""A user's own file as the only set of a study: the choices for it, and errors if it cannot be used.

Window, seeds, clock, baseline and how afferents are computed are chosen as in the study `own-recordings`.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from neurotact_parts.studies.comparison.sets import OWN_MS, SetSpec, WaysData, integration_of

from neurotact.data import doubtful, hdf5
from neurotact.data.conditioning import ACAUSAL, ConditioningSpec
from neurotact.data.copies import Copies, copies_of
from neurotact.data.digests import content_digest
from neurotact.data.recordings import class_names
from neurotact.data.splits import SplitSpec, split_conditions
from neurotact.data.trial_choice import TrialChoice, chosen_trials
from neurotact.data.window_choice import timing_of
from neurotact.data.windows import cut
from neurotact.encoders.afferents import AfferentSpec
from neurotact.encoders.specs import CLOCK_HZ, PAST
from neurotact.errors import InputError
from neurotact.spec import build, load, override
from neurotact.studies import automatic
from neurotact.studies.automatic import AUTO, MEMBRANE, OPEN, Recorded
from neurotact.studies.way import Own

ENCODER = "sa1-ra1-lif"
"""The encoder with the conditioning to use, except its clock, and except a baseline that uses the whole trial."""
SEED, SPLITS, GROUP = "sweep.seed", "sweep.split.seed", "split.group"
CHOSEN = {"choose_baseline": "baseline", "choose_ema": "ema_cutoff_Hz"}
"""Keys of the conditioning that are chosen on training trials unless they are given."""
OF_SET = ("window.", "conditioning.")
"""Prefixes of the keys of the set that can be set, as in a study of recordings."""


class Touches(NamedTuple):
    """The content of a file: recordings, or events if `unit` is None.

    steps, clock_Hz: length of each trial, `(trial,)`, and steps per second, as the windows are cut.
    copies: among the trials.
    """

    name: str
    unit: str | None
    recorded: Recorded
    steps: np.ndarray
    clock_Hz: float
    conditions: pd.DataFrame
    content: str
    copies: Copies


def own(path: Path, given: Mapping[str, Any]) -> Own:
    """The study of a file in place of its sets; see `neurotact/studies/way.py`.

    Keys that begin with `window.` and `conditioning.`, those of `automatic.OPEN`, `split.group`, the choice of trials
    (`where`, `leave_out`) and the seeds of splits (`repeats`) apply to the file's set. Raises InputError for a file
    without trials of two classes, for windows that do not fit into a trial, for trials that some seed cannot split, and
    for another choice of test trials.
    """
    of_set = {key: value for key, value in given.items() if key.startswith(OF_SET)}
    group = build(SplitSpec, {"group": given[GROUP]} if GROUP in given else {}, source=GROUP).group
    elsewhere = {*of_set, GROUP, *OPEN, *automatic.CHOICE}
    others = _with_swept_seeds({key: value for key, value in given.items() if key not in elsewhere})
    choice = choice_of(given)
    conditioning = _conditioning(of_set)
    clock_Hz = float(conditioning["resample_Hz"])
    touches = _look(path, clock_Hz, choice)
    if touches.unit is None and any(key.startswith("conditioning.") for key in of_set):
        raise InputError(f"conditioning: {path} holds events, which are not conditioned; leave it out")
    of_afferents = [key for key in OPEN if key in given]
    if touches.unit is None and of_afferents:
        raise InputError(f"{of_afferents[0]}: {path} holds events, which no afferents encode; leave it out")
    window, notes = automatic.window(touches.recorded.timing, of_set)
    notes = [*([] if (note := automatic.note_of(choice)) is None else [note]), *notes]
    dataset = {"file": str(path), "content": touches.content, **choice._asdict()}
    chosen: dict[str, Any] = {"dataset": dataset, "window": window, "group": [*group]}
    if touches.unit is not None:
        is_open = {key: f"conditioning.{of}" not in of_set for key, of in CHOSEN.items()}
        is_open["choose_opposite"] = is_open["choose_baseline"]
        computed = {key.removeprefix("encoder."): given[key] for key in of_afferents}
        chosen |= {"unit": touches.unit, "conditioning": conditioning, **computed, **is_open}
    table = override(chosen, of_set)
    if others.get(SEED) == AUTO:
        others[SEED], note = automatic.seeds(len(touches.conditions))
        notes.append(note)
    notes += doubtful.of_copies(touches.conditions, touches.copies)
    built = build(SetSpec, table, source=str(path))
    if touches.unit is not None:
        is_exact = integration_of(built, touches.recorded.sampling_rate_Hz) == "exact"
        notes += automatic.clock(touches.recorded, clock_Hz, exact=is_exact)
        notes += [] if MEMBRANE in given else automatic.of_membrane(built.membrane_ms, OWN_MS)
    by = {"data.split": "groups"} if group else {}
    _check(touches, built, others.get(SEED), **{key.removeprefix("data."): value for key, value in by.items()})
    changes = {"sweep.data.set": [touches.name], "data.sets": {touches.name: table}, **by, **others}
    return Own(changes, tuple(notes))


def _with_swept_seeds(given: Mapping[str, Any]) -> dict[str, Any]:
    """The keys with all given seeds as `sweep.seed`: each seed has its own split."""
    wrong = [key for key in given if key.removeprefix("sweep.").startswith("split") and key != SPLITS]
    if wrong:
        asked = "`leave_out_each`" if wrong[0].startswith(f"sweep.{automatic.TESTED}") else wrong[0]
        raise InputError(
            f"{asked}: this study draws its test trials at random, 15 % for each seed, and `order`, `folds`, "
            "`test_where` and `leave_out_each` do not apply; give `group` or `repeats`, or leave it out"
        )
    if SPLITS in given and "seed" in given:
        raise InputError("`repeats`: each seed has its own split, and seed is also given; give only one of them")
    settings = {key: value for key, value in given.items() if key not in (SPLITS, "seed")}
    if "seed" in given:
        settings[SEED] = [given["seed"]]
    return settings | ({SEED: given[SPLITS]} if SPLITS in given else {})


def _conditioning(given: Mapping[str, Any]) -> dict[str, Any]:
    """The conditioning of the shipped encoder on a clock of 1 kHz, with the given changes."""
    keys = {key.removeprefix("conditioning."): value for key, value in given.items() if key.startswith("conditioning.")}
    if keys.get("baseline") in ACAUSAL:
        raise InputError(
            f"conditioning.baseline: '{keys['baseline']}' uses the whole trial; name one of {', '.join(PAST)}, or "
            "leave it out: then the training trials choose one of them"
        )
    shipped = load(AfferentSpec, ENCODER).conditioning.model_dump(mode="json", exclude_none=True)
    built = build(ConditioningSpec, {**shipped, "resample_Hz": CLOCK_HZ, **keys}, source="conditioning")
    return built.model_dump(mode="json", exclude_none=True)


def choice_of(given: Mapping[str, Any]) -> TrialChoice:
    """The trials that the given dotted keys choose."""
    return TrialChoice.of(*(given.get(key) for key in automatic.CHOICE))


def _look(path: Path, clock_Hz: float, choice: TrialChoice) -> Touches:
    """The content of the chosen trials of a file, with a line of their number.

    InputError for the spikes of an encoder, which already have a refractory period.
    """
    if hdf5.kind_of(path) == "recordings":
        recorded = automatic.look(path, clock_Hz, choice)
        with hdf5.open_recordings(path) as every:
            stored = chosen_trials(every, choice, str(path))
            unit, conditions, content = stored.unit, stored.conditions, content_digest(stored)
            copies = copies_of(stored)
        steps = np.round(recorded.timing.durations_s * clock_Hz).astype(np.int64)
        return Touches("recordings", unit, recorded, steps, clock_Hz, conditions, content, copies)
    trains = chosen_trials(hdf5.load_spikes(path), choice, str(path))
    if trains.encoder:
        raise InputError(
            f"{path}: holds spikes that an encoder made, with its refractory periods; give the recordings that they "
            "were made from, or events of a sensor that sends them (neurotact import events)"
        )
    recorded = Recorded(timing_of(trains), trains.sampling_rate_Hz)
    return Touches("events", None, recorded, trains.trial_steps, trains.sampling_rate_Hz, trains.conditions,
                   content_digest(trains), copies_of(trains))  # fmt: skip


def _check(touches: Touches, chosen: SetSpec, seeds: Any, **by: Any) -> None:
    """Raise, before anything is computed, the errors that a cell would raise; seeds: as far as they are known here."""
    classes = class_names(touches.conditions)
    if len(classes) < 2:
        raise InputError(f"{chosen.dataset.file}: holds one class, '{''.join(classes)}'; give trials of at least two")
    cut(touches.steps, touches.clock_Hz, chosen.window)
    missing = [name for name in chosen.group if name not in touches.conditions]
    if missing:
        raise InputError(
            f"`group`: there is no condition '{missing[0]}'; known: {', '.join(map(str, touches.conditions.columns))}"
        )
    data = WaysData(set=touches.name, sets={touches.name: chosen}, **by)
    for seed in seeds if isinstance(seeds, list) else []:
        if isinstance(seed, int) and seed >= 0:  # other values raise an error with the sweep
            split_conditions(touches.conditions, (), data.split_of(seed), touches.copies.first)
