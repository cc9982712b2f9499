"""What each remedy against untrained conditions gains and costs, beside opponents with the same windows and copies.

A remedy is a set of choices of the study `own-recordings` (`Remedy`), whose functions prepare, train and measure every
network. One value of a condition is tested and never trained on; every remedy has the same training, validation and
test trials.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from neurotact_parts.studies.comparison import remedy_answers, touch_sets
from neurotact_parts.studies.comparison.own_set import choice_of
from neurotact_parts.studies.comparison.remedy_answers import DEFAULT, NETWORK, NOTHING
from neurotact_parts.studies.comparison.set_arrays import from_arrays
from neurotact_parts.studies.comparison.skipped import SKIPPED, skipped_row
from neurotact_parts.studies.comparison.touch_sets import TouchData
from pydantic import Field, model_validator

from neurotact import spec
from neurotact.baselines import opponents
from neurotact.baselines.opponent import joined
from neurotact.baselines.opponents import Cuts, Input
from neurotact.data import hdf5
from neurotact.data.augmentation import NONE, AugmentationSpec
from neurotact.data.copies import copies_of
from neurotact.data.digests import content_digest
from neurotact.data.recordings import LABEL, Recordings, class_indices
from neurotact.data.spikes import SpikeTrains
from neurotact.data.splits import Split, SplitSpec, split_conditions, turns_of
from neurotact.data.trial_choice import chosen_trials
from neurotact.data.windows import check_fit
from neurotact.encoders.calibration import GRADES
from neurotact.encoders.specs import CLOCK_HZ, t_ref_pair_ms
from neurotact.errors import InputError, nearest, some
from neurotact.figures.columns import quantity
from neurotact.files import scratch
from neurotact.networks.training import model_selection, tasks
from neurotact.networks.training.tasks import Task
from neurotact.networks.use import ledger, measuring
from neurotact.spec import Spec
from neurotact.studies import automatic, loading, preparation, study, tables_beside
from neurotact.studies.automatic import AUTO
from neurotact.studies.cell import robustly, task_of
from neurotact.studies.study import Cell
from neurotact.studies.sweeps import JOIN
from neurotact.studies.way import Arrays, Own, View, heads

HIDDEN = 50
"""Neurons of the network."""
HALF = "half"
"""A column of conditions that divides the trials of the tested condition into two halves, for `Remedy.trained`."""
PERIODS = f"sweep.{study.PAIR}"
TASKS = "sweep.data.set & condition & value"
TESTED, SPLITS = f"sweep.{automatic.TESTED}", "sweep.split.seed"
"""Keys that `leave_out_each` (without the condition) and `repeats` set."""


class Remedy(Spec):
    """What a study does against untrained conditions; by default nothing."""

    from_contact: bool = False
    """Windows start at the onset of contact, where touches begin at different times."""
    copies: AugmentationSpec = AugmentationSpec(kind=NONE)
    """Varied copies of the training trials."""
    falling: Literal["no", "yes", "chosen"] = "no"
    """SA-I of the falling signal; `chosen`: by calibration."""
    thresholds: Literal["one", "two", "chosen"] = "one"
    """Thresholds of the SA-I under a taxel; `chosen`: by calibration."""
    between: bool = False
    """Calibration chooses between conditions, each of which it tests by the others, and not within them."""
    trained: bool = False
    """Half of the trials of the tested condition are trained on, and the other half tested, in turn: a ceiling."""

    def keys(self) -> dict[str, Any]:
        """The keys of `own-recordings` besides those of its windows, where it would choose otherwise.

        >>> Remedy(copies=AugmentationSpec(), falling="chosen", thresholds="chosen").keys()
        {'augmentation': {}}
        >>> Remedy().keys()
        {'augmentation': {'kind': 'none'}, 'encoder.sa1.opposite': False, 'encoder.sa1.grades': [1.0]}
        """
        settings: dict[str, Any] = {"augmentation": self.copies.model_dump(mode="json", exclude_defaults=True)}
        settings |= {} if self.falling == "chosen" else {"encoder.sa1.opposite": self.falling == "yes"}
        grades = {"one": (1.0,), "two": GRADES}
        settings |= {} if self.thresholds == "chosen" else {"encoder.sa1.grades": [*grades[self.thresholds]]}
        return settings


class Parameters(Spec):
    """One remedy on one set, with one value of a condition left out."""

    data: TouchData
    condition: str = ""
    """The condition of which one value is tested and never trained on; empty: test trials are drawn at random."""
    value: float | str = ""
    remedy: str = NOTHING
    remedies: dict[str, Remedy]
    """All remedies by name."""
    keys: dict[str, Any] = {}
    """Keys of `own-recordings` for all sets."""
    t_ref_ms: tuple[float, float] = (5.0, 5.0)
    """Refractory periods of RA-I and SA-I."""
    seed: int = Field(default=0, ge=0)
    """Random seed of the split, which decides the value that validation leaves out, of weights and order of trials."""

    @model_validator(mode="after")
    def _names_a_remedy(self) -> "Parameters":
        for name in (self.remedy, NOTHING):
            if name not in self.remedies:
                raise ValueError(f"remedy: '{name}' is not one of the remedies; {nearest(name, list(self.remedies))}")
        if (self.condition == "") != (self.value == ""):
            raise ValueError("condition and value: give both, or none for test trials at random")
        return self

    @property
    def chosen(self) -> Remedy:
        return self.remedies[self.remedy]


VIEW = View(
    by=("tested", "remedy", "classifier", "input"),
    measures=heads(
        "accuracy_test accuracy_seen sops_total energy_estimate_nJ signal_ms exit_accuracy exit_ms",
        accuracy_test="at the untrained condition (%)",
        accuracy_seen="at trained conditions (%)",
        exit_accuracy="with early exit (%)",
        exit_ms="with early exit (ms)",
    ),
    cost="energy_estimate_nJ",
    score="accuracy_test",
    note="Means over the values of a condition, each tested once for each seed, and over seeds. At trained conditions: "
    "on training trials that are kept for this test. Without a condition, test trials are drawn at random. A remedy "
    "that changes nothing of a set has no row there. Only networks have SOPs. The verdicts compare the network and its "
    f"opponents under {DEFAULT}. Sets whose recordings are not available are left out; the column `skipped` of "
    "results.csv gives the reason.",
    apart=("tested",),
    spiking=("classifier", (NETWORK,)),
    splits=("split",),
)

load = touch_sets.load
named = remedy_answers.named
cautions = remedy_answers.cautions
tables = remedy_answers.tables
draw = remedy_answers.draw


def run(parameters: Parameters, arrays: Arrays) -> list[dict[str, Any]]:
    """A row for the network and for each opponent; none if the remedy changes nothing of this set.

    Under `Remedy.trained`, these rows for each half of the tested trials.
    """
    tested = _tested(parameters)
    if SKIPPED in arrays:
        return [{"tested": tested, "classifier": "", "input": "", **skipped_row(arrays, VIEW.measures)}]
    recordings = from_arrays(arrays, parameters.data.set)
    assert isinstance(recordings, Recordings)
    if parameters.condition:
        recordings = _halved(recordings, parameters)
    rows: list[dict[str, Any]] = []
    for cell in _saved_cells(parameters, recordings):
        prepared = _prepared(recordings, cell, parameters)
        trials = {"test_trials": len(tasks.trials_of(prepared.trains, prepared.task).test)}
        opponents_rows = [*_of_opponents(prepared)]
        validated = {key: opponents_rows[0][key] for key in ("n_validation", "validation_trials")}
        rows += [{**row, **trials} for row in ({**_of_network(prepared), **validated}, *opponents_rows)]
    # Seeds of a value test the same trials; without a condition, each draws its own.
    head = {"tested": tested, "split": str(parameters.value) if parameters.condition else f"seed {parameters.seed}"}
    return [{**head, **_told(row, parameters), SKIPPED: ""} for row in rows]


def _tested(parameters: Parameters) -> str:
    """What the rows of a cell are compared within."""
    by = f" by {quantity(parameters.condition)[0]}" if parameters.condition else ""
    return f"{parameters.data.set}{by}"


def _told(row: Mapping[str, Any], parameters: Parameters) -> dict[str, Any]:
    """A row without a validation accuracy that cannot be compared with that of other remedies.

    Validation trials are varied as training trials are if a remedy names time and gain, and recorded ones otherwise.
    `accuracy_validation` is that of the default alone, by which the report chooses; `validated` that of any remedy.
    """
    validated = row["accuracy_validation"]
    return {**row, "validated": validated, "accuracy_validation": validated if parameters.remedy == DEFAULT else np.nan}


def _saved_cells(parameters: Parameters, recordings: Recordings) -> list[Cell]:
    with scratch() as folder:
        hdf5.save_recordings(recordings, folder / "touches.h5")
        return cells(parameters, folder / "touches.h5")


def cells(parameters: Parameters, path: Path) -> list[Cell]:
    """The cells of `own-recordings` under a remedy: one, or one for each half under `Remedy.trained`.

    path: of the recordings, with the column `HALF` if the remedy needs it. Empty if the remedy changes nothing of them.
    """
    remedy, tested = parameters.chosen, {parameters.condition: parameters.value} if parameters.condition else {}
    if remedy.trained:
        return [_cell(parameters, remedy, path, {**tested, HALF: half}) for half in (0, 1) if tested]
    cell = _cell(parameters, remedy, path, tested)
    if parameters.remedy == NOTHING or (remedy.between and tested):
        return [cell]
    plain = _cell(parameters, parameters.remedies[NOTHING], path, tested)
    return [] if cell == plain else [cell]


def _cell(parameters: Parameters, remedy: Remedy, path: Path, tested: Mapping[str, Any]) -> Cell:
    """The only cell of `own-recordings` on these recordings, with one size and one pair of refractory periods."""
    given = spec.leaves({**parameters.keys, **parameters.data.chosen.keys})
    if not remedy.from_contact:  # where it would start without a test on other conditions
        fixed, _ = automatic.window(automatic.look(path, CLOCK_HZ).timing, given)
        given = {"window.start_ms": fixed.get("start_ms", 0.0), **given}
    split: dict[str, Any] = {"seed": parameters.seed}
    if tested:
        split |= {"test_where": tested, "nested": not remedy.trained}
    keys = {
        PERIODS: [parameters.t_ref_ms],
        "network.hidden": HIDDEN,
        "past_windows": False,
        "seed": parameters.seed,
        **{f"split.{key}": value for key, value in split.items()},
        **given,
        **remedy.keys(),
    }
    (cell,) = study.cells(study.resolve("own-recordings", keys, data=path))
    return cell


class Prepared(NamedTuple):
    """The spikes of a cell's trials and of their varied copies, and the task on them."""

    cell: Cell
    recordings: Recordings
    trains: SpikeTrains
    task: Task


def _prepared(recordings: Recordings, cell: Cell, parameters: Parameters) -> Prepared:
    recordings = preparation.encoded_part(recordings, cell)
    encoder = preparation.encoder_of(cell, recordings, {}, between=parameters.chosen.between, tell=False)
    trains = preparation.spikes_of(cell, recordings, encoder)
    task = task_of(cell).model_copy(update={"seen": model_selection.SEEN if parameters.condition else 0.0})
    return Prepared(cell, recordings, trains, task)


def _of_network(prepared: Prepared) -> dict[str, Any]:
    """The row of the network, trained with the kind of varied copies that is best on validation trials."""
    cell, trains = prepared.cell, prepared.trains
    assert cell.network is not None
    best = robustly(cell, trains, cell.network, prepared.task).last
    measured = measuring.measure(best.fitted, best.sides, trains.populations)["row"]
    row = {**measured, **best.validated, "hidden": best.fitted.network.spec.hidden}
    how = {"afferents": ledger.Afferents.of(trains), "n_classes": len(trains.classes)}
    spent, early = (ledger.row_cost(cell.network, row, **how, early=early) for early in (False, True))
    return {
        "classifier": NETWORK,
        "input": opponents.SPIKES,
        "copies": best.task.augmentation,
        "accuracy_test": row["accuracy_test"],
        "accuracy_seen": best.seen,
        "accuracy_validation": row["accuracy_validation"],
        "sops_total": row["sops_total"],
        "energy_estimate_nJ": spent.energy_estimate_nJ,
        "signal_ms": spent.signal_ms,
        "ranked": bool(turns_of(trains.conditions, cell.split)),
        "exit_accuracy": row["exit_accuracy"],
        "exit_sops_total": row["exit_sops_total"],
        "exit_nJ": early.energy_estimate_nJ,
        "exit_ms": early.signal_ms,
        "n_train": len(best.sides.train.labels),
        "n_test": len(best.sides.test.labels),
    }


def _of_opponents(prepared: Prepared) -> Iterator[dict[str, Any]]:
    """A row for each opponent, with the same windows, trials and copies."""
    cell, again = prepared.cell, tasks.with_every_condition(prepared.trains, prepared.task)
    used = [tasks.trials_of(prepared.trains, task) for task in (prepared.task, again) if task is not None]
    trains = tables_beside.with_used_copies(prepared.trains, cell, *used)
    prepared = prepared._replace(trains=trains)
    every = trains.with_variations(cell.window)
    windows = every.cut(cell.window)

    def cuts_of(task: Task) -> tuple[Cuts, Split, np.ndarray]:
        """The cuts, the sides, and the trials that are kept for a test at the conditions of training."""
        split, seen = tasks.trials_of(trains, task), tasks.seen_trials(trains, task)
        tested = split._replace(test=np.union1d(split.test, seen))
        cuts = opponents.cuts_of(every.conditions, windows, trains.sampling_rate_Hz, tested, {})
        return tables_beside.with_training(cuts, trains, cell, tested), split, seen

    cuts, split, kept_trials = cuts_of(prepared.task)
    if again is not None:
        last, split, kept_trials = cuts_of(again)
        cuts = cuts._replace(last=last)
    labels = class_indices(every.conditions)[windows.trial]
    n_test = int(np.isin(windows.trial, split.test).sum())
    for row in opponents.rows(_inputs(prepared, every, cuts), labels, cuts):
        shares = row[opponents.RIGHT]["test"]
        unseen, seen = (_accuracy(shares, trials, windows.trial) for trials in (split.test, kept_trials))
        kept = ("classifier", "input", "accuracy_validation", "energy_estimate_nJ", "signal_ms", "n_train")
        _, _, copies = row["settings"].partition("varied copies: ")
        own = {"copies": copies or NONE, "accuracy_test": unseen, "accuracy_seen": seen, "n_test": n_test}
        own |= {"n_validation": row["n_validation"], "validation_trials": len(row[opponents.RIGHT]["validation"])}
        yield {**{key: row[key] for key in kept}, **own}


def _inputs(prepared: Prepared, every: SpikeTrains, cuts: Cuts) -> Iterator[Input]:
    """Moments and time bins of the signals, the signals, and time bins of the spikes, each for some classifiers."""
    cell, trains, recordings = prepared.cell, prepared.trains, prepared.recordings
    pieces = tables_beside.pieces_with_copies(recordings, cuts.windows, trains, cell) if trains.variations else ()
    on_features = {name: one for name, one in joined("features", "quick").items() if name != "ELM"}
    for one in opponents.signal_inputs(recordings, cuts, "quick", pieces):
        yield one if one.features.ndim == 3 else one._replace(opponents=on_features)
    first_ms, second_ms = t_ref_pair_ms(cell.encoder)
    *_, binned = opponents.spike_inputs(every, (second_ms, first_ms), cuts)
    yield binned._replace(opponents=on_features)


def _accuracy(shares: Mapping[int, float], trials: np.ndarray, trial_of: np.ndarray) -> float:
    """The accuracy on the windows of some trials; NaN without trials.

    shares: of each trial, the share of its windows that is classified correctly. trial_of: the trial of each window.
    """
    weights = [int((trial_of == trial).sum()) for trial in trials]
    return float(np.average([shares[trial] for trial in trials.tolist()], weights=weights)) if len(trials) else np.nan


def _halved(recordings: Recordings, parameters: Parameters) -> Recordings:
    """The recordings with the column `HALF`: of each class at each value, half of the trials, copies together."""
    conditions = recordings.conditions
    order = np.random.default_rng(parameters.seed).permutation(len(conditions))
    rank = conditions.iloc[order].groupby([LABEL, parameters.condition]).cumcount().sort_index().to_numpy()
    halves = (rank % 2)[copies_of(recordings).first]
    return replace(recordings, conditions=conditions.assign(**{HALF: halves}))


def own(path: Path, given: Mapping[str, Any]) -> Own:
    """The study of a file in place of its sets; see `neurotact/studies/way.py`.

    The condition and its values are those of `leave_out_each`. Keys that begin with `window.`, the choice of trials
    (`where`, `leave_out`) and the number of seeds (`repeats`) apply to the file. Raises InputError without a condition,
    for another choice of test trials, and where `own-recordings` cannot use the file.
    """
    conditions = {key.removeprefix(TESTED): values for key, values in given.items() if key.startswith(TESTED)}
    choice = choice_of(given)
    touches = chosen_trials(hdf5.load_recordings(path), choice, str(path), tell=False)
    if len(conditions) != 1 or JOIN in next(iter(conditions)):
        names = [str(name) for name in touches.conditions if name != LABEL]
        raise InputError(
            f"`leave_out_each`: name the condition of which each value is tested, a single one; {path} has "
            f"{some(names) or 'none'}"
        )
    ((condition, values),) = conditions.items()
    of_set = {key: value for key, value in given.items() if key.startswith(automatic.WINDOW)}
    others = {
        key: value for key, value in given.items() if key not in {*of_set, *automatic.CHOICE, f"{TESTED}{condition}"}
    }
    wrong = [key for key in others if key.removeprefix("sweep.").startswith("split") and key != SPLITS]
    if wrong:
        raise InputError(f"{wrong[0]}: this study tests one value of a condition after the other; leave it out")
    seeds = others.pop(SPLITS, None) or ([others.pop("seed")] if "seed" in others else others.pop(automatic.SEED, AUTO))
    notes = [] if (note := automatic.note_of(choice)) is None else [note]
    if seeds == AUTO:
        seeds, note = automatic.seeds(len(touches))
        notes.append(note)
    for value in values:
        split_conditions(touches.conditions, (), SplitSpec(test_where={condition: value}), copies_of(touches).first)
    keys = {**of_set, **loading.choice_changes(**choice._asdict()), "split.test_where": {condition: values[0]}}
    resolved = study.resolve("own-recordings", keys, data=path)
    steps = np.round(automatic.look(path, CLOCK_HZ, choice).timing.durations_s * CLOCK_HZ).astype(np.int64)
    check_fit(steps, CLOCK_HZ, resolved.window)
    file = {"file": str(path), "content": content_digest(touches), **choice._asdict()}
    table = {"parts": {"file": file}, "keys": spec.override({}, of_set)}
    changes = {TASKS: [["recordings", condition, value] for value in values], automatic.SEED: seeds}
    return Own({**changes, "data.sets": {"recordings": table}, **others}, tuple(notes))
