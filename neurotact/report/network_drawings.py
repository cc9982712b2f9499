"""The networks in a report: accuracy, its cost, the trade-off and the best one, and their captions."""

from collections.abc import Iterator, Mapping
from itertools import pairwise
from pathlib import Path

import numpy as np
import pandas as pd

from neurotact.errors import number_of
from neurotact.figures import networks as network_figures
from neurotact.figures.encoding import Classes
from neurotact.figures.networks import Published
from neurotact.figures.style import Drawn
from neurotact.metrics.fronts import pareto_front
from neurotact.networks.use.measuring import OWN_KEYS
from neurotact.report import periods
from neurotact.report.tables import (
    LAST_TRAINING,
    confusion,
    first_member,
    in_the_paper,
    is_last_training,
    kept_epoch,
)
from neurotact.studies.store import cell_folder, result_of
from neurotact.studies.study import Cell, StudySpec
from neurotact.tables import columns_of_network, over_seeds, sized

MOST_LISTED = 4


def network_drawings(
    study: StudySpec,
    folder: Path,
    done: list[Cell],
    results: pd.DataFrame,
    classes: Classes,
    levels: Mapping[str, Mapping[str, float]] = {},
    trials: Mapping[str, int] = {},
) -> Iterator[Drawn]:
    """Accuracy and SOPs (the texture paper's Fig. 11), their trade-off, and the best of the done cells.

    results: a run's `results.csv` with the columns `pair` and `setting`. levels, trials: as for `draw_trade_off`.
    """
    yield _accuracy_and_sops(study, results, len(classes.order))
    yield _trade_off(study, results, levels, trials)
    if done:
        yield from _best_network(folder, done, results, classes)


def rises(networks: pd.DataFrame, measure: str) -> tuple[list[str], int]:
    """The steps between successive pairs at which a measure rises, in words, and the number of all steps.

    >>> rows = {"setting": ["all"] * 3, "pair": ["1&1", "1&5", "5&5"], "hidden": [20] * 3, "sops": [3.0, 2.0, 2.2]}
    >>> rises(pd.DataFrame(rows), "sops")
    (['all, N = 20, 1&5 to 5&5 (+10.0 %)'], 2)
    """
    listed, steps = [], 0
    by = [column for column in columns_of_network(networks) if column != "pair"]
    for (setting, *_), rows in networks.groupby(by, sort=False):
        series = list(zip(rows["pair"], rows[measure], strict=True))
        for (before, low), (after, high) in pairwise(series):
            steps += 1
            if high > low:
                share = f" (+{100 * (high / low - 1):.1f} %)" if low > 0 else ""
                listed.append(f"{setting}, {sized(rows.iloc[0])}, {before} to {after}{share}")
    return listed, steps


def published_points(study: StudySpec, results: pd.DataFrame) -> list[Published]:
    """The published accuracies and SOPs in the study's claims for one pair of one data set."""
    points = []
    for claim in study.claims:
        where = claim.where
        names_one = isinstance(where.get("pair"), str) and set(where) <= {"pair", "dataset", "hidden"}
        if claim.kind != "value" or claim.table != "results" or claim.value is None or not names_one:
            continue
        rows = results[results["pair"] == where["pair"]]
        rows = rows[rows["dataset"] == where["dataset"]] if "dataset" in where else rows
        hidden = where.get("hidden")
        hidden = hidden if isinstance(hidden, int) else None
        points += [Published(s, where["pair"], hidden, claim.measure, claim.value) for s in rows["setting"].unique()]
    return points


def _accuracy_and_sops(study: StudySpec, results: pd.DataFrame, n_classes: int) -> Drawn:
    published = published_points(study, results)
    figure = network_figures.draw_accuracy_and_sops(results, published, 1 / n_classes, periods.axis(study))
    networks = over_seeds(results, ["accuracy_test", "sops_input", "sops_total"])
    best = networks.loc[networks["accuracy_test"].idxmax()]
    diamonds = "; diamonds: published" if published else ""
    of_several = f": mean ± SD over {_seeds(networks)}, single seeds as dots" if networks["seeds"].max() > 1 else ""
    totals = _rise_sentence("Total SOPs", networks, "sops_total")
    inputs = _rise_sentence("SOPs from afferents to hidden neurons", networks, "sops_input")
    caption = (
        f"Test accuracy and synaptic operations (SOPs) by pair and hidden size N{of_several}{diamonds}. {totals} "
        f"{inputs}{in_the_paper(study, 'Fig. 11')}"
    )
    alt = (
        f"Accuracy and SOPs of {number_of(len(networks), 'network')}; the best mean accuracy is "
        f"{100 * best['accuracy_test']:.1f} % "
        f"({best['setting']}, {best['pair']}, {sized(best)})."
    )
    return Drawn("accuracy-and-sops", "Accuracy and its cost", figure, caption, alt)


def _rise_sentence(what: str, networks: pd.DataFrame, measure: str) -> str:
    if networks[measure].isna().any():
        return f"{what} are not counted{'' if networks[measure].isna().all() else ' for every network'}."
    listed_rises, steps = rises(networks, measure)
    if not steps:
        return ""
    if not listed_rises:
        return f"{what} fall, or stay, from each pair to the next."
    more = f"; and {len(listed_rises) - MOST_LISTED} more" if len(listed_rises) > MOST_LISTED else ""
    listed = "; ".join(listed_rises[:MOST_LISTED]) + more
    return f"{what} rise at {len(listed_rises)} of {steps} steps from a pair to the next: {listed}."


def _seeds(networks: pd.DataFrame) -> str:
    low, high = networks["seeds"].min(), networks["seeds"].max()
    return f"{low} to {high} seeds" if low < high else number_of(high, "seed")


def _trade_off(
    study: StudySpec, results: pd.DataFrame, levels: Mapping[str, Mapping[str, float]], trials: Mapping[str, int]
) -> Drawn:
    cost = network_figures.cost_of(results)
    figure = network_figures.draw_trade_off(results, levels, trials, periods.axis(study))
    is_single = "seed" in results and results.groupby(columns_of_network(results)).size().max() == 1
    means = "" if is_single else ", mean over seeds"
    spread = "95 % intervals of the test trials" if is_single and trials else "SD over seeds"
    fronts = {str(name): _front(rows, cost) for name, rows in results.groupby("setting", sort=False)}
    ends = [f"{name}: {_first_to_last(front)}" for name, front in fronts.items() if front]
    lines = (
        "Lines: test accuracy of the classifier without spikes that is best on validation trials, and of guessing. "
        if levels
        else ""
    )
    caption = (
        f"Each point is a pair and a hidden size{means}: filled for the full window, open for early exit as chosen on "
        f"validation trials. Bars: {spread}, for those on the front, which no network beats "
        f"in both accuracy and {cost.name}; numbers on it are hidden sizes. {lines}Networks on the front of "
        f"{'; of '.join(ends)}."
    )
    alt = " ".join(f"Front of {name}, full window: {', '.join(front)}." for name, front in fronts.items())
    return Drawn("trade-off", f"Accuracy against {cost.name}", figure, caption, alt)


def _first_to_last(front: list[str]) -> str:
    return f"{len(front)}, from {front[0]} to {front[-1]}" if len(front) > 1 else f"{front[0]} alone"


def _front(results: pd.DataFrame, cost: network_figures.Spent) -> list[str]:
    """The networks on the Pareto front of the full window, from the cheapest, in words."""
    networks = over_seeds(results, ["accuracy_test", cost.whole]).sort_values(cost.whole, kind="stable")
    front = networks[pareto_front(networks[cost.whole].to_numpy(), networks["accuracy_test"].to_numpy())]
    return [
        f"{row['pair']} {sized(row)} ({100 * row['accuracy_test']:.1f} %, {cost.scale * row[cost.whole]:,.1f} "
        f"{cost.unit})"
        for _, row in front.iterrows()
    ]


def best_of(results: pd.DataFrame) -> int:
    """The row of the answer's best network, and its best seed, both on validation trials.

    Networks are compared by their means over seeds (ties: fewer SOPs).

    >>> rows = {"setting": ["all"] * 3, "pair": ["1&1", "5&5", "5&5"], "hidden": [20] * 3, "seed": [0, 0, 1],
    ...         "accuracy_validation": [0.9, 0.85, 0.95], "sops_total": [300.0, 200.0, 220.0]}
    >>> best_of(pd.DataFrame(rows))
    2
    """
    measures = ["accuracy_validation", "sops_total"]
    means = results.groupby(columns_of_network(results), sort=False)[measures].transform("mean").round(9)
    order = pd.concat([means, results[measures]], axis=1, keys=["network", "seed"])
    by = [("network", "accuracy_validation"), ("network", "sops_total"), ("seed", "accuracy_validation")]
    first = order.reset_index(drop=True).sort_values(by, ascending=[False, True, False], kind="stable").index[0]
    return int(first)


def _best_network(folder: Path, done: list[Cell], results: pd.DataFrame, classes: Classes) -> Iterator[Drawn]:
    """The confusions and the training of the most accurate network on validation trials.

    results: a row for each of `done`.
    """
    best = best_of(results)
    result = result_of(folder, done[best])
    row = result["row"]
    what = f"{row['dataset']}, {row['t_ref_ra_ms']:g}&{row['t_ref_sa_ms']:g}, {sized(row)}, seed {row['seed']}"
    matrix = confusion(result, classes)
    if matrix is not None:
        right = 100 * np.trace(matrix) / max(matrix.sum(), 1)
        caption = (
            f"Test windows of the network with the highest validation accuracy (ties: the fewest "
            f"SOPs; {what}): {right:.1f} % are on the diagonal. {_worst_confusion(matrix, classes)}"
        )
        figure = network_figures.draw_confusion(matrix, classes.ticks, what)
        yield Drawn("confusion", "Confusion matrix", figure, caption, caption)
    log = cell_folder(folder, done[best]) / "training.csv"
    if log.is_file():
        table, kept = pd.read_csv(log), kept_epoch(folder, done[best])
        figure = network_figures.draw_training(first_member(table), kept)
        whose = (
            f"the first of the {row['members']} networks that were joined" if "members" in row else "the same network"
        )
        caption = f"Training of {whose} ({what}). It has the weights of epoch {kept} (dotted line)."
        is_fitted = not (row["hidden"] or OWN_KEYS in row)
        caption += " Without a hidden layer, an epoch is a fit with one penalty." if is_fitted else ""
        caption += f" {LAST_TRAINING}" if is_last_training(folder, done[best]) else ""
        yield Drawn("training", "Training", figure, caption, caption)


def _worst_confusion(matrix: np.ndarray, classes: Classes) -> str:
    wrong = matrix - np.diag(np.diag(matrix))
    if not wrong.sum():
        return "There are no errors."
    true, taken = np.unravel_index(np.argmax(wrong), wrong.shape)
    names = [classes.short[classes.order[i]] for i in (true, taken)]
    return f"Most frequent error: {classes.word} {names[0]} for {names[1]} ({wrong[true, taken]} windows)."
