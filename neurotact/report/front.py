"""The first screen of a report: the answer, its table and warnings, from the files of a run."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence, Set
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from neurotact.baselines import opponents
from neurotact.data.conditioning import acausal_note
from neurotact.data.copies import copies_of
from neurotact.data.spikes import SpikeTrains
from neurotact.data.splits import SplitSpec, turns_of, validation_note
from neurotact.data.trial_choice import values_in_words
from neurotact.data.window_choice import on_late_onsets, timing_of
from neurotact.encoders.afferents import AfferentSpec
from neurotact.encoders.cost import no_cost
from neurotact.encoders.model import DrivenSpec, EncoderSpec
from neurotact.errors import InputError
from neurotact.metrics import paired, starts
from neurotact.metrics.paired import Paired
from neurotact.networks.definition import recipe
from neurotact.networks.exit import patience
from neurotact.networks.training import cautions, tasks
from neurotact.networks.training.run_folder import LOG
from neurotact.networks.use import ledger
from neurotact.networks.use.ledger import Afferents
from neurotact.networks.use.measuring import OWN_KEYS
from neurotact.report import answer as answers
from neurotact.report import first_screen, period_choice, periods, robustness, sentences, under_prices
from neurotact.report.answer import Answer, Baseline, Decision, Network, OfNetworks, Trials
from neurotact.report.page import Figure, Table
from neurotact.report.tables import first_spikes
from neurotact.report.wording import energy
from neurotact.studies import automatic
from neurotact.studies.cell import task_of
from neurotact.studies.measures import INTEGERS
from neurotact.studies.store import cell_folder, result_of
from neurotact.studies.study import (
    Cell,
    StudySpec,
    by_split,
    encoder_columns,
    has_one_split,
    has_one_window,
    split_columns,
)
from neurotact.tables import LAYERS, columns_of_network, means_over

COSTS = ("sops", "ms", "spikes", "nJ")
BY = "nJ by "
"""Before the name of a price list: the column of energies by it."""
KINDS = {"whole": "", "early": "exit_"}
"""Both ways to decide, and their prefixes of columns in `results.csv`."""
USED = {False: "whole", True: "early"}
"""The way to decide of `KINDS` that is used, by whether early exit is."""
BILL = "bill/bill.txt"
"""What an export to `bill` writes, in the folder of a run."""
EXIT_LOSSES = "exit_losses"
"""What early exit loses on each validation trial (`measuring.measure`); runs of earlier versions lack it."""


class Sides(NamedTuple):
    """Numbers of trials of one data set: on each side, over all splits, and test trials of each class."""

    trials: Trials
    tested: dict[str, int]


class Front(NamedTuple):
    """The first screen of one answer, of a data set, task or rule.

    figures: of the row that is shown. details: the answer in words, after the headline. tables: of networks the rows
    that the headline rests on, all that a sentence names, and the price lists; of a way the best of each kind. chosen:
    which network the figures are of. untold: what validation cannot choose. period: which refractory period, what it
    saves and costs; next: what to do then, and commands. All are empty if there is nothing to say. Of networks alone:
    sides; split: that of the first training, one of several where a study sweeps it; cells: for each network the row of
    `results.csv` that stands for it; lost: the losses of accuracy; classes: of `robustness.by_class`, for the best
    network; leader: the name of the folder of the best one on validation trials, whatever it costs; folder: the folder,
    within the study, of the network that the figures are of, its first training.
    Of a way alone: told: its own headline.
    """

    setting: str
    answer: Answer[Any, Any]
    figures: Sequence[Figure]
    details: Sequence[str]
    tables: Sequence[Table]
    chosen: str = ""
    untold: str = ""
    sides: Sides = Sides(Trials(0, 0), {})
    split: SplitSpec = SplitSpec()
    cells: Sequence[int] = ()
    lost: Sequence[str] = ()
    classes: pd.DataFrame = pd.DataFrame()
    period: str = ""
    next: tuple[str, Sequence[str]] = ("", ())
    leader: str = ""
    folder: str = ""
    told: str = ""

    @property
    def headline(self) -> str:
        """The answer in one sentence, after a warning where validation cannot choose for the test."""
        said = self.told or sentences.headline(self.answer)
        return f"{self.untold}. {said}" if self.untold else said

    @property
    def verdict(self) -> str:
        """What the headline says without its numbers; the headline where it says nothing else."""
        said = "" if self.told else sentences.verdict(self.answer)
        return f"{said}." if said else self.headline

    @property
    def evidence(self) -> str:
        """The numbers of the headline, as a sentence."""
        said = sentences.evidence(self.answer)
        return f"{said if self.answer.measure.cost else said[:1].upper() + said[1:]}."

    def in_words(self) -> dict[str, Any]:
        """The answer for programs, in words."""
        return {
            "dataset": self.setting,
            "kind": self.answer.kind,
            "headline": self.headline,
            "short": sentences.verdict(self.answer),
            "untold": self.untold,
            "period": self.period,
            "next": {"words": self.next[0], "commands": [*self.next[1]]},
            "figures": [figure._asdict() for figure in self.figures],
            "chosen": self.chosen,
            "leader": self.leader,
            "folder": self.folder,
            "details": [*self.details],
        }


def costs_of(
    study: StudySpec, results: pd.DataFrame, afferents: Sequence[Afferents | None], n_classes: int
) -> pd.DataFrame:
    """The costs of each row of `results.csv`: columns `whole_sops`, `whole_ms` ... `early_nJ`, `early_nJ by loihi` ...

    afferents: of each row. Without them the clock is unknown, so ms and nJ are missing; without the rate of their
    recordings, where that counts, nJ.
    """
    own = [*afferents, *[None] * len(results)]
    return pd.DataFrame(
        [{f"{kind}_{key}": value for kind in KINDS
          for key, value in _costs(study, row, made_by, n_classes, kind).items()}
         for row, made_by in zip(results.to_dict("records"), own, strict=False)],
        index=results.index, dtype=float,
    )  # fmt: skip


def _costs(
    study: StudySpec, row: Mapping[str, Any], afferents: Afferents | None, n_classes: int, kind: str
) -> dict[str, float | None]:
    before = KINDS[kind]
    steps = row["exit_steps"] if before else row["window_steps"]
    costs: dict[str, float | None] = {
        "sops": row[f"{before}sops_total"],
        "ms": None,
        "spikes": ledger.input_spikes(row, before),
        "nJ": None,
    }
    if afferents is not None and study.network is not None:
        counts = study.encoding_in == "processor"
        how = {"n_classes": n_classes, "early": bool(before), "encoding": counts}
        costs["ms"] = 1e3 * steps / afferents.rate_Hz
        if (not counts or afferents.is_countable) and ledger.is_row_counted(study.network, row):
            spent = [ledger.row_cost(study.network, row, afferents, **how, event_driven=way) for way in (False, True)]
            by_list = {one.name: spent[one.event_driven].energy_nJ(one) for one in under_prices.lists(study.prices)}
            costs["nJ"] = _known(by_list[study.prices.name])
            costs |= {f"{BY}{name}": nJ for name, nJ in by_list.items()}
    return costs


def _known(energy_nJ: float) -> float | None:
    return None if pd.isna(energy_nJ) else float(energy_nJ)


def with_exit_bound(network: Network, folder: Path, cells: Sequence[Cell], tolerance: float) -> Network:
    """The network with the upper bound of what its early exit loses, over the validation trials of all its trainings.

    cells: of the network. tolerance: what may be lost. A trial that several trainings validate counts once, with its
    mean loss. Unknown if a training has none.
    """
    found = [result_of(folder, cell).get(EXIT_LOSSES) for cell in cells]
    if not found or not all(found):
        return network._replace(exit_bound=None, tolerance=tolerance)
    losses = pd.concat([pd.Series(one, dtype=float) for one in found]).groupby(level=0).mean()
    return network._replace(exit_bound=float(patience.upper_bound(losses)), tolerance=tolerance)


def networks_of(results: pd.DataFrame, splits: Sequence[str] = ()) -> list[Network]:
    """The networks of one data set, means over seeds; `results` has the columns of `costs_of`.

    splits: the columns of `split_columns`: seeds of one split are starts, other splits are not.
    """
    measures = ["accuracy_validation", "accuracy_test", "exit_accuracy"]
    measures += [f"{kind}_{cost}" for kind in KINDS for cost in COSTS]
    measures += [name for name in results if f"_{BY}" in str(name)]
    are_parts = results[OWN_KEYS].notna() if OWN_KEYS in results else results["hidden"] < 0
    by = columns_of_network(results)
    of_parts = {*results[are_parts][by].itertuples(index=False, name=None)}
    drawn = results[are_parts | (results["hidden"] > 0)]  # weights begin at random
    same = [group for _, group in drawn.groupby([*by, *splits], sort=False, dropna=False)]
    apart, apart_early = (
        starts.spread(group[name].dropna().tolist() for group in same) for name in ("accuracy_test", "exit_accuracy")
    )
    means = means_over(results.infer_objects(), by, measures, "seeds")
    fewest = results.groupby([*by, *splits], dropna=False).size().groupby(level=by).min()
    found = [
        Network(
            str(row["pair"]),
            int(row["hidden"]),
            int(row["seeds"]),
            float(row["accuracy_validation"]),
            _decision(row, "whole"),
            _decision(row, "early"),
            starts=int(fewest[tuple(row[key] for key in by)]),
            apart=apart,
            apart_early=apart_early,
            is_part=tuple(row[key] for key in by) in of_parts,
            layers=row.get(LAYERS, ""),
        )
        for row in means[[*by, "seeds", *measures]].to_dict("records")
    ]
    return [one._replace(apart=None, apart_early=None) if one.is_fitted else one for one in found]


def _decision(row: Mapping[str, Any], kind: str) -> Any:
    """A decision of a row with the columns of `costs_of`; None for early exit if it was not measured."""
    accuracy = row[f"{KINDS[kind]}accuracy" if KINDS[kind] else "accuracy_test"]
    if kind == "early" and pd.isna(accuracy):
        return None
    sops, ms, spikes, energy_nJ = (row[f"{kind}_{cost}"] for cost in COSTS)
    before = f"{kind}_{BY}"
    by_list = [(name.removeprefix(before), row[name]) for name in row if str(name).startswith(before)]
    return Decision(accuracy, sops, ms, spikes, None if pd.isna(energy_nJ) else float(energy_nJ), _counted(by_list))


def _counted(by_list: Iterable[tuple[str, Any]]) -> answers.ByList:
    """The energies by list that are counted."""
    return tuple((name, float(nJ)) for name, nJ in by_list if not pd.isna(nJ))


def decisions_of_row(row: Mapping[str, Any], costs: Mapping[str, float | None]) -> dict[str, Any]:
    """Both ways to decide of one trained network, for the page: `whole` and `early`, None if not measured.

    row: of `results.csv`. costs: of `costs_of`, None if missing.
    """
    return {kind: _as_json(_decision({**row, **costs}, kind)) for kind in KINDS}


def as_json(front: Front) -> dict[str, Any]:
    """The drawing of one data set: its networks with their intervals, its baselines, and guessing."""
    drawn = []
    for network, cell in zip(front.answer.rows, front.cells, strict=True):
        low, high = answers.interval_of(network, network.used, front.answer.trials)
        name = f"{periods.in_ms(network.pair)}, {network.size or 'N = 0'}"
        more = {"low": low, "high": high, "used": USED[network.exits], "cell": cell, "name": name}
        entry = {key: value for key, value in network._asdict().items() if not key.startswith("apart")} | more
        drawn.append(entry | {kind: _as_json(getattr(network, kind)) for kind in KINDS})
    one = front.answer
    return {
        "networks": drawn,
        "best": one.rows.index(one.best),
        "cheapest": one.rows.index(one.cheapest),
        "used": USED[one.best.exits],
        "baseline": baseline_as_json(one.baseline),
        "beside": baseline_as_json(one.beside),
        "comparable": baseline_as_json(one.comparable),
        "cheaper": [baseline_as_json(baseline) for baseline in one.priced[0].cheaper],
        "rivals": [baseline.name for baseline in one.rivals],
        "verdict": None
        if one.verdict is None or one.decisive is None
        else {**one.verdict._asdict(), "decisive": one.decisive.name},
        "guess": one.guess,
    }


def baseline_as_json(baseline: Baseline | None) -> dict[str, Any] | None:
    """A baseline for the page."""
    if baseline is None:
        return None
    return {key: value for key, value in baseline._asdict().items() if key not in ("rows", "right", "by_list", "bytes")}


def _as_json(decision: Decision | None) -> dict[str, Any] | None:
    if decision is None:
        return None
    shown = {key: value for key, value in decision._asdict().items() if key != "by_list"}
    return {key: None if value is None or pd.isna(value) else value for key, value in shown.items()}


def baselines_of(study: StudySpec, tables: Mapping[str, pd.DataFrame], result: Mapping[str, Any]) -> list[Baseline]:
    """The baselines on the windows of one data set; none if a study sweeps its windows: theirs are the first cell's.

    result: a row of `results.csv` with the data set and the encoder of their spikes.
    """
    if not has_one_window(study):
        return []
    baselines, dataset = [], str(result["dataset"])
    if "baselines" in tables:
        table = tables["baselines"]
        for key in (key for key in encoder_columns(study) if key in table):
            table = table[table[key].isna() | (table[key] == result[key])]
        by = ["classifier", "input", "t_ref_ra_ms", "t_ref_sa_ms", *(["encoder"] if "encoder" in table else [])]
        table = table[table["dataset"] == dataset]
        is_counted = "macs" in table  # else it holds energies alone
        by_list = {f"{BY}{one.name}": one.energy_nJ(table) for one in under_prices.lists(study.prices) if is_counted}
        table = table.assign(**by_list)
        measures = ["accuracy_validation", "accuracy_test", "energy_estimate_nJ", *by_list]
        measures += [name for name in ("bytes",) if name in table]
        averaged = [tuple(part.index) for _, part in table.groupby(by, sort=False, dropna=False)]
        means = means_over(table, by, measures, "splits")
        pairs = periods.of_rows(means, study)
        for row, rows, named in zip(means.to_dict("records"), averaged, pairs, strict=True):
            pair = "" if pd.isna(row["t_ref_ra_ms"]) or named == periods.NONE else f"{named} ms "
            source, _, words = row["input"].partition(": ")
            name = f"{row['classifier']} on {pair}{source} ({words})"
            shares = row["accuracy_validation"], row["accuracy_test"]
            right = validated(tables["baselines_trials"], rows) if "baselines_trials" in tables else None
            energies = _counted((key.removeprefix(BY), row[key]) for key in by_list)
            spent = _known(row["energy_estimate_nJ"]), rows, right, energies, _known(row.get("bytes", np.nan))
            baselines.append(Baseline(name, *shares, *spent))
    return baselines


def rounded(tables: Mapping[str, pd.DataFrame]) -> dict[str, pd.DataFrame]:
    """The tables as if each baseline that can be rounded were; the others stay. Earlier versions rounded none."""
    width, baselines, trials = opponents.ROUNDED, tables.get("baselines"), tables.get("baselines_trials")
    if baselines is None or trials is None or f"accuracy_test{width}" not in baselines:
        return {**tables}
    pairs = {name: f"{name}{width}" for name in ("accuracy_validation", "accuracy_test")}
    narrow = {name: baselines[other].fillna(baselines[name]) for name, other in pairs.items()}
    is_rounded = baselines[pairs["accuracy_test"]].notna()[trials["baseline"]].to_numpy()
    own = trials[trials["side"].str.endswith(width) | ~is_rounded]
    own = own.assign(side=own["side"].str.removesuffix(width))
    return {**tables, "baselines": baselines.assign(**narrow), "baselines_trials": own}


def of_setting(tables: Mapping[str, pd.DataFrame], name: str, setting: str) -> pd.DataFrame | None:
    """The rows of a table with the column `setting` that one answer is of; None if the run has none."""
    table = tables.get(name)
    own = None if table is None else table[table["setting"] == setting]
    return None if own is None or own.empty else own


def in_integers(tables: Mapping[str, pd.DataFrame], setting: str, network: Network) -> float | None:
    """The test accuracy of a network in 8-bit integers; None if it is not measured, or has no integer form."""
    table = of_setting(tables, INTEGERS, setting)
    if table is None or f"accuracy_test{opponents.ROUNDED}" not in table:
        return None
    own = robustness.of_network(table, network)
    return _known(own[f"accuracy_test{opponents.ROUNDED}"].mean())


def sides_of(
    trains: SpikeTrains | None, cells: Sequence[Cell], counts: Sequence[int], tested: Set[int] = frozenset()
) -> Sides:
    """The numbers of trials of the spike trains; if those are missing, of tested trials, or else of test windows.

    cells: one per split; a trial that several of them test counts once, and so do copies. counts: their test windows of
    each class. tested: the trials of these windows, which are fewer than the split's where some are shorter than a
    window; none if they are unknown.
    """
    n = len(tested) or sum(counts)
    without = Sides(Trials(n, n), {str(index): windows for index, windows in enumerate(counts)})
    if trains is None:
        return without
    try:
        parts = [tasks.trials_of(trains, task_of(cell)) for cell in cells]
    except InputError:  # spikes of other trials
        return without
    labels = trains.conditions["label"].astype(str).to_numpy()
    distinct = copies_of(trains).distinct
    train, validation, test = (distinct(np.unique(np.concatenate(side))) for side in zip(*parts, strict=True))
    test = np.array([*tested]) if tested and max(tested) < len(labels) else test
    known, tests = Counter(labels[train]), Counter(labels[test])
    return Sides(Trials(len(validation), len(test)), {label: tests[label] for label in sorted(known)})


def fronts(
    study: StudySpec,
    folder: Path,
    done: Sequence[Cell],
    results: pd.DataFrame,
    trains: SpikeTrains | None,
    afferents: Sequence[Afferents | None],
    tables: Mapping[str, pd.DataFrame],
) -> Iterator[Front]:
    """The answer of each data set, in the order of the table.

    results: a run's `results.csv` with the columns `pair` and `setting` and those of `costs_of`, a row per done cell.
    afferents: of each of these cells.
    tables: `baselines`, `baselines_trials` and, with the column `setting`, `integers` and `remedies`, if they exist.
    """
    narrow_tables = rounded(tables)
    for setting, rows in results.groupby("setting", sort=False):
        own = [done[index] for index in rows.index if index < len(done)]
        if not own:
            continue
        # a sweep of the simulation has other trials, whose numbers may differ
        known = trains if own[0].source == done[0].source else first_spikes(folder, own)
        first_of_splits = [group[0] for group in by_split(own)]
        left = [result_of(folder, cell) for cell in first_of_splits]
        counts = np.array([one["confusion"] for one in left]).sum(axis=(0, 2)).tolist()
        sides = sides_of(known, first_of_splits, counts, {int(trial) for one in left for trial in one.get("right", ())})
        guess = max(1 / len(counts), max(counts) / max(1, sum(counts)))
        unranked = untold(first_of_splits, known)
        networks = networks_of(rows, split_columns(study))
        if not unranked:  # else validation trials have not the condition of the test, and bound no loss there
            tolerance = first_of_splits[0].early_exit.tolerance
            networks = [with_exit_bound(one, folder, cells_of(done, rows, one), tolerance) for one in networks]
        baselines = baselines_of(study, tables, rows.iloc[0].to_dict())
        compare = _comparing(study, folder, done, rows, tables)
        by_encoder = "encoder" in rows  # then another sentence compares their periods
        found = None if by_encoder else period_choice.chosen(networks, sides.trials)
        answer = answers.answer(networks, baselines, guess, sides.trials, compare, study.prices.name, found)
        compare = _comparing(study, folder, done, rows, narrow_tables)
        baselines = baselines_of(study, narrow_tables, rows.iloc[0].to_dict())
        narrow = answers.answer(networks, baselines, guess, sides.trials, compare, chosen=found)
        splits = [cell.split for cell in first_of_splits]
        lost = [*sentences.gaps(answer, likely_cause(splits))]
        if not by_encoder:  # else the table of encoders tells it
            lost += sentences.where_lost(answer, [*_of_afferents(study.encoder)])
        cheapest = robustness.of_network(rows, answer.cheapest).index
        made_by = [one for index in cheapest if index < len(afferents) and (one := afferents[index]) is not None]
        classes = robustness.by_class(folder, cells_of(done, rows, answer.best), known)
        words = [
            sentences.of_starts(answer),
            *robustness.sentence(of_setting(tables, robustness.REMEDIES, str(setting)), answer.best),
            *robustness.hardest(classes),
            *sentences.details(answer),
            *_of_encoding(answer, made_by, study),
            *under_prices.sentences(answer),
            *_of_processor(folder),
            *sentences.of_width(answer, narrow, in_integers(tables, str(setting), answer.best)),
        ]
        sample_ms = next((1e3 / one.recorded_Hz for one in afferents if one and one.recorded_Hz), 0.0)
        named = first_screen.table(answer, periods.head(study), sample_ms)
        represented = [representative(rows, network) for network in networks]
        period, then = "", ("", ())
        if found is not None:
            run = _OfRun(study, folder, done, rows, known)
            period, then = run.period(answer, sides, first_of_splits, unranked, sample_ms)
        yield Front(
            str(setting),
            answer,
            first_screen.figures(answer),
            words,
            [named, *filter(None, [under_prices.table(answer)])],
            first_screen.chosen(answer),
            unranked,
            sides,
            splits[0],
            represented,
            lost,
            classes,
            period,
            then,
            cell_folder(folder, done[represented[networks.index(answer.leader)]]).name,
            cell_folder(Path(), done[represented[networks.index(answer.best)]]).as_posix(),
        )


class _OfRun(NamedTuple):
    """What the sentence on refractory periods asks of a run. rows: of one data set, whose index counts `done`."""

    study: StudySpec
    folder: Path
    done: Sequence[Cell]
    rows: pd.DataFrame
    trains: SpikeTrains | None

    def period(
        self, answer: OfNetworks, sides: Sides, cells: Sequence[Cell], untold: str, sample_ms: float
    ) -> tuple[str, tuple[str, Sequence[str]]]:
        """The sentence, and what to do next, in words and commands; cells: one per split."""
        compared = period_choice.Comparison(self.rows, self._right, split_columns(self.study), self._sizes(cells))
        choice = period_choice.choose(answer, compared, untold, cells[0].early_exit.tolerance)
        if choice is None:
            return "", ("", ())
        chosen = self.done[representative(self.rows, choice.network)]
        each = min(self._trials_of_classes(), default=0)
        place = cell_folder(self.folder, chosen)
        may_fold = has_one_split(self.study) and each >= automatic.FOLDS
        places = period_choice.Places(self.folder, place, self.study.dataset.recordings, may_fold=may_fold)
        sure = period_choice.Sure(sides.trials.test, len(cells), choice.network.seeds, each)
        said = period_choice.in_words(choice, sure, periods.populations(self.study), sample_ms)
        return said, period_choice.next_step(
            choice, sure, places, sentences.lost_in_encoding(answer), few=answer.kind == "too few trials"
        )

    def _right(self, index: int) -> dict[str, float] | None:
        return result_of(self.folder, self.done[index]).get("right") if index < len(self.done) else None

    def _trials_of_classes(self) -> Iterable[int]:
        if self.trains is None:
            return ()
        return Counter(self.trains.labels[np.unique(copies_of(self.trains).first)].tolist()).values()

    def _sizes(self, cells: Sequence[Cell]) -> tuple[int, int, float]:
        """Training and test trials, sums over splits, and test trials of one, their mean; cells: one per split.

        As many of both where they are unknown, which is cautious.
        """
        try:
            found = [] if self.trains is None else [tasks.trials_of(self.trains, task_of(cell)) for cell in cells]
        except InputError:  # spikes of other trials
            found = []
        if not found:
            return 1, 1, 1.0
        n_train, _, n_test = (sum(map(len, side)) for side in zip(*found, strict=True))
        return n_train, n_test, n_test / len(found)


def cells_of(done: Sequence[Cell], rows: pd.DataFrame, network: Network) -> list[Cell]:
    """The cells of a network. rows: of `results.csv`, whose index counts `done`."""
    places = robustness.of_network(rows, network).index
    return [done[index] for index in places if index < len(done)]


def untold(cells: Sequence[Cell], trains: SpikeTrains | None) -> str:
    """A statement that validation cannot choose for the test, because it cannot leave out a condition; else empty.

    cells: one per split.
    """
    for cell in cells:
        if cell.split.test_where and trains is not None and not turns_of(trains.conditions, cell.split):
            return validation_note(trains.conditions, cell.split, varied=cell.augmentation is not None)
    return ""


def representative(rows: pd.DataFrame, network: Network) -> int:
    """The row of `results.csv` that stands for a network: the training with the median accuracy on validation windows.

    A page shows a single training of each network; the best one would flatter it.
    """
    own = robustness.of_network(rows, network)
    ordered = own["accuracy_validation"].sort_values(kind="stable").index
    return int(ordered[(len(ordered) - 1) // 2])


def likely_cause(splits: Sequence[SplitSpec]) -> str:
    """Why test trials may differ from validation trials, by the way in which they are chosen.

    splits: of all trainings, which may test one value of a condition after the other.

    >>> likely_cause([SplitSpec(test_where={"speed": 150})])
    'test trials have speed = 150, validation trials have not'
    >>> likely_cause([SplitSpec(test_where={"speed": 150}), SplitSpec(test_where={"speed": 300})])
    'test trials have a speed that validation trials have not'
    """
    split = splits[0]
    if any(other.test_where != split.test_where for other in splits):
        names = " and ".join(f"a {name}" for name in split.test_where)
        return f"test trials have {names} that validation trials have not"
    if split.test_where:
        return f"test trials have {values_in_words(split.test_where, ' and ')}, validation trials have not"
    if split.order is not None:
        return f"test trials are the last ones by {split.order}"
    if split.group:
        return f"test trials are of another {' and '.join(split.group)}"
    return "the classifiers were chosen among many on few validation trials, or these resemble training trials more"


def _of_afferents(encoder: EncoderSpec) -> Iterator[str]:
    """What may help where the encoding loses accuracy: calibration and keys that this encoder has, or another one."""
    if isinstance(encoder, DrivenSpec) and not encoder.is_signed:
        yield "at `nt.calibrate(..., compare=True)`"
    if not isinstance(encoder, AfferentSpec):
        yield "at other encoders, which the study which-encoder compares"
        return
    yield "at afferents of other membranes (`settings={'encoder.tau_mem_ms': ...}`: 10 sends more spikes than 50)"
    if len(encoder.sa1.grades) == 1:
        yield "at more afferents per taxel (`settings={'encoder': 'sa1-ra1-lif-graded'}`)"


def _of_processor(folder: Path) -> list[str]:
    """What the bill of an emulated processor says first, if one was made of a network of this run."""
    path = folder / BILL
    return path.read_text(encoding="utf-8").splitlines()[:1] if path.is_file() else []


def _of_encoding(answer: OfNetworks, afferents: Sequence[Afferents], study: StudySpec) -> Iterator[str]:
    """The energy of conditioning and encoding for the cheapest decision, which fewer spikes do not lower.

    afferents: of each training of that network; the energy is a mean over them.
    """
    decision = answer.cheapest.used
    yield from dict.fromkeys(f"{why[:1].upper()}{why[1:]}." for one in afferents if (why := no_cost(one.encoder)))
    if not afferents or decision.nJ is None or not answer.is_above_chance:
        return
    if not all(one.is_countable for one in afferents):
        return
    first = afferents[0]
    spent = [one.cost(1e-3 * decision.ms * one.rate_Hz, decision.spikes) for one in afferents]
    alone = energy(float(np.mean([one.energy_nJ(study.prices) for one in spent])))
    if study.encoding_in == "sensor":
        yield f"Conditioning and encoding are in the sensor and not counted; on the processor they take {alone} more."
        return
    clock = f"{first.rate_Hz:g} steps per second, for any number of spikes"
    if (recorded_Hz := first.encoder.get("recorded_Hz")) is not None:
        clock = f"{recorded_Hz:.4g} samples per second, and more for each spike"
    elif first.has_average_apart:
        clock = f"{first.recorded_Hz:.4g} samples per second of a moving average and {clock}"
    yield (
        f"Conditioning and encoding, on the processor, take {alone} of {energy(decision.nJ)}, at {clock}; "
        "`settings={'encoding_in': 'sensor'}` leaves them out."
    )


def _comparing(
    study: StudySpec, folder: Path, done: Sequence[Cell], rows: pd.DataFrame, tables: Mapping[str, pd.DataFrame]
) -> answers.Compare:
    """The comparison of a network with a baseline of one data set on their common test trials.

    rows: of `results.csv`, whose index counts `done`. A trial that several splits test counts once.
    """
    splits = split_columns(study)

    def compare(network: Network, baseline: Baseline) -> Paired | None:
        its = robustness.of_network(rows, network).index
        if "baselines_trials" not in tables or max(its) >= len(done):
            return None
        left = [(index, result_of(folder, done[index])) for index in its]
        decided = "exit_right" if network.exits else "right"
        if not baseline.rows or any(decided not in result for _, result in left):  # of an earlier version
            return None
        spiking = [(row, int(trial), share) for row, result in left for trial, share in result[decided].items()]
        own = pd.DataFrame(spiking, columns=["row", "trial", "right"]).join(rows[splits], on="row")
        trials, by = tested(tables["baselines_trials"]), [*splits, "trial"]
        # Both tables name a split as the files do: a text such as 01 is read as a number.
        other = trials[trials["baseline"].isin(baseline.rows)].join(tables["baselines"][splits], on="baseline")
        means = own.groupby(by)["right"].mean()
        both = pd.concat([means, other.groupby(by)["right"].mean()], axis=1, join="inner", keys=["network", "baseline"])
        once = both.groupby("trial").mean()
        return paired.compare(once["network"].to_numpy(), once["baseline"].to_numpy()) if len(once) else None

    return compare


def levels(all_fronts: Sequence[Front]) -> dict[str, dict[str, float]]:
    """For each data set the accuracies at any cost: of the baseline that is best on validation trials, of guessing."""
    known = {}
    for front in all_fronts:
        best = front.answer.baseline
        known[front.setting] = ({} if best is None else {"best other classifier": best.accuracy}) | {
            "guessing": front.answer.guess
        }
    return known


def validated(trials: pd.DataFrame, rows: Sequence[int]) -> dict[Any, float] | None:
    """The share of correct windows of each validation trial, over the rows of a baseline; None if it is not saved."""
    if "side" not in trials:
        return None
    own = trials[(trials["side"] == "validation") & trials["baseline"].isin(rows)]
    return own.groupby("trial")["right"].mean().to_dict()


def tested(trials: pd.DataFrame) -> pd.DataFrame:
    """The rows of `baselines_trials.csv` on test trials; earlier versions saved no others."""
    return trials[trials["side"] == "test"] if "side" in trials else trials


def beware(
    study: StudySpec, folder: Path, done: Sequence[Cell], all_fronts: Sequence[Front], trains: SpikeTrains | None
) -> list[str]:
    """Warnings about this run, one line each with the fix."""
    by_line: dict[str, list[str]] = {}
    for front in all_fronts:
        for line in _of_front(front, trains):
            by_line.setdefault(line, []).append(front.setting)
    for_all = len(all_fronts)
    lines = [line if len(of) == for_all else f"{'; '.join(of)}: {line}" for line, of in by_line.items()]
    if study.baselines == "quick":
        lines.append(opponents.without_slow())
    if trains is not None:
        lines += cautions.copies(len(copies_of(trains).trials), len(trains))
        note = acausal_note(trains.encoder)
        lines += [*([note] if note else []), *on_late_onsets(trains, timing_of(trains), study.window, automatic.WORDS)]
    return [*lines, *cautions.together([list(_of_training(folder, cell)) for cell in done])]


def _of_front(front: Front, trains: SpikeTrains | None) -> Iterator[str]:
    one = front.answer
    if not one.is_above_chance:
        yield from cautions.not_learned(one.best.used.accuracy, one.interval[0], one.guess)
    yield from front.lost
    if trains is not None:
        yield from cautions.few_test_trials(front.sides.tested, None if front.next[0] else front.split)


def _of_training(folder: Path, cell: Cell) -> Iterator[str]:
    log = cell_folder(folder, cell) / LOG
    if cell.network is not None and log.is_file():
        yield from cautions.training(pd.read_csv(log), recipe.training_of(cell.network), "network.")


def chosen(trains: SpikeTrains | None, done: Sequence[Cell]) -> list[str]:
    """The choices of the recipe for the first network on its training windows; empty without a recipe."""
    if trains is None or not done or done[0].network is None or done[0].network.recipe is None:
        return []
    return list(recipe.described(done[0].network, tasks.seen(trains, task_of(done[0]))))
