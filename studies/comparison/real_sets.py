"""Spiking networks compared with classical classifiers on the same windows, splits and spikes of several sets.

The networks follow the default recipe, with and without recurrence. All opponents of `baselines.opponents` receive the
signals, or the events of an event-based sensor; those on counts also the spikes. Sets and encoders: as in
`ways_to_save`.
"""

from collections.abc import Iterator, Mapping
from typing import Any, Literal

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from neurotact_parts.studies.comparison import by_list, fronts, rivals, sets
from neurotact_parts.studies.comparison.saving import Bench, Cut, Setting, cut, fit, row_of
from neurotact_parts.studies.comparison.saving_figures import COLOURS, MARKS
from neurotact_parts.studies.comparison.sets import WaysData
from neurotact_parts.studies.comparison.skipped import SKIPPED, of_run, skipped_row
from pydantic import Field

from neurotact.baselines import opponents
from neurotact.baselines.opponents import LINEAR, Input
from neurotact.data.recordings import Recordings
from neurotact.data.spikes import SpikeTrains
from neurotact.figures.style import INK, MUTED, Drawn, add_legend, new_panels, printed
from neurotact.metrics.flops import LEDGER_COLUMNS
from neurotact.metrics.fronts import pareto_front
from neurotact.metrics.prices import ARITHMETIC_45NM
from neurotact.metrics.resampled import LEAST_SPLITS, SHARES, Interval
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.report import sentences
from neurotact.report.way_answer import Configuration, WayAnswer
from neurotact.report.wording import count
from neurotact.spec import Spec
from neurotact.studies.way import ALL_SETS, Arrays, Listed, Named, View, heads

MODELS: dict[str, Literal["rsnn", "snn"]] = {"RSNN": "rsnn", "SNN": "snn"}
COLUMNS = 3
"""Columns of panels."""
NETWORK_INPUT = "spikes: every step"
SPIKING = "spiking networks"
"""The family of both networks in the figure of energy."""


class Parameters(Spec):
    """All classifiers on one set with one split."""

    data: WaysData
    network: RSNNSpec = RSNNSpec(recipe="default", hidden=50)
    seed: int = Field(default=0, ge=0)
    """Random seed of the split, the weights and the order of training."""


VIEW = View(
    by=("set", "split", "classifier", "input"),
    measures=heads("accuracy_test accuracy_validation energy_estimate_nJ sops_total flops parameters signal_ms"),
    cost="energy_estimate_nJ",
    score="accuracy_test",
    note="Each seed has its own split, the same for all classifiers. Energy is from the recording to "
    f"the decision, encoder included. {ARITHMETIC_45NM.in_words()} Only networks have SOPs, the others FLOPs. The "
    "column `afferents` of results.csv says when afferents are computed. Sets whose recordings are not available are "
    "left out; the column `skipped` gives the reason.",
    apart=("set", "split"),
    spiking=("classifier", tuple(MODELS)),
    splits=("seed",),
)

load = sets.load


def run(parameters: Parameters, arrays: Arrays) -> list[dict[str, Any]]:
    """A row for each network, and for each classical classifier on each input."""
    if SKIPPED in arrays:
        return [{"classifier": "", "input": "", **skipped_row(arrays, VIEW.measures)}]
    bench = sets.bench_of(parameters.data, parameters.network, parameters.seed, arrays)
    own = cut(bench, Setting())
    rows = [*_spiking(bench, own), *_classical(bench, own.trains)]
    computed = sets.computed_at(parameters.data, arrays)
    shared = {"test_trials": len(bench.split.test), "afferents": computed, SKIPPED: ""}
    sizes = {"n_validation": len(own.sides.validation.labels), "validation_trials": len(bench.split.validation)}
    return [{**row, **sizes, **shared} for row in rows]


def _spiking(bench: Bench, own: Cut) -> Iterator[dict[str, Any]]:
    for name, model in MODELS.items():
        fitted = fit(own, bench.network.model_copy(update={"model": model}), bench.seeds)
        n_parameters = sum(weights.numel() for weights in fitted.network.parameters())
        row = {"classifier": name, "input": NETWORK_INPUT, "parameters": n_parameters, "flops": float("nan")}
        yield {**row, **row_of(fitted)}


def _classical(bench: Bench, trains: SpikeTrains) -> Iterator[dict[str, Any]]:
    windows = trains.cut(bench.window)
    cuts = opponents.cuts_of(trains.conditions, windows, trains.sampling_rate_Hz, bench.split, {})
    inputs: list[Input] = []
    if isinstance(bench.touches, Recordings):
        inputs += opponents.signal_inputs(bench.touches, cuts, "all")
    inputs += opponents.spike_inputs(trains, (0.0, 0.0), cuts, "all")
    wanted = {"classifier", "input", "accuracy_validation", "accuracy_test", *LEDGER_COLUMNS, "n_train", "n_test"}
    wanted -= {"bytes"}
    for row in opponents.rows(inputs, trains.labels[windows.trial], cuts):
        kept = {key: value for key, value in row.items() if key in wanted}
        yield {**by_list.the_same(kept), "sops_total": float("nan")}


def _points(results: pd.DataFrame) -> pd.DataFrame:
    """A row for each set, split, classifier and input: means over seeds and the 95 % interval of the test accuracy.

    Columns: set, split, classifier, input, seeds, accuracy_test, low and high (NaN for one or two),
    accuracy_validation, energy_estimate_nJ.
    """
    rows = []
    for key, part in results.groupby(["set", "split", "classifier", "input"], sort=False):
        assert isinstance(key, tuple)
        interval = fronts.interval_of(part["accuracy_test"].to_numpy(), part, SHARES)
        means = {name: float(part[name].mean()) for name in ("accuracy_validation", "energy_estimate_nJ")}
        rows.append({**dict(zip(("set", "split", "classifier", "input"), key, strict=True)), "seeds": len(part),
                     "accuracy_test": interval.mean, "low": interval.low, "high": interval.high, **means})  # fmt: skip
    return pd.DataFrame(rows)


def named(results: pd.DataFrame) -> dict[str, Named]:
    """Of each set and split whether spiking is worth it, with the network and its rivals named in the picture."""
    shown = of_run(results)
    if shown.empty:
        return {}
    found = rivals.outcomes(results, VIEW)
    groups, priced = shown.groupby([*VIEW.apart], sort=False), rivals.ratios(results, VIEW)
    each = {
        one.setting: _named(one, rows, rivals.turns(priced[priced["setting"] == one.setting]))
        for one, (_, rows) in zip(found, groups, strict=True)
    }
    then = _next(min(one.shown.rows for one in found))
    if len(each) == 1:
        return {name: one._replace(next=then) for name, one in each.items()}
    every = _of_every({key: one for (key, _), one in zip(groups, found, strict=True)})
    return {ALL_SETS: every._replace(next=then), **each}


def tables(results: pd.DataFrame) -> dict[str, tuple[Listed, ...]]:
    """Of each set and split the best of each kind, and the network beside its rivals by each price list.

    Of all sets together, a row for each.
    """
    of_each = rivals.tables(results, VIEW)
    if len(of_each) < 2:
        return of_each
    rows = pd.DataFrame([_beside_rival(one) for one in rivals.outcomes(results, VIEW)])
    caption = "The network of each set and split, and the rival that its verdict rests on."
    return {ALL_SETS: (Listed(caption, rows, range(len(rows))),), **of_each}


def _beside_rival(found: WayAnswer) -> dict[str, str]:
    """The row of a set among all sets."""
    network, rival = found.shown, found.beside
    assert rival is not None
    gained = _gained(network, rival)
    within = "" if np.isnan(gained.low) else f" ({100 * gained.low:+.1f} to {100 * gained.high:+.1f})"
    return {
        "set, split": found.setting,
        "network": f"{network.kind} {_percent(network)}",
        "rival": f"{rival.name} {_percent(rival)}",
        "points more": f"{100 * gained.mean:+.1f}{within}",
        "energy beside the rival": "-" if np.isnan(rival.cost) else f"{count(network.cost / rival.cost, 2)} times",
    }


def _of_every(found: Mapping[tuple[str, str], WayAnswer]) -> Named:
    """All sets together: where the network is more or less accurate than its rival, and how many times its energy."""
    every = [*found.values()]
    seeds = min(one.shown.rows for one in every)
    told = {kind: [one.setting for one in every if one.verdict is not None and one.verdict.kind == kind]
            for kind in ("better", "worse")}  # fmt: skip
    more, less = (
        "all" if len(names) == len(every) else f"{len(names)} ({'; '.join(names)})" if names else "none"
        for names in told.values()
    )
    said = f"the network is clearly more accurate than its rival on {more} and clearly less accurate on {less}"
    if seeds < LEAST_SPLITS:
        said = f"{fronts.in_seeds(seeds)} cannot tell whether spiking is worth it"
    ratios = [one.shown.cost / one.beside.cost for one in every if one.beside is not None]
    counted = [ratio for ratio in ratios if not np.isnan(ratio)]
    ends = dict.fromkeys(count(end(counted), 2) for end in (min, max) if counted)
    where = ", where that is counted" if len(counted) < len(every) else ""
    spent = f"; it takes {' to '.join(ends)} times the rival's energy{where}" if counted else ""
    labels: dict[tuple[str, ...], str] = {}
    for key, one in found.items():
        assert one.beside is not None
        labels |= {(*key, *one.beside.name.split(", ", 1)): "", (*key, *one.shown.name.split(", ", 1)): one.setting}
    return Named(
        f"Of {len(every)} sets and splits {said}{spent}.",
        [f"{one.setting}: {'; '.join(map(_words, _told(one)))}." for one in every],
        dict.fromkeys((VIEW.cost, "signal_ms"), labels),
    )


def _next(seeds: int) -> tuple[str, list[str]]:
    """What to do next, and its command."""
    if seeds < LEAST_SPLITS:
        return "Let all sets and splits tell:", ["neurotact study run real-sets -o runs/real-sets"]
    return "Try what saves energy on these sets:", ["neurotact study run ways-to-save -o runs/ways-to-save"]


def _named(found: WayAnswer, rows: pd.DataFrame, turns: str) -> Named:
    told = _told(found)
    names = {tuple(one.name.split(", ", 1)): f"{one.name} {_percent(one)}" for one in told}
    keys = rows[["classifier", "input"]].drop_duplicates().itertuples(index=False, name=None)
    labels = {key: names.get(key, "") for key in keys}
    details = [f"{'; '.join(map(_words, told))}{fronts.afferents_in_words(rows)}."]
    if len(found.rivals) > 1 and not np.isnan(found.error):  # of one or two seeds it is not known
        details.append(f"Validation cannot tell {len(found.rivals)} rivals apart.")
    said = "the network, its rival and the cheapest within the error of the best"
    return Named(
        _headline(found),
        [*details, *filter(None, [turns])],
        dict.fromkeys((VIEW.cost, "signal_ms"), labels),
        said,
    )


def _told(found: WayAnswer) -> list[Configuration]:
    """The network, its rival and the cheapest that is as good, each once."""
    return [*{one.index: one for one in (found.shown, found.beside, found.cheapest) if one is not None}.values()]


def _headline(found: WayAnswer) -> str:
    """The verdict, the points and the energy beside the rival that it rests on, and the cheapest that is as good."""
    network, rival, cheapest = found.shown, found.beside, found.cheapest
    assert rival is not None
    verdict = sentences.verdict(found)
    if found.verdict is None or network.rows < LEAST_SPLITS:
        verdict = f"{fronts.in_seeds(network.rows).capitalize()} cannot tell whether spiking is worth it"
    gained = _gained(network, rival)
    points = f"{fronts.in_points(gained)} {'more' if gained.mean >= 0 else 'less'} than {rival.name}"
    energy = "" if np.isnan(rival.cost) else f", for {fronts.times(network.cost / rival.cost)} its energy"
    said = f"{verdict}: {network.kind} has {_percent(network)}, {points}{energy}"
    if np.isnan(found.error) or cheapest is rival:  # of one or two seeds there is no error
        return f"{said}."
    if cheapest is network:
        return f"{said}, and nothing within the error of the best takes less."
    less = fronts.times(cheapest.cost / network.cost)
    return f"{said}; {cheapest.name} has {_percent(cheapest)} for {less} that of {network.kind}."


def _percent(one: Configuration) -> str:
    return f"{100 * one.accuracy:.1f} %"


def _words(one: Configuration) -> str:
    spent = "a cost that is not counted" if np.isnan(one.cost) else f"{one.cost:,.0f} nJ"
    return f"{one.name} has {_percent(one)} at {spent}"


def _gained(one: Configuration, other: Configuration) -> Interval:
    """The accuracy of one minus that of another, over the splits."""
    assert one.by_split is not None
    assert other.by_split is not None
    mine, its = one.by_split["accuracy_test"], other.by_split["accuracy_test"]
    return fronts.interval_of((mine - its).to_numpy(), one.by_split)


def draw(results: pd.DataFrame, arrays: Arrays) -> Iterator[Drawn]:
    """Accuracy over energy with the front of each family, then the accuracy of each classifier."""
    shown = of_run(results)
    if shown.empty:
        return
    table = _points(shown)
    yield Drawn(
        "real-sets-energy",
        "What each family reaches at which energy",
        draw_energy(table),
        "Mean test accuracy over seeds and the energy estimate of a decision, from the recording on. A mark per input; "
        "lines join those marks of a family that no other mark of it dominates. Spiking networks are filled.",
        "A panel per set and split; cheaper classifiers are further left, more accurate ones higher.",
    )
    yield Drawn(
        "real-sets",
        "Spiking networks compared with other classifiers",
        draw_points(table),
        "Mean test accuracy over seeds with its 95 % interval if there are three or more, on the same windows and "
        "splits. Spiking networks are filled. LR: logistic regression.",
        "A panel per set and split; a mark per classifier and input; more accurate ones are further right.",
    )


@printed
def draw_energy(table: pd.DataFrame) -> Figure:
    """A panel per set and split, a line per family: the front of accuracy over energy; networks are filled.

    table: of `_points`.
    """
    panels = list(table[["set", "split"]].drop_duplicates().itertuples(index=False, name=None))
    families = list(dict.fromkeys(_family(name) for name in table["classifier"]))
    figure, grid = new_panels(len(panels), COLUMNS, 2.6, 0.9)
    for axes, (name, split) in zip(grid, panels, strict=True):
        own = table[(table["set"] == name) & (table["split"] == split)]
        for index, family in enumerate(families):
            rows = own[own["classifier"].map(_family) == family].sort_values("energy_estimate_nJ")
            nJ, share = rows["energy_estimate_nJ"].to_numpy(), 100 * rows["accuracy_test"].to_numpy()
            front = pareto_front(nJ, share)
            style: dict[str, Any] = {"color": COLOURS[index % len(COLOURS)], "marker": MARKS[index % len(MARKS)]}
            filled = style["color"] if family == SPIKING else "none"
            axes.plot(nJ, share, ls="", ms=5 if family == SPIKING else 4, mfc=filled, label=family, **style)
            axes.plot(nJ[front], share[front], lw=1.6 if family == SPIKING else 0.8, color=style["color"])
        axes.set(title=f"{name}, by {split}", xlabel="energy estimate (nJ)", ylabel="test accuracy (%)", xscale="log")
        axes.grid()
    add_legend(figure, grid, ncols=4)
    return figure


def _family(classifier: str) -> str:
    return SPIKING if classifier in MODELS else classifier


@printed
def draw_points(table: pd.DataFrame) -> Figure:
    """A panel per set and split, a mark per classifier and input; networks are filled.

    table: of `_points`.
    """
    panels = list(table[["set", "split"]].drop_duplicates().itertuples(index=False, name=None))
    names = list(dict.fromkeys(zip(table["classifier"], table["input"], strict=True)))
    figure, grid = new_panels(len(panels), COLUMNS, 0.9 + 0.18 * len(names), sharey=True)
    for axes, (name, split) in zip(grid, panels, strict=True):
        for row in table[(table["set"] == name) & (table["split"] == split)].itertuples():
            y, is_network = names.index((row.classifier, row.input)), row.classifier in MODELS
            low, high = (np.clip(100 * end, 0, 100) for end in (row.low, row.high))
            axes.plot([low, high], [y, y], color=MUTED, lw=0.8)
            axes.plot(100 * row.accuracy_test, y, "o", ms=4, color=INK, mfc=INK if is_network else "none")
        axes.set(title=f"{name}, by {split}", xlabel="test accuracy (%)")
        axes.grid(axis="x")
    short = [classifier.replace(LINEAR, "LR") for classifier, _ in names]
    grid[0].set_yticks(range(len(names)), [f"{name}, {words}" for name, (_, words) in zip(short, names, strict=True)])
    grid[0].invert_yaxis()
    return figure
