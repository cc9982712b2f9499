"""The page of a study with a target, its figures, and its answer for programs."""

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pandas as pd
from neurotact_parts.streams import detector
from neurotact_parts.studies.targets import figures
from neurotact_parts.studies.targets.engine import cells, parameters_of
from neurotact_parts.studies.targets.ways import EVENTS, Compared, Way, networks_of, rivals_of
from neurotact_parts.studies.targets.words import screen

from neurotact.baselines import opponents
from neurotact.data.conditioning import acausal_note
from neurotact.figures.columns import name_of
from neurotact.files import write_json
from neurotact.networks.definition import recipe
from neurotact.networks.training import cautions, tasks
from neurotact.networks.training.run_folder import LOG
from neurotact.report import front, page, period_choice, ways
from neurotact.report.answer import Answer
from neurotact.report.tables import afferents_of, first_spikes, tables_beside, with_pair, with_setting
from neurotact.report.way_answer import Configuration
from neurotact.report.wording import Measure
from neurotact.studies.cell import task_of
from neurotact.studies.store import ANSWER, cell_folder, is_done, result_of
from neurotact.studies.study import Cell, StudySpec, has_one_split
from neurotact.studies.way import View
from neurotact.tables import read_table, write_table

BY = ("kind", "source")
COSTS = {"nJ": "energy estimate (nJ)", "sops": "SOPs", "spikes": "input spikes"}
OF_EVENTS = {
    "hit_share": "events found (%)", "false_alarms_per_h": "false alarms an hour", "delay_ms": "delay (ms)",
}  # fmt: skip
DOWNLOADS = {
    "answer.json": "the first screen of this report for programs",
    "results.csv": "one row per trained network",
    "ways.csv": "each network and each rival, over its splits and seeds",
    "told.csv": "what each network told of each test window, beside the truth",
    "events.csv": "each mark and each detection in test recordings",
    "operating_curve.csv": "hits, false alarms and delay for each threshold",
    "encoding.csv": "firing of both populations in each condition",
    "baselines.csv": "rivals on the same windows",
    "baselines_trials.csv": "their score in each validation and test trial",
    "timings.csv": "time that each part of the study and each cell took",
    "study.toml": "the study as run, with all its specs",
    "versions.json": "versions of the software",
    "data.json": "the recordings' hash",
}


def write(study: StudySpec, folder: Path) -> Path:
    """Write `report.html`, its figures and `answer.json` from the files of a run; the page's path."""
    target = parameters_of(study.parameters).target
    every = [*cells(study)]
    done = [cell for cell in every if is_done(folder, cell)]
    results = with_setting(with_pair(read_table(folder / "results.csv"), study), study)
    trains, afferents = first_spikes(folder, done), afferents_of(folder, done)
    n_values = len(tasks.names_of(trains, task_of(done[0]))) if trains else len(target)
    results = results.join(front.costs_of(study, results, afferents, n_values))
    beside = tables_beside(study, folder)

    def compared_of(rows: pd.DataFrame) -> Compared:
        others = [*rivals_of(beside, study, target, rows.iloc[0].to_dict())]
        return Compared.of([*networks_of(folder, rows, done, target)], others)

    compared = {str(setting): compared_of(rows) for setting, rows in results.groupby("setting", sort=False)}
    screens = [
        screen(setting, one, target, study.prices.name, place, _next(study, folder, place))
        for setting, one in compared.items()
        for place in [_place(folder, one.chosen)]
    ]
    said = [*_alarms(compared, study), *_cautions(study, folder, done)]
    write_json(folder / ANSWER, {"answers": [one.in_words() for one in screens], "cautions": said})
    view = _view(target)
    means = ways.over_rows(_rows(compared), view)
    write_table(means, folder / "ways.csv")
    shown = ways.seen(means, view, [_answer(setting, one, means, view) for setting, one in compared.items()])
    drawn = figures.drawings(compared, folder, target)
    return page.write(
        "protocol.html.jinja",
        study,
        folder,
        n_done=len(done),
        n_cells=len(every),
        tables={"results": results},
        figures=drawn,
        downloads=DOWNLOADS,
        specs={},
        seeds=study.sweep.get("seed", [0]),
        data={"recordings": page.if_there(folder / "data.json")},
        cautions=said,
        **{**shown, "fronts": screens},
    )


def _place(folder: Path, chosen: Way) -> str:
    """The folder of the training with the median score on validation trials, within that of the study."""
    ordered = sorted(chosen.cells, key=lambda cell: result_of(folder, cell)["row"]["score_validation"])
    return cell_folder(Path(), ordered[(len(ordered) - 1) // 2]).as_posix()


def _next(study: StudySpec, folder: Path, place: str) -> tuple[str, Sequence[str]]:
    """What to do next, and its command: test all trials, then take a network that tells numbers along as C."""
    if has_one_split(study):
        return period_choice.in_folds(folder.absolute())
    if parameters_of(study.parameters).target == (EVENTS,):
        return "", ()
    places = period_choice.Places(folder, folder / place, study.dataset.recordings)
    return "Take the chosen network along, as C:", [period_choice.as_c(places)]


def _view(target: Sequence[str]) -> View:
    is_events = [*target] == [EVENTS]
    of_target = OF_EVENTS if is_events else {f"rmse_{name}": f"error of {name_of(name)}" for name in target}
    each = ", each second" if is_events else ""
    costs = {key: f"{head}{each}" for key, head in COSTS.items()}
    note = "The score is 1 less the squared error in units of the deviation of training numbers."
    if is_events:
        note = "The score is the share of hits among events and false alarms, the mean over recordings."
    return View(("setting", *BY), {"score": "score", **of_target, **costs}, "nJ", "score", note, apart=("setting",))


def _rows(compared: dict[str, Compared]) -> pd.DataFrame:
    """A row for each network and rival."""
    return pd.DataFrame(
        [
            {
                "setting": setting, "kind": way.kind, "source": way.source, "score": way.score, "nJ": way.nJ,
                "sops": way.sops, "spikes": way.spikes, **way.found,
            }
            for setting, one in compared.items()
            for way in (*one.networks, *one.others)
        ]
    )  # fmt: skip


def _answer(setting: str, one: Compared, means: pd.DataFrame, view: View) -> Any:
    """What the page marks in its points: the best network, and the chosen one."""

    def configuration(way: Way) -> Configuration:
        rows = means[(means["setting"] == setting) & (means["kind"] == way.kind) & (means["source"] == way.source)]
        index = int(rows.index[0])
        return Configuration(index, way.name, way.kind, way.way.validation, way.way.error, way.score, float("nan"),
                             way.nJ, 1, {})  # fmt: skip

    best, chosen = configuration(one.best), configuration(one.chosen)
    measure = Measure(view.measures["score"], view.measures["nJ"])
    return Answer(
        (best, chosen), best, chosen, best.choice_error, chosen, (), None, (), None, float("nan"), setting, measure
    )


def _alarms(compared: dict[str, Compared], study: StudySpec) -> Iterator[str]:
    """That a detector has clearly more false alarms than were allowed, or that too little was heard to show so few."""
    allowed = parameters_of(study.parameters).false_alarms_per_h
    allowed = detector.FALSE_ALARMS_PER_H if allowed is None else allowed
    for one in compared.values():
        found = one.chosen.found
        if found.get("false_alarms_per_h_low", 0.0) > allowed:
            yield (
                f"the chosen detector has {found['false_alarms_per_h']:.3g} false alarms an hour, clearly more than "
                f"the {allowed:g} that were allowed where its thresholds were chosen; record longer, or allow more "
                "(`false_alarms_per_h`)"
            )
        heard_s = found.get("chosen_on_s", math.inf)
        if heard_s / 3600 * allowed < detector.SHOWS:
            yield (
                f"the {heard_s:.0f} s on which each threshold was chosen cannot show that false alarms are as rare as "
                f"{allowed:g} an hour: without one in them, up to {detector.rates_of(0, heard_s / 3600)[1]:.3g} are "
                "within the 95 % interval; record longer, or allow more (`false_alarms_per_h`)"
            )


def _cautions(study: StudySpec, folder: Path, done: Sequence[Cell]) -> Iterator[str]:
    if study.baselines == "quick":
        yield opponents.without_slow()
    trains = first_spikes(folder, list(done))
    if trains is not None and (note := acausal_note(trains.encoder)):
        yield note
    logs = []
    for cell in done:
        log = cell_folder(folder, cell) / LOG
        if cell.network is not None and log.is_file():
            logs.append([*cautions.training(pd.read_csv(log), recipe.training_of(cell.network), "network.")])
    yield from cautions.together(logs)
