"""Trained networks on less than their full window: cut short (Figs. 8 and 13), or by early exit (Table V)."""

from collections.abc import Iterator, Sequence
from typing import Annotated, Any

import pandas as pd
import torch
from neurotact_parts.studies.texture import shortened_figures
from pydantic import Field
from torch import Tensor

from neurotact.figures.encoding import Classes
from neurotact.figures.style import Drawn
from neurotact.networks.definition.network import Network
from neurotact.networks.exit.patience import exits, oracle_exit
from neurotact.networks.exit.truncated import SimulatedWindows, judged, simulate_windows
from neurotact.networks.training.tasks import Sides
from neurotact.report.periods import in_ms
from neurotact.studies.measures import Measure
from neurotact.studies.study import LENGTH, StudySpec

PUBLISHED_PATIENCE = 120
"""The patience of the texture paper's Table V, in steps."""


def cut_short(network: Network, windows: SimulatedWindows, cuts_ms: Sequence[float]) -> list[dict[str, Any]]:
    """Accuracy and mean SOPs at each cut within the window; the counts at its last step decide.

    Columns: cut_ms, accuracy_test, and sops_* as in results.csv.
    """
    rows = []
    for cut_ms in cuts_ms:
        n_steps = round(cut_ms * 1e-3 * network.clock_Hz)
        if 1 <= n_steps <= windows.readout.shape[1]:
            until = windows.readout[:, :n_steps]
            chosen = (until.sum(dim=1) if windows.integration is None else windows.integration.of(until)).argmax(dim=1)
            steps = torch.full_like(chosen, n_steps)
            rows.append({"cut_ms": cut_ms, **judged(network, windows, steps, chosen)})
    return rows


def exit_curve(
    network: Network, test: SimulatedWindows, validation: SimulatedWindows, patiences: Sequence[int]
) -> list[dict[str, Any]]:
    """Accuracy, steps and mean SOPs on test windows over patience, in each mode of early exit.

    Columns: mode (`validated`; `oracle`, the texture paper's Algorithm 1; `printed`, the same read to the letter),
    patience in steps, accuracy_validation with the same patience,
    accuracy_test, exit_steps, exit_steps_sd (deviation over windows), exit_steps_right (mean over windows with the
    right label at exit), sops_* as in results.csv; compared with the full window, accuracy_lost, and the shares
    steps_saved and sops_saved. Steps are those of the input's clock; of the patiences, those that are whole steps of
    the network are tried. A patience of the window's length never exits.
    """
    n_bins, n = test.readout.shape[1], network.steps_per_bin
    within = [patience // n for patience in patiences if not patience % n and patience <= n_bins * n]
    (whole,) = cut_short(network, test, [1e3 * n_bins / network.clock_Hz])
    rows = []
    for mode, decide in (("validated", _validated), ("oracle", _oracle), ("printed", _printed)):
        on_test, on_validation = decide(test, within), decide(validation, within)
        for patience, (steps, chosen), (_, decided) in zip(within, on_test, on_validation, strict=True):
            row = judged(network, test, steps, chosen)
            mean = n * float(steps.double().mean())
            rows.append(
                {
                    "mode": mode,
                    "patience": patience * n,
                    "accuracy_validation": _share(decided == validation.labels),
                    "exit_steps": mean,
                    "exit_steps_sd": n * float(steps.double().std(correction=0)),
                    "exit_steps_right": _mean_where(chosen == test.labels, steps * n),
                    **row,
                    "accuracy_lost": whole["accuracy_test"] - row["accuracy_test"],
                    "steps_saved": 1.0 - mean / (n * n_bins),
                    "sops_saved": 1.0 - row["sops_total"] / max(whole["sops_total"], 1.0),
                }
            )
    return rows


def _validated(windows: SimulatedWindows, patiences: Sequence[int]) -> list[tuple[Tensor, Tensor]]:
    """Steps and labels `(window,)` at each patience, counted from the first readout spike."""
    decisions = exits(windows.readout, integration=windows.integration)
    return [(decisions.steps[:, patience - 1], decisions.labels[:, patience - 1]) for patience in patiences]


def _oracle(windows: SimulatedWindows, patiences: Sequence[int]) -> list[tuple[Tensor, Tensor]]:
    """The same by the texture paper's Algorithm 1, which starts at each patience and knows the true labels."""
    return [oracle_exit(windows.readout, windows.labels, patience, windows.integration)[:2] for patience in patiences]


def _printed(windows: SimulatedWindows, patiences: Sequence[int]) -> list[tuple[Tensor, Tensor]]:
    """The same by Algorithm 1 to the letter, whose count is never reset."""
    labels, integration = windows.labels, windows.integration
    return [oracle_exit(windows.readout, labels, p, integration, as_printed=True)[:2] for p in patiences]


def _mean_where(right: Tensor, steps: Tensor) -> float | None:
    return float(steps[right].double().mean()) if right.any() else None


def _share(right: Tensor) -> float:
    return float(right.double().mean())


def panel_of(table: pd.DataFrame) -> pd.Series:
    """The name of each row's panel: data set and pair; sizes share a panel.

    >>> panel_of(pd.DataFrame({"dataset": ["mixed"], "pair": ["5&5"]})).tolist()
    ['mixed, 5&5 ms']
    """
    return table["dataset"] + ", " + table["pair"].map(in_ms)


def _cut_short(study: StudySpec, table: pd.DataFrame) -> Drawn:
    swept = table.get("window.length_ms", study.window.length_ms)
    table = table.assign(panel=panel_of(table), trained_ms=swept)
    figure = shortened_figures.draw_cut_short(table)
    longest = table[table["trained_ms"] == table["trained_ms"].max()]
    whole = table[table["trained_ms"] == table["cut_ms"]]
    words = [
        f"at {cut_ms:g} ms {100 * rows['accuracy_test'].mean():.1f} %, trained on that length "
        f"{100 * whole[whole['cut_ms'] == cut_ms]['accuracy_test'].mean():.1f} %"
        for cut_ms, rows in longest.groupby("cut_ms")
        if (whole["cut_ms"] == cut_ms).any() and cut_ms < longest["cut_ms"].max()
    ]
    caption = (
        "Accuracy and SOPs against the length of the input: means over sizes and seeds. Black: networks trained on "
        "that length, with the deviation over seeds. Dashed: the same networks on the first part of their windows, "
        "decided by the spikes so far. As the texture paper's Figs. 8 and 13, which re-train."
    )
    longest_ms = longest["trained_ms"].max()
    alt = (
        f"Mean accuracy of networks trained on {longest_ms:g} ms and cut short: {'; '.join(words)}."
        if words
        else caption
    )
    return Drawn("cut-short", "Shorter windows, and windows cut short", figure, caption, alt)


def _costs(results: pd.DataFrame) -> Drawn:
    """Networks of the sizes that every pair has, so that lines differ only in their pair."""
    sizes = set.intersection(*(set(rows["hidden"]) for _, rows in results.groupby("pair")))
    results = results[results["hidden"].isin(sizes)] if sizes else results
    means = results.groupby(["pair", LENGTH], sort=False)["accuracy_test"].mean()
    words = [
        f"{in_ms(pair)}, {length_ms:g} ms of input: {100 * mean:.1f} %" for (pair, length_ms), mean in means.items()
    ]
    of = f"{' and '.join(f'{size:g}' for size in sorted(sizes))} hidden neurons" if sizes else "all sizes"
    caption = (
        "Test accuracy against the cost of a decision: afferent spikes, SOPs and window length. A point is "
        f"a window length, with networks trained on it: means over seeds with their deviation, {of}."
    )
    return Drawn("costs", "The cost of each saving", shortened_figures.draw_costs(results), caption, "; ".join(words))


def _exit_curves(study: StudySpec, results: pd.DataFrame, table: pd.DataFrame) -> Drawn:
    table = table.assign(panel=panel_of(table))
    chosen = results.assign(panel=panel_of(results))[["panel", "exit_patience"]].dropna()
    window_ms, window_steps = (
        table.get(LENGTH, study.window.length_ms),
        table["exit_steps"] / (1 - table["steps_saved"]),
    )
    step_ms = float(f"{(window_ms / window_steps).median():.6g}")
    figure = shortened_figures.draw_exit_curves(table, chosen, _published_exits(study, table), step_ms)
    words = [
        f"{panel}, {mode}: {100 * rows['steps_saved'].mean():.1f} % of the time, "
        f"{100 * rows['sops_saved'].mean():.1f} % of the SOPs, {100 * rows['accuracy_lost'].mean():.1f} points lost"
        for (panel, mode), rows in table[table["patience"] == PUBLISHED_PATIENCE].groupby(["panel", "mode"], sort=False)
    ]
    caption = (
        "Losses and savings of early exit on test windows compared with the whole window, and the time of the "
        f"decision, over patience (a step is {step_ms:g} ms): means over networks, the band is their deviation. The "
        "oracle is the texture paper's Algorithm 1, which uses the true label and so never loses accuracy. Dotted: "
        "the patience chosen for each network on validation trials. Diamonds: Table V."
    )
    patience = f"{PUBLISHED_PATIENCE} steps ({step_ms * PUBLISHED_PATIENCE:g} ms)"
    alt = f"Saved at a patience of {patience}: {'; '.join(words)}." if words else caption
    return Drawn("exit-curves", "Early exit over patience", figure, caption, alt)


def _published_exits(study: StudySpec, table: pd.DataFrame) -> pd.DataFrame:
    """Panel, patience and steps of each claim that names the steps of one pair at one patience."""
    rows = []
    for claim in study.claims:
        where = claim.where
        names_one = claim.kind == "value" and claim.measure == "exit_steps" and where.get("mode") == "oracle"
        if claim.table != "exit_curve" or not names_one or claim.value is None:
            continue
        of = table["pair"] == where.get("pair")
        rows += [
            {"panel": panel, "patience": where["patience"], "steps": claim.value}
            for panel in table[of]["panel"].unique()
        ]
    return pd.DataFrame(rows, columns=["panel", "patience", "steps"])


def _shorter(network: Network, sides: Sides, cuts_ms: Sequence[float]) -> list[dict[str, Any]]:
    return cut_short(network, simulate_windows(network, sides.test), cuts_ms)


def _shorter_drawn(study: StudySpec, results: pd.DataFrame, table: pd.DataFrame, classes: Classes) -> Iterator[Drawn]:
    yield _cut_short(study, table)
    if LENGTH in results:
        yield _costs(results)


def _earlier(network: Network, sides: Sides, patiences: Sequence[int]) -> list[dict[str, Any]]:
    test, validation = (simulate_windows(network, side) for side in (sides.test, sides.validation))
    return exit_curve(network, test, validation, patiences)


def _earlier_drawn(study: StudySpec, results: pd.DataFrame, table: pd.DataFrame, classes: Classes) -> Iterator[Drawn]:
    yield _exit_curves(study, results, table)


CUT_SHORT = Measure(
    tuple[Annotated[float, Field(gt=0)], ...],
    "Also test each network on the first part of its own windows, of these lengths: the table cut_short.csv.",
    "cut_short",
    "each network on the first part of its windows",
    of_network=_shorter,
    draw=_shorter_drawn,
)
"""The entry point `cut_short_ms` of the group `neurotact.measures`."""
EXIT_CURVE = Measure(
    tuple[Annotated[int, Field(ge=1)], ...],
    "Also test each network with early exit at these patiences, in both modes: the table exit_curve.csv.",
    "exit_curve",
    "each network with early exit, over patience",
    of_network=_earlier,
    draw=_earlier_drawn,
)
"""The entry point `exit_patiences` of the group `neurotact.measures`."""
