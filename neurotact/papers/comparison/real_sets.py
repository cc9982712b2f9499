"""Spiking networks compared with classical classifiers on the same windows, splits and spikes of several sets.

The networks follow the default recipe, with and without recurrence. All opponents of `studies.baselines` receive the
signals, or the events of an event-based sensor; those on counts also the spikes. Sets and encoders: as in
`ways_to_save`.
"""

from collections.abc import Iterator
from typing import Any, Literal

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from pydantic import Field

from neurotact.data.recordings import Recordings
from neurotact.data.spikes import SpikeTrains
from neurotact.figures.style import INK, MUTED, Drawn, new_figure, printed
from neurotact.networks.specs import RSNNSpec
from neurotact.papers.comparison import fronts, sets
from neurotact.papers.comparison.saving import Bench, Setting, Sides, cut, fit, row_of
from neurotact.papers.comparison.sets import WaysData
from neurotact.papers.comparison.skipped import SKIPPED, of_run, skipped_row
from neurotact.spec import Spec
from neurotact.studies import baselines
from neurotact.studies.baselines import LINEAR, Input
from neurotact.studies.protocol import Arrays, View, heads

MODELS: dict[str, Literal["rsnn", "snn"]] = {"RSNN": "rsnn", "SNN": "snn"}
COLUMNS = 3
"""Columns of panels."""
NETWORK_INPUT = "spikes: every step"
MOST_MACHINES = 10_000
"""Training windows up to which support vector machines are fitted; this takes minutes."""


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
    note="Each seed has its own split, the same for all classifiers. Energy is an estimate of the arithmetic from "
    "the recording to the decision, encoder included, without memory. Only networks have SOPs, the others FLOPs. "
    "Sets whose recordings are not available are left out; the column `skipped` of results.csv gives the reason.",
    apart=("set", "split"),
)

load = sets.load


def run(parameters: Parameters, arrays: Arrays) -> list[dict[str, Any]]:
    """A row for each network, and for each classical classifier on each input."""
    if SKIPPED in arrays:
        return [{"classifier": "", "input": "", **skipped_row(arrays, VIEW.measures)}]
    bench = sets.bench_of(parameters.data, parameters.network, parameters.seed, arrays)
    sides = cut(bench, Setting())
    rows = [*_spiking(bench, sides), *_classical(bench, sides.trains)]
    return [{**row, SKIPPED: ""} for row in rows]


def _spiking(bench: Bench, sides: Sides) -> Iterator[dict[str, Any]]:
    for name, model in MODELS.items():
        fitted = fit(sides, bench.network.model_copy(update={"model": model}), bench.seeds)
        n_parameters = sum(weights.numel() for weights in fitted.network.parameters())
        row = {"classifier": name, "input": NETWORK_INPUT, "parameters": n_parameters, "flops": float("nan")}
        yield {**row, **row_of(fitted)}


def _classical(bench: Bench, trains: SpikeTrains) -> Iterator[dict[str, Any]]:
    windows = trains.cut(bench.window)
    cuts = baselines.cuts_of(trains.conditions, windows, trains.sampling_rate_Hz, bench.split, {})
    inputs: list[Input] = []
    if isinstance(bench.touches, Recordings):
        inputs += baselines.signal_inputs(bench.touches, cuts, "all")
    inputs += baselines.spike_inputs(trains, (0.0, 0.0), cuts, "all")
    wanted = {"classifier", "input", "accuracy_validation", "accuracy_test", "energy_estimate_nJ", "flops",
              "parameters", "signal_ms", "n_train", "n_test"}  # fmt: skip
    for row in baselines.rows(inputs, trains.labels[windows.trial], cuts, most_machines=MOST_MACHINES):
        yield {**{key: value for key, value in row.items() if key in wanted}, "sops_total": float("nan")}


def points(results: pd.DataFrame) -> pd.DataFrame:
    """A row for each set, split, classifier and input: means over seeds and the 95 % interval of the test accuracy.

    Columns: set, split, classifier, input, seeds, accuracy_test, low and high (NaN for one seed), accuracy_validation,
    energy_estimate_nJ.
    """
    rows = []
    for key, part in results.groupby(["set", "split", "classifier", "input"], sort=False):
        assert isinstance(key, tuple)
        found = fronts.interval_of(part["accuracy_test"].to_numpy(), part)
        means = {name: float(part[name].mean()) for name in ("accuracy_validation", "energy_estimate_nJ")}
        rows.append({**dict(zip(("set", "split", "classifier", "input"), key, strict=True)), "seeds": len(part),
                     "accuracy_test": found.mean, "low": found.low, "high": found.high, **means})  # fmt: skip
    return pd.DataFrame(rows)


def answers(results: pd.DataFrame) -> list[str]:
    """One sentence for each set and split: the best network compared with the best classical classifier.

    Validation accuracy decides, for equal ones the least energy; differences are computed seed by seed.
    """
    shown = of_run(results)
    return [_answer(*key, rows) for key, rows in shown.groupby(["set", "split"], sort=False)]  # pyright: ignore


def _answer(name: str, split: str, rows: pd.DataFrame) -> str:
    spikes = rows["classifier"].isin(list(MODELS))
    network, classical = (_best(part) for part in (rows[spikes], rows[~spikes]))
    gained = network.set_index("seed")["accuracy_test"] - classical.set_index("seed")["accuracy_test"]
    found = fronts.interval_of(100 * gained.to_numpy(), network)
    within = f" (95 % interval {found.low:.1f} to {found.high:.1f})" if len(gained) > 1 else " (one seed)"
    verb = "more" if found.mean >= 0 else "fewer"
    return (
        f"{name}, split by {split}: {_words(network)}; {_words(classical)}; the network has {abs(found.mean):.1f} "
        f"points {verb}{within}."
    )


def _best(rows: pd.DataFrame) -> pd.DataFrame:
    means = rows.groupby(["classifier", "input"], sort=False)[["accuracy_validation", "energy_estimate_nJ"]].mean()
    first = means.sort_values(["accuracy_validation", "energy_estimate_nJ"], ascending=[False, True]).index[0]
    return rows[(rows["classifier"] == first[0]) & (rows["input"] == first[1])]


def _words(rows: pd.DataFrame) -> str:
    one, accuracy_test, energy_nJ = rows.iloc[0], 100 * rows["accuracy_test"].mean(), rows["energy_estimate_nJ"].mean()
    return f"{one['classifier']} on {one['input']} has {accuracy_test:.1f} % at {energy_nJ:,.0f} nJ"


def draw(results: pd.DataFrame, arrays: Arrays) -> Iterator[Drawn]:
    """Accuracy of each classifier, a panel per set and split."""
    shown = of_run(results)
    if shown.empty:
        return
    yield Drawn(
        "real-sets",
        "Spiking networks compared with classical classifiers",
        draw_points(points(shown)),
        "Mean test accuracy over seeds with its 95 % interval if there are several, on the same windows and splits. "
        "Spiking networks are filled. LR: logistic regression.",
        "A panel per set and split; a mark per classifier and input; more accurate ones are further right.",
    )


@printed
def draw_points(table: pd.DataFrame) -> Figure:
    """A panel per set and split, a mark per classifier and input; networks are filled.

    table: of `points`.
    """
    panels = list(table[["set", "split"]].drop_duplicates().itertuples(index=False, name=None))
    names = list(dict.fromkeys(zip(table["classifier"], table["input"], strict=True)))
    n_columns = min(COLUMNS, len(panels))
    n_rows = -(-len(panels) // n_columns)
    figure = new_figure(n_rows * (0.9 + 0.18 * len(names)))
    grid = figure.subplots(n_rows, n_columns, sharey=True, squeeze=False)
    for axes, (name, split) in zip(grid.flat, panels, strict=False):
        for row in table[(table["set"] == name) & (table["split"] == split)].itertuples():
            at, is_network = names.index((row.classifier, row.input)), row.classifier in MODELS
            low, high = (np.clip(100 * end, 0, 100) for end in (row.low, row.high))
            axes.plot([low, high], [at, at], color=MUTED, lw=0.8)
            axes.plot(100 * row.accuracy_test, at, "o", ms=4, color=INK, mfc=INK if is_network else "none")
        axes.set(title=f"{name}, by {split}", xlabel="test accuracy (%)")
        axes.grid(axis="x")
    for axes in grid.flat[len(panels) :]:
        axes.remove()
    short = [classifier.replace(LINEAR, "LR") for classifier, _ in names]
    grid[0, 0].set_yticks(
        range(len(names)), [f"{name}, {words}" for name, (_, words) in zip(short, names, strict=True)]
    )
    grid[0, 0].invert_yaxis()
    return figure
