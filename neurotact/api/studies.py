"""Studies: run, go on with, report."""

import logging
from pathlib import Path
from typing import Any

from neurotact import files, progress, spec, tables
from neurotact import workers as processes
from neurotact.api.arguments import Conditions, LeftOut, Settings
from neurotact.data import hdf5
from neurotact.data.dataset import expand
from neurotact.data.splits import Splits, SplitSpec, each_left_out
from neurotact.data.trial_choice import TrialChoice, chosen_trials
from neurotact.data.windows import WindowSpec
from neurotact.errors import InputError
from neurotact.lazily import lazily
from neurotact.networks.definition.learned import LearnSpec
from neurotact.spec import takes_specs
from neurotact.studies.sweeps import JOIN

with lazily():
    import pandas as pd

    from neurotact.report import report, running
    from neurotact.studies import executors, loading, runner, store


log = logging.getLogger("neurotact")


@takes_specs
def run_study(
    name: str | Path,
    folder: str | Path,
    settings: Settings | None = None,
    *,
    quick: bool = False,
    data: str | Path | None = None,
    window: WindowSpec = WindowSpec(),
    where: Conditions | None = None,
    leave_out: LeftOut = None,
    split: Splits = Splits(),
    learn: LearnSpec = LearnSpec(),
    workers: int | None = None,
    scheduler: str | None = None,
) -> "pd.DataFrame":
    """Run a study, shipped or your own, in `folder`; its results, one row per trained network.

    settings: changes of the study, dotted keys that name the part first: `{"network.hidden": 40}`.
    quick: a smaller sweep of the same kind.
    data: a file of recordings of your own, for a study that takes one: `run_study("own-recordings", "mine",
        data="touches.h5")`, or "ways-to-save".
    window, split: as for `train`; what is not given is as in the study. Where the split has turns, such as folds, every
        network is trained for each, and results are means over them. Values of `leave_out_each` are those of `data`.
    where, leave_out: the trials that are used, as of `read`.
    learn: as for `train`: with `nt.Learn(target="force_N")` networks and their rivals tell numbers, with "events" they
        detect them.
    workers: processes on this machine, 2 if None. scheduler: address of a Dask scheduler, in their place.
    The folder holds all tables, the figures and `report.html`; what was done before is not done again.
    Raises InputError for an unknown study or key, and for a folder with another study.

    >>> results = nt.run_study("own-recordings", "mine", data="touches.h5", quick=True)  # doctest: +SKIP
    >>> nt.study_answer("mine")["answers"][0]["headline"]  # doctest: +SKIP
    'A refractory period of 5 ms saves 31 % of the operations; accuracy stays within the interval.'
    """
    choice = TrialChoice.of(where, leave_out)
    windows = {f"window.{key}": value for key, value in window.given().items()}
    changes = {**spec.checked_settings(settings), **windows, **loading.choice_changes(**choice._asdict())}
    changes |= (
        _learned_changes(learn)
        | _split_changes(split)
        | (_left_out_changes(split, data, choice) if split.leave_out_each else {})
    )
    with processes.beginning(executors.modules()):
        study = loading.resolve(name, changes, quick=quick, data=data)
    for note in getattr(study, "notes", ()):
        log.warning("%s", note)
    return _run(study, Path(folder), workers, scheduler)


def resume_study(folder: str | Path, *, workers: int | None = None, scheduler: str | None = None) -> "pd.DataFrame":
    """Go on with the study in `folder`, as `neurotact study resume` does; arguments and results as of `run_study`.

    >>> results = nt.resume_study("mine", workers=4)  # doctest: +SKIP
    """
    return _run(runner.load(Path(folder)), Path(folder), workers, scheduler)


def report_study(folder: str | Path) -> "pd.DataFrame":
    """Write the tables, figures and `report.html` of a study from what is done; its results.

    >>> results = nt.report_study("mine")  # doctest: +SKIP
    """
    runner.write_tables(Path(folder))
    return _reported(Path(folder))


def study_answer(folder: str | Path) -> dict[str, Any]:
    """What the study in `folder` answers, as `neurotact study` prints it as JSON.

    Keys: answers (each with dataset, headline and details, and, unless the way has sentences of its own, kind, short,
    the verdict alone, figures, the large ones of the page, and chosen and folder, which network they are of and where),
    among (which encoder, if the study sweeps them), cautions, tables (each with caption, columns and rows; not of every
    study), and report, the path of the page. Answers of numbers or events also have network and rival, their errors or
    events and costs by plain names, and p.

    >>> nt.study_answer("no-study-yet")["answers"]
    []
    """
    path = Path(folder) / store.ANSWER
    answer = files.read_json(path) if path.is_file() else {"answers": [], "cautions": []}
    places = {store.STUDY: str(Path(folder).absolute())}
    for then in [one["next"] for one in answer["answers"] if one.get("next", {}).get("commands")]:
        if store.RECORDINGS not in places and any(store.RECORDINGS in command for command in then["commands"]):
            file = str(spec.read(Path(folder) / runner.STUDY)["dataset"].get("file"))
            places |= {store.RECORDINGS: str(expand(file).absolute())}
        then["commands"] = [store.moved(command, places) for command in then["commands"]]
    return answer | {"report": str(Path(folder) / store.PAGE)}


def is_begun(folder: str | Path) -> bool:
    """Whether a study in `folder` was begun, so that `resume_study` can go on with it."""
    return (Path(folder) / runner.STUDY).is_file()


def _run(study: "loading.Study", folder: Path, workers: int | None, scheduler: str | None) -> "pd.DataFrame":
    with progress.watched(running.writer(study.title, folder)):
        runner.run(study, folder, workers, scheduler)
    return _reported(folder)


def _reported(folder: Path) -> "pd.DataFrame":
    """Write the figures and the page from the tables of a study; its results."""
    with store.timed(folder, "report", again=False), progress.track("report", 1) as advance:
        processes.in_a_process(_write_report, folder)  # so that this one needs no torch
        advance(1, "")
    runner.add_report_time(folder)
    return tables.read_table(folder / "results.csv")


def _write_report(folder: Path) -> None:
    report.write(folder)


def _left_out_changes(split: Splits, data: str | Path | None, choice: TrialChoice) -> dict[str, Any]:
    """Changes of a study that test each value of a condition of its file in turn, or of several each combination."""
    if data is None:
        raise InputError("`leave_out_each`: needs `data`, a file of recordings with this condition; give it")
    touches = chosen_trials(hdf5.load(data), choice, str(data), tell=False)
    columns = split.leave_out_each
    tests = each_left_out(touches.conditions, columns, split.test_where)
    axis = f"sweep.{JOIN.join(f'split.test_where.{column}' for column in columns)}"
    if len(columns) == 1:
        return {axis: [test[columns[0]] for test in tests]}
    return {axis: [[*test.values()] for test in tests], "split.leave_aside": True}


def _learned_changes(learn: LearnSpec) -> dict[str, Any]:
    """Changes of a study for what its networks learn.

    >>> _learned_changes(LearnSpec(target="force_N"))
    {'way': 'targets', 'parameters': {'target': ['force_N']}}
    """
    if learn.refuse is not None:
        raise InputError("`refuse`: a study refuses no touches; train the chosen network with it")
    parameters = learn.model_dump(mode="json", include={"target", "false_alarms_per_h"}, exclude_none=True)
    balance = {} if learn.balance == "none" else {"balance": learn.balance}
    return balance | ({"way": "targets", "parameters": parameters} if learn.target else {})


def _split_changes(split: Splits) -> dict[str, Any]:
    """Changes of a study for its split and its turns; what is not given keeps the study's value.

    >>> _split_changes(Splits(group="subject", stratify="force_N", repeats=2))
    {'split.group': ('subject',), 'dataset.stratify': ('force_N',), 'sweep.split.seed': [0, 1]}
    """
    there = SplitSpec.model_fields.keys() - ({"test_where"} if split.leave_out_each else set())
    changes: dict[str, Any] = {f"split.{key}": value for key, value in split.given().items() if key in there}
    changes |= {"dataset.stratify": split.stratify} if split.stratify else {}
    changes |= {"sweep.split.fold": [*range(split.folds)]} if split.folds and split.every_fold else {}
    if split.repeats > 1:
        changes["sweep.split.seed"] = [*range(split.seed, split.seed + split.repeats)]
    return changes
