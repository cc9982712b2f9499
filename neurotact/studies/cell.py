"""One cell of a study: train a network on spike trains, then measure the cost of its decisions."""

from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from time import perf_counter
from typing import Any, NamedTuple

from neurotact import plugins
from neurotact.data.copies import copies_of
from neurotact.data.spikes import SpikeTrains
from neurotact.files import scratch, whole, without_nan, write_json
from neurotact.metrics import paired
from neurotact.networks.definition import recipe
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.networks.training import model_selection, run_folder, tasks, trainer
from neurotact.networks.training.epochs import Epoch
from neurotact.networks.training.linear import INVERSE_PENALTIES
from neurotact.networks.training.model_selection import RuledOut, Tried
from neurotact.networks.training.tasks import Task
from neurotact.networks.use import measuring
from neurotact.networks.use.measuring import by_condition
from neurotact.progress import at, say
from neurotact.studies import encoding_tables, measures
from neurotact.studies.engine import Files
from neurotact.studies.store import RESULT, TIMING, cell_folder
from neurotact.studies.study import Cell
from neurotact.tables import LAYERS

TOLD_S, JUDGED_S, LONG_MIN = 1.0, 20.0, 5.0
"""Seconds after which a training says how far it is and its time is estimated; minutes from which on a line is printed.
"""
RIGHT_SEEN = "right_seen"
"""Of a result: the share of correct windows of each trial that tests the conditions of training."""
TARGET = ("target", "false_alarms_per_h")
"""Of the source of a cell in a study with a target: what its network learns."""
SEARCH = "search"
"""The folder of a cell's search."""


class Searched(NamedTuple):
    """The best network of a cell's search, its columns of results.csv, and the files of the search."""

    fitted: trainer.Trained
    sides: tasks.Sides
    row: dict[str, Any]
    files: Files


def run_cell(cell: Cell, trains: SpikeTrains, kept: Path | None = None, tells: bool = False) -> Files:
    """Train and measure a cell.

    It may run on any machine: it reads and writes only what is passed.

    kept: the folder with the journal of the cell's search, from which an interrupted search resumes; without it, or
    without a search, no journal is read or saved. tells: say how long the training of a network takes, if it takes
    minutes.
    """
    assert cell.network is not None
    began = perf_counter()
    task = task_of(cell)
    if cell.search is None:
        spec = cell.network
        progress = LongTraining(lambda: recipe.resolve(spec, tasks.seen(trains, task)), tells)
        if not _trains_once(cell):
            return _robust(cell, trains, spec, progress, tells)
        fitted, sides = trainer.fit(trains, spec, task, cell.seeds, progress=progress)
        return _files_of(cell, trains, fitted, sides, perf_counter() - began)
    with scratch() as empty:
        searched = plugins.load_function("tools", "search_cell")(cell, trains, task, kept or empty)
    last = model_selection.again(trains, Tried(task, searched.fitted, searched.sides), cell.seeds)
    return _files_of(cell, trains, last.fitted, last.sides, perf_counter() - began, searched, last)


def _trains_once(cell: Cell) -> bool:
    """Whether a cell has one training: it neither searches nor chooses, and trains on each condition but the tested."""
    chooses = cell.search is not None or cell.augmentation is not None or cell.split.validates_elsewhere
    return cell.network is not None and not chooses


def _robust(cell: Cell, trains: SpikeTrains, spec: RSNNSpec, progress: Any, tells: bool) -> Files:
    """The files of a cell whose varied copies are chosen on validation trials, and which is trained again."""
    began = perf_counter()
    tried, best, last, out = robustly(cell, trains, spec, task_of(cell), progress)
    every = tried if last is best else [*tried, last]
    rows = [one.row() | {"chosen": one is best, "last": one is last} for one in every]
    rows += [one.row() for one in out]
    for one in out if tells else ():
        say(str(one))
    remedies = rows if cell.augmentation is not None else ()
    return _files_of(cell, trains, last.fitted, last.sides, perf_counter() - began, last=last, remedies=remedies)


class Robust(NamedTuple):
    """The training with each kind of varied copies, the best on validation trials, and the last, on what these had.

    out: the kinds that were not trained to the end.
    """

    tried: list[Tried]
    best: Tried
    last: Tried
    out: list[RuledOut]


def robustly(cell: Cell, trains: SpikeTrains, spec: RSNNSpec, task: Task, progress: Any = None) -> Robust:
    """Choose among the kinds of varied copies, and train once more."""
    kinds = model_selection.candidates(cell.augmentation, trains.conditions, cell.split)
    given = trains, spec, task, cell.seeds
    begun, out = model_selection.rule_out(*given, kinds, progress)
    left = [kind for kind in kinds if kind not in {one.kind for one in out}]
    tried = [*model_selection.trainings(*given, left, progress, begun)]
    best = model_selection.best_of(tried)
    return Robust(tried, best, model_selection.again(trains, best, cell.seeds, progress), out)


class LongTraining:
    """Called after each epoch; says how far the training is and once, if it takes minutes, what takes less.

    network: gives the network, with the choices of its recipe. says: whether it is said that minutes pass.
    """

    def __init__(self, network: Callable[[], RSNNSpec], says: bool = True) -> None:
        self._network = cache(network)
        self._says = says
        self._began: float | None = None
        self._n_epochs = 0
        self._is_judged = False

    def __call__(self, epoch: Epoch) -> None:
        if self._began is None:
            self._began = perf_counter()
            return
        self._n_epochs += 1
        seconds = perf_counter() - self._began
        if seconds < TOLD_S:  # the choices of a recipe take some milliseconds
            return
        spec = self._network()
        is_trained = spec.own is not None or spec.hidden > 0
        n, epochs = spec.n_trainings, spec.training.epochs if is_trained else len(INVERSE_PENALTIES)
        most = n * epochs
        at("train", self._n_epochs, most, f", loss {epoch.train_loss:.3g}, validation {epoch.validation_accuracy:.0%}")
        if self._is_judged or not self._says or seconds < JUDGED_S:
            return
        self._is_judged = True
        minutes = seconds / self._n_epochs * most / 60
        if minutes > LONG_MIN and is_trained:
            members = f" of {n} trainings" if n > 1 else ""
            say(
                f"a network takes up to {minutes:.0f} min ({most} epochs{members}); fewer taxels, shorter windows "
                "(window.length_ms) or fewer epochs "
                f"(`settings={{'network.training.epochs': {max(1, epochs // 4)}}}`) take less"
            )


def _files_of(
    cell: Cell,
    trains: SpikeTrains,
    fitted: trainer.Trained,
    sides: tasks.Sides,
    seconds: float,
    searched: Searched | None = None,
    last: Tried | None = None,
    remedies: Sequence[dict[str, Any]] = (),
) -> Files:
    """The files of a cell after its network is trained; seconds: the time of the training.

    last: the training, if it was on another task than that of the cell. remedies: a row for each training with varied
    copies.
    """
    began, task = perf_counter() - seconds, task_of(cell) if last is None else last.task
    result = measuring.measure(fitted, sides, trains.populations) | _tables(cell, fitted, sides, trains, task)
    if remedies:
        result["tables"] = {**result.get("tables", {}), "remedies": [*remedies]}
        result[RIGHT_SEEN] = model_selection.right_seen(fitted.network, trains, task)
    trial = copies_of(trains).first[trains.cut(task.window, tasks.trials_of(trains, task).test).trial]
    for decided in ("right", "exit_right"):
        result[decided] = paired.by_trial(trial, result[decided])
    if task.target:
        result = plugins.load_function("tools", "measured_target")(result, fitted, sides, trains, task)
    result["row"] = {
        "dataset": cell.dataset,
        **encoding_tables.periods(cell),
        "hidden": fitted.network.spec.n_hidden,
        **({LAYERS: layers} if (layers := fitted.network.spec.layers) else {}),
        "seed": cell.seed,
        **result["row"],
        "sops_validation": measuring.mean_sops(fitted.network, sides.validation),
        **{key: row[key] for row in remedies if row["last"] for key in ("augmentation", "accuracy_seen")},
        **(searched.row if searched else {}),
        **(last.validated if last else {}),
    }
    with scratch() as run:  # the layout of the run folder: paths between its files are the same
        target = cell_folder(run, cell)
        windows = sides.train.spikes if len(sides.train.spikes) else None
        run_folder.save(fitted, target, trains, run / cell.given, task, windows=windows)
        write_json(target / TIMING, {"seconds": perf_counter() - began, "epochs": len(fitted.training.epochs)})
        for name, content in (searched.files if searched else {}).items():
            with whole(target / name) as draft:
                draft.write_bytes(content)
        write_json(target / RESULT, without_nan(result))
        return {path.relative_to(target).as_posix(): path.read_bytes() for path in target.rglob("*") if path.is_file()}


def task_of(cell: Cell) -> Task:
    """The task on which the cell's network is trained and tested."""
    return Task(
        window=cell.window,
        split=cell.split,
        stratify=tuple(cell.source["stratify"]),
        subset=cell.subset,
        balance=cell.balance,
        training_windows=cell.training_windows,
        exit_tolerance=cell.early_exit.tolerance,
        exit_choice=cell.early_exit.choice,
        seen=model_selection.SEEN if cell.augmentation is not None else 0.0,
        **{key: cell.source[key] for key in TARGET if key in cell.source},
    )


def _tables(cell: Cell, fitted: trainer.Trained, sides: tasks.Sides, trains: SpikeTrains, task: Task) -> dict[str, Any]:
    """`tables`: the rows of each table that the study requests besides results.csv; empty if it requests none."""
    tables = {}
    for name, measure in measures.requested(cell.measures).items():
        if measure.of_network is not None:
            value = measures.value_of(name, cell.measures)
            tables[measure.table] = measure.of_network(fitted.network, sides, value)
    if cell.test_every_condition:
        tables["conditions"] = by_condition(fitted.network, trains, task)
    return {"tables": tables} if tables else {}
