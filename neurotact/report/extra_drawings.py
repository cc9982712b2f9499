"""Figures and captions of the tables that only some studies have."""

from collections.abc import Iterator, Mapping

import pandas as pd

from neurotact.figures import conditions as condition_figures
from neurotact.figures import truncated as shortened_figures
from neurotact.figures.columns import in_unit
from neurotact.figures.encoding import Classes
from neurotact.figures.style import Drawn
from neurotact.report.periods import in_ms
from neurotact.studies.study import LENGTH, StudySpec


def extra_drawings(
    study: StudySpec, results: pd.DataFrame, extra: Mapping[str, pd.DataFrame], classes: Classes
) -> Iterator[Drawn]:
    """A figure for each of these tables that exists.

    results: a run's `results.csv` with the columns `pair` and `setting`. extra: the tables by name, with `pair`.
    """
    if "cut_short" in extra:
        yield _cut_short(study, extra["cut_short"])
        if LENGTH in results:
            yield _costs(results)
    if "exit_curve" in extra:
        yield _exit_curves(study, results, extra["exit_curve"])
    if "conditions" in extra:
        yield _conditions(study, extra["conditions"])
    if "signals" in extra and "expected_Hz" in extra["signals"]:
        yield _signals(extra["signals"], classes)
    if "same_drive" in extra:
        yield _same_drive(study, extra["same_drive"])


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


PUBLISHED_PATIENCE = 120
"""The patience of the texture paper's Table V, in steps."""


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


def _conditions(study: StudySpec, table: pd.DataFrame) -> Drawn:
    by = [name for name in study.dataset.stratify if name in table]
    conditions = [", ".join(in_unit(name, row[name]) for name in by) for _, row in table.iterrows()]
    table = table.assign(condition=conditions)
    figure = condition_figures.draw_conditions(table)
    means = table.groupby(["dataset", "known"], sort=False)["accuracy_test"].mean()
    words = [
        f"{dataset}: {100 * mean:.1f} % on {'known' if known else 'unknown'} conditions"
        for (dataset, known), mean in means.items()
    ]
    caption = (
        "Accuracy on the test trials of each condition, by the training set of the networks: means over pairs, sizes "
        "and seeds. Outlined and bold: conditions without a trial in training or validation."
    )
    return Drawn("conditions", "Known and unknown conditions", figure, caption, f"Mean accuracy: {'; '.join(words)}.")


def _signals(table: pd.DataFrame, classes: Classes) -> Drawn:
    names = [classes.short[label] for label in table.sort_values("grating")["label"].unique()]
    figure = condition_figures.draw_signals(table, names)
    peaks = ", ".join(
        f"{mean:.1f} mV at {force:g} N" for force, mean in table.groupby("force_N")["peak_mV"].mean().items()
    )
    off_Hz = (table["principal_Hz"] - table["expected_Hz"]).abs().max()
    caption = (
        "Left: highest magnitude on the strongest taxel, mean over trials and speeds, as the texture paper's Fig. 12. "
        "Right: the highest line of its spectrum, and speed / (pitch + 1 mm), the frequency of the ridges: at most "
        f"{off_Hz:.2f} Hz apart. Signals are conditioned as for the afferents."
    )
    low, high = table["principal_Hz"].min(), table["principal_Hz"].max()
    alt = f"Mean peak {peaks}; principal frequencies from {low:.1f} to {high:.1f} Hz."
    return Drawn("signals", "Amplitude and principal frequency", figure, caption, alt)


def _same_drive(study: StudySpec, table: pd.DataFrame) -> Drawn:
    published = [
        (float(claim.where["t_ref_ms"]), claim.value)
        for claim in study.claims
        if claim.table == "same_drive"
        and claim.kind == "value"
        and claim.value is not None
        and "t_ref_ms" in claim.where
    ]
    figure = condition_figures.draw_same_drive(table, sorted(set(published)))
    seconds = study.same_drive.duration_s if study.same_drive else 0.0
    caption = (
        f"Spikes of one SA-I afferent in {seconds:g} s over its refractory period. Each drive is scaled until it fires "
        "as often as published at the first period; the paper shows neither the drive nor its duration. Recorded: the "
        "strongest taxel in the strongest trials of each class. As the texture paper's Fig. 4."
    )
    words = [
        f"{' '.join(filter(None, (str(drive), str(label))))}: " + ", ".join(f"{value:.1f}" for value in rows["spikes"])
        for (drive, label), rows in table.fillna("").groupby(["drive", "label"], sort=False)
    ]
    return Drawn("same-drive", "The same drive at other refractory periods", figure, caption, "; ".join(words) + ".")
