"""The ways to tell numbers or to detect events that a run has compared, and which of them the referee chooses."""

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from neurotact_parts.streams import detector
from neurotact_parts.streams.detector import HIT, Tally
from neurotact_parts.studies.targets.measured import DELAYS, HELD

from neurotact.metrics import referee
from neurotact.metrics.paired import Paired, compare_by_trial
from neurotact.metrics.referee import Verdict
from neurotact.networks.exit import patience
from neurotact.networks.training import numbers
from neurotact.report import periods
from neurotact.studies.store import result_of
from neurotact.studies.study import Cell, StudySpec, by_split, encoder_columns
from neurotact.tables import columns_of_network, size_of

EVENTS, EARLY = "events", "exit_losses"


class Way(NamedTuple):
    """A network or a rival, over its splits and seeds.

    kind, source: what decides, and from what. held, tested: the score of each validation and test trial. nJ, sops,
    spikes: of an answer, of a detector in a second; NaN if not counted. found: errors or events, as columns of results.
    cells, pair (its refractory periods), early: of a network. delays_ms: of a detector, the mean of the hits of each
    test recording.
    """

    kind: str
    source: str
    held: Mapping[str, float]
    tested: Mapping[str, float]
    nJ: float
    found: Mapping[str, float]
    sops: float = math.nan
    spikes: float = math.nan
    cells: tuple[Cell, ...] = ()
    delays_ms: Mapping[str, float] = {}
    pair: str = periods.NONE
    early: "Early | None" = None

    @property
    def name(self) -> str:
        """What decides, and from what."""
        return f"{self.kind} on {self.source}"

    @property
    def score(self) -> float:
        """The mean over test trials."""
        return float(np.mean([*self.tested.values()]))

    @property
    def interval(self) -> tuple[float, float]:
        """The 95 % interval of the score, from test trials drawn with replacement."""
        values = np.array([*self.tested.values()])
        return numbers.interval(values, np.arange(len(values)))

    @property
    def of_signals(self) -> bool:
        """Whether it needs no spikes."""
        return not self.cells and self.source.startswith("signals")

    @property
    def way(self) -> referee.Way:
        """What the referee knows of it."""
        held = np.array([*self.held.values()])
        error = float(held.std(ddof=1) / math.sqrt(len(held))) if len(held) > 1 else math.nan
        return referee.Way(float(held.mean()), error, math.inf if math.isnan(self.nJ) else self.nJ, dict(self.held))


class Early(NamedTuple):
    """A network of numbers with early exit, and the upper bound of its loss (`patience.upper_bound`).

    bound: over the validation trials of all its trainings; NaN if none found a rule. tolerance: what may be lost.
    """

    way: Way
    bound: float
    tolerance: float

    @property
    def is_used(self) -> bool:
        """Whether it may be."""
        return bool(patience.is_tolerated(self.bound, self.tolerance))

    @property
    def in_words(self) -> str:
        """What is known of the loss."""
        if math.isnan(self.bound):
            return f"no rule saves steps and loses {self.tolerance:.3g} of the score at most"
        return patience.in_words(self.bound, self.tolerance, of_numbers=True)


class Compared(NamedTuple):
    """The networks and rivals of a data set: which network is chosen, and what the referee says of it.

    chosen: the cheapest within one standard error of the best on validation trials. rivals: those that validation
    cannot tell from the best of them. verdict: None without any. beside: the rival that decides it.
    """

    networks: Sequence[Way]
    others: Sequence[Way]
    best: Way
    chosen: Way
    verdict: Verdict | None
    beside: Way | None
    comparable: Way | None
    """The cheapest rival on signals that is not clearly worse on test trials, taken alone."""

    @classmethod
    def of(cls, networks: Sequence[Way], others: Sequence[Way]) -> "Compared":
        """Choose on validation trials, judge on test trials."""
        ways = [one.way for one in networks]
        best, chosen = networks[referee.best_of(ways)], networks[referee.cheapest_of(ways)]
        rivals = [others[index] for index in referee.level_with_best([one.way for one in others])] if others else []
        verdict = referee.judge([compare_by_trial(chosen.tested, one.tested) for one in rivals]) if rivals else None
        fair = [one for one in others if one.of_signals and one.nJ > 0 and not _is_worse(one, chosen)]
        comparable = min(fair, key=lambda one: one.nJ, default=None)
        return cls(networks, others, best, chosen, verdict, rivals[verdict.decisive] if verdict else None, comparable)

    @property
    def of_period(self) -> tuple[Way, Way] | None:
        """The chosen network and one of its size with another refractory period, the longer one first.

        The other one has the shortest period, or the longer one that is best on validation; None if there is none.
        """
        peers = [one for one in self.networks if one.kind == self.chosen.kind and one.pair != self.chosen.pair]
        every = sorted((self.chosen, *peers), key=lambda one: sum(periods.sizes(one.pair)))
        if not peers or not periods.sizes(every[0].pair):
            return None
        if every[0] is self.chosen:
            return peers[referee.best_of([one.way for one in peers])], self.chosen
        return self.chosen, every[0]

    @property
    def later(self) -> Paired | None:
        """By how many ms the chosen detector is later than the rival, over recordings in which both have hits."""
        mine, its = self.chosen.delays_ms, self.beside.delays_ms if self.beside else {}
        return compare_by_trial(mine, its) if mine.keys() & its.keys() else None

    @property
    def kind(self) -> str:
        """The kind of the verdict; `nothing learned` where the score may be that of no knowledge."""
        if self.chosen.interval[0] <= 0:
            return "nothing learned"
        return self.verdict.kind if self.verdict else "no rival"


def _is_worse(one: Way, chosen: Way) -> bool:
    found = compare_by_trial(chosen.tested, one.tested)
    return found.difference > 0 and found.is_clear


def networks_of(folder: Path, rows: pd.DataFrame, done: Sequence[Cell], target: Sequence[str]) -> Iterator[Way]:
    """The networks of a run, each over its splits and seeds; rows: of results with costs, whose index counts `done`."""
    for (pair, hidden, *_), own in rows.groupby(columns_of_network(rows)[1:], sort=False):
        cells = [done[index] for index in own.index]
        results = [result_of(folder, cell) for cell in cells]
        window_s = 1e-3 * own["whole_ms"].mean() if [*target] == [EVENTS] else 1.0
        found = _events(results, len(cells) / len(by_split(cells))) if [*target] == [EVENTS] else _told(results, target)
        held, tested, delays = (_mean([result.get(side, {}) for result in results]) for side in (HELD, "right", DELAYS))
        nJ, sops, spikes = (float(own[f"whole_{key}"].mean()) / window_s for key in ("nJ", "sops", "spikes"))
        size = f"{size_of(own.iloc[0])} neurons" if hidden else "no hidden layer"
        way = Way(
            f"network, {size}", f"spikes of {periods.in_ms(str(pair))}",
            held, tested, nJ, {**found, "ms": float(own["whole_ms"].mean())}, sops, spikes, tuple(cells), delays,
            str(pair),
        )  # fmt: skip
        has_early = all(EARLY in result for result in results) and [*target] != [EVENTS]
        yield way._replace(early=_early(way, results, own, target)) if has_early else way


def _early(way: Way, results: Sequence[Mapping[str, Any]], own: pd.DataFrame, target: Sequence[str]) -> Early:
    """The network with early exit, a mean over trainings; own: their rows."""
    costs = {key: float(own[f"early_{key}"].mean()) for key in ("ms", "nJ", "sops", "spikes")}
    found = {**_told(results, target, "early"), "ms": costs.pop("ms")}
    tested = _mean([result["exit_right"] for result in results])
    chosen = way._replace(source=f"{way.source}, with early exit", tested=tested)
    losses = [*_mean([result[EARLY] for result in results]).values()]
    bound = float(patience.upper_bound(losses, of_numbers=True)) if losses else math.nan
    return Early(chosen._replace(found=found, **costs), bound, way.cells[0].early_exit.tolerance)


def _mean(scores: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """The mean score of each trial over trainings."""
    table = pd.concat([pd.Series(one, dtype=float) for one in scores])
    return table.groupby(level=0).mean().to_dict()


def _told(results: Sequence[Mapping[str, Any]], target: Sequence[str], how: str = "told") -> dict[str, float]:
    """The errors of what was told of all test windows; how: `told` of whole ones, or `early`."""
    told = pd.concat([pd.DataFrame(result["tables"]["told"]) for result in results])
    values, labels = (told[[f"{side}_{name}" for name in target]].to_numpy(float) for side in (how, "true"))
    return numbers.errors(values, labels, target, told["trial"].to_numpy())


def _events(results: Sequence[Mapping[str, Any]], starts: float) -> dict[str, float]:
    """What was detected in all test recordings; starts: trainings that were tested on each."""
    events = pd.concat([pd.DataFrame(result["tables"]["events"]) for result in results])
    hits = events[events["outcome"] == HIT]
    rows = pd.DataFrame([result["row"] for result in results])
    return _over(rows, starts, Tally(hits["delay_ms"].to_numpy(float), hits["trial"].to_numpy(int), 0, 0, 1.0))


def _over(rows: pd.DataFrame, starts: float, delays: Tally | None = None) -> dict[str, float]:
    """The sums of rows of several splits, the means over starts; delays: of each hit, for their interval."""
    total = {name: float(rows[name].sum()) / starts for name in ("hits", "misses", "false_alarms", "tested_s")}
    weights = rows["hits"].to_numpy(float)
    delay_ms = float(np.average(rows["delay_ms"].fillna(0.0), weights=weights)) if weights.sum() else math.nan
    n = round(total["hits"])
    counted = Tally(np.full(n, delay_ms), np.arange(n), round(total["misses"]), round(total["false_alarms"]),
                    total["tested_s"] / 3600)  # fmt: skip
    found = {**detector.row_of(counted), "false_alarms_per_h": 3600 * total["false_alarms"] / total["tested_s"]}
    low, high = math.nan, math.nan
    if delays is not None and len(delays.delays_ms):
        low, high = numbers.interval(delays.delays_ms, delays.trials)
    return {**found, "delay_ms_low": low, "delay_ms_high": high, "chosen_on_s": float(rows["chosen_on_s"].mean())}


def rivals_of(
    tables: Mapping[str, pd.DataFrame], study: StudySpec, target: Sequence[str], result: Mapping[str, Any]
) -> Iterator[Way]:
    """The rivals of a run, each over its splits; tables: `baselines` and `baselines_trials`.

    result: a row of `results.csv` with the encoder of their spikes.
    """
    if "baselines" not in tables:
        return
    rows, trials = tables["baselines"], tables["baselines_trials"]
    for key in (key for key in encoder_columns(study) if key in rows):
        rows = rows[rows[key].isna() | (rows[key] == result[key])]
    if "nJ_per_s" not in rows:
        rows = rows.assign(nJ_per_s=study.prices.energy_nJ(rows))
    by = ["classifier", "input", "t_ref_ra_ms", "t_ref_sa_ms"]
    for (kind, source, *_), own in rows.groupby(by, sort=False, dropna=False):
        pair = next(iter(periods.of_rows(own, study)))
        of, _, words = str(source).partition(": ")
        spikes = "" if pd.isna(own["t_ref_ra_ms"].iloc[0]) or pair == periods.NONE else f" of {periods.in_ms(pair)}"
        its = trials[trials["baseline"].isin(own.index)]
        held, tested, delays = (
            {str(trial): score for trial, score in its[its["side"] == side].groupby("trial")["right"].mean().items()}
            for side in ("validation", "test", DELAYS)
        )
        errors = {
            name: float(np.average(own[name].pow(2), weights=own["n_test"]) ** 0.5)  # over all windows, as of networks
            for name in (f"rmse_{name}" for name in target)
            if name in own
        }
        found = _over(own, 1.0) if [*target] == [EVENTS] else errors
        spent = float(own["nJ_per_s"].mean())
        yield Way(str(kind), f"{of}{spikes} ({words})", held, tested, spent, found, delays_ms=delays)
