"""Studies: run, go on with, report."""

import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from neurotact import files, spec, tables
from neurotact.api.arguments import Columns, Conditions, LeftOut, Settings, columns_of
from neurotact.data import hdf5
from neurotact.data.splits import check_one_way, each_left_out
from neurotact.data.trial_choice import TrialChoice, chosen_trials
from neurotact.data.windows import check_not_seconds
from neurotact.errors import InputError
from neurotact.report import report
from neurotact.report.page import ANSWER, PAGE
from neurotact.studies import loading, runner, store
from neurotact.studies.sweeps import JOIN

log = logging.getLogger("neurotact")


def run_study(
    name: str | Path,
    folder: str | Path,
    settings: Settings | None = None,
    *,
    quick: bool = False,
    data: str | Path | None = None,
    length_ms: float | None = None,
    where: Conditions | None = None,
    leave_out: LeftOut = None,
    test_where: Conditions | None = None,
    group: str | Sequence[str] = (),
    order: str | None = None,
    folds: int | None = None,
    leave_out_each: Columns | None = None,
    repeats: int | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
) -> pd.DataFrame:
    """Run a study, shipped or your own, in `folder`; its results, one row per trained network.

    settings: changes of the study, dotted keys that name the part first: `{"network.hidden": 40}`.
    quick: a smaller sweep of the same kind.
    data: a file of recordings of your own, for a study that takes one: `run_study("own-recordings", "mine",
        data="touches.h5")`, or "ways-to-save".
    length_ms: of the windows. where, leave_out: the trials that are used, as of `read`. test_where, group, order: how
        they are divided, as for `train`. folds, leave_out_each, repeats: every network is trained for each fold, for
        each value of a condition of `data`, such as "speed", or each pair of values of two, such as `["speed",
        "force_N"]`, which is tested and never trained on, or for this many random splits; results are means over them.
        Beside leave_out_each, test_where says which of these values are tested.
    workers: processes on this machine, 2 if None. scheduler: address of a Dask scheduler, in their place.
    The folder holds all tables, the figures and `report.html`; what was done before is not done again.
    Raises InputError for an unknown study or key, and for a folder with another study.

    >>> results = nt.run_study("own-recordings", "mine", data="touches.h5", quick=True)  # doctest: +SKIP
    >>> nt.study_answer("mine")["answers"][0]["headline"]  # doctest: +SKIP
    'A refractory period of 5 ms saves 31 % of the operations; accuracy stays within the interval.'
    """
    check_not_seconds(length_ms)
    changes = {**spec.checked_settings(settings), **({} if length_ms is None else {"window.length_ms": length_ms})}
    columns = columns_of(leave_out_each)
    changes |= _split_changes(None if columns else test_where, group, order, folds, repeats)
    check_one_way(columns, order=order, folds=folds)
    choice = TrialChoice.of(where, leave_out)
    changes |= loading.choice_changes(**choice._asdict())
    if columns:
        changes |= _left_out_changes(columns, test_where, data, choice)
    study = loading.resolve(name, changes, quick=quick, data=data)
    for note in getattr(study, "notes", ()):
        log.warning("%s", note)
    return _run(study, Path(folder), workers, scheduler)


def resume_study(folder: str | Path, *, workers: int | None = None, scheduler: str | None = None) -> pd.DataFrame:
    """Go on with the study in `folder`, as `neurotact study resume` does; arguments and results as of `run_study`.

    >>> results = nt.resume_study("mine", workers=4)  # doctest: +SKIP
    """
    return _run(runner.load(Path(folder)), Path(folder), workers, scheduler)


def report_study(folder: str | Path) -> pd.DataFrame:
    """Write the tables, figures and `report.html` of a study from what is done; its results.

    >>> results = nt.report_study("mine")  # doctest: +SKIP
    """
    runner.write_tables(Path(folder))
    return _reported(Path(folder))


def study_answer(folder: str | Path) -> dict[str, Any]:
    """What the study in `folder` answers, as `neurotact study` prints it as JSON.

    Keys: answers (each with dataset, headline and details; of networks also short, the verdict alone, figures, the
    large ones of the page, and chosen, which network they are of), among (which encoder, if the study sweeps them),
    cautions, tables (each with caption, columns and rows; not of every study), and report, the path of the page.

    >>> nt.study_answer("no-study-yet")["answers"]
    []
    """
    path = Path(folder) / ANSWER
    answer = files.read_json(path) if path.is_file() else {"answers": [], "cautions": []}
    return answer | {"report": str(Path(folder) / PAGE)}


def is_begun(folder: str | Path) -> bool:
    """Whether a study in `folder` was begun, so that `resume_study` can go on with it."""
    return (Path(folder) / runner.STUDY).is_file()


def _run(study: loading.Study, folder: Path, workers: int | None, scheduler: str | None) -> pd.DataFrame:
    runner.run(study, folder, workers, scheduler)
    return _reported(folder)


def _reported(folder: Path) -> pd.DataFrame:
    """Write the figures and the page from the tables of a study; its results."""
    with store.timed(folder, "report", again=False):
        report.write(folder)
    runner.add_report_time(folder)
    return tables.read_table(folder / "results.csv")


def _left_out_changes(
    columns: Sequence[str], test_where: Conditions | None, data: str | Path | None, choice: TrialChoice
) -> dict[str, Any]:
    """Changes of a study that test each value of a condition of its file in turn, or of several each combination."""
    if data is None:
        raise InputError("`leave_out_each`: needs `data`, a file of recordings with this condition; give it")
    touches = chosen_trials(hdf5.load(data), choice, str(data), tell=False)
    tests = each_left_out(touches.conditions, columns, test_where)
    axis = f"sweep.{JOIN.join(f'split.test_where.{column}' for column in columns)}"
    if len(columns) == 1:
        return {axis: [test[columns[0]] for test in tests]}
    return {axis: [[*test.values()] for test in tests], "split.leave_aside": True}


def _split_changes(
    test_where: Conditions | None,
    group: str | Sequence[str],
    order: str | None,
    folds: int | None,
    repeats: int | None,
) -> dict[str, Any]:
    """Changes of a study for its split; what is not given keeps the study's value.

    >>> _split_changes({"speed": 450}, ["subject"], None, 3, None)["sweep.split.fold"]
    [0, 1, 2]
    """
    given = {"split.test_where": test_where, "split.group": group, "split.order": order, "split.folds": folds}
    given |= {"sweep.split.fold": folds and [*range(folds)], "sweep.split.seed": repeats and [*range(repeats)]}
    return {key: value for key, value in given.items() if value}
