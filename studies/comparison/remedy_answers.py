"""What remedies against untrained conditions gain, in sentences, in a table and in a figure."""

from collections.abc import Iterator

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from neurotact_parts.studies.comparison.skipped import of_run

from neurotact.figures.style import INK, MUTED, Drawn, add_legend, new_panels, printed
from neurotact.report.wording import count
from neurotact.studies.way import Arrays, Listed

NOTHING, DEFAULT, CEILING = "nothing", "the default", "trained on it"
"""Names of remedies: none of them, all as `own-recordings` chooses, and training on trials of the tested value."""
REACHED = {NOTHING: "with nothing", DEFAULT: "by default"}
"""How sentences name the remedies that they begin with."""
NETWORK = "RSNN"
COLUMNS = 2
"""Columns of panels."""
MEASURES = ["accuracy_test", "accuracy_seen", "validated", "sops_total", "energy_estimate_nJ", "signal_ms"]


def points(results: pd.DataFrame) -> pd.DataFrame:
    """A row for each task, remedy, classifier and input: means over the tested values and over seeds.

    results: rows with tested, value, remedy, classifier, input, seed and `MEASURES`.
    Columns: task (`tested`, without the name of the ceiling), remedy, classifier, input, values (number), `MEASURES`,
    low and high (accuracies at the worst and the best value), gained (accuracy, compared with `NOTHING` at the same
    value and seed; NaN without it), gained_low and gained_high (at the value that gains least and most). Of a single
    value, these ends are NaN.
    """
    by = ["task", "remedy", "classifier", "input"]
    named = results.assign(task=_tasks(results), value=results["value"].astype(str))
    rows = named.groupby([*by, "value", "seed"], sort=False)[MEASURES].mean()
    plain = rows.xs(NOTHING, level="remedy")["accuracy_test"].rename("plain")
    rows = rows.join(plain, on=plain.index.names)
    rows["gained"] = rows["accuracy_test"] - rows["plain"]
    of_values = rows.groupby([*by, "value"], sort=False)[[*MEASURES, "gained"]].mean()  # over seeds
    of_remedies = of_values.groupby(by, sort=False)
    table = of_remedies.mean()
    for name, column in (("", "accuracy_test"), ("gained_", "gained")):
        table[f"{name}low"], table[f"{name}high"] = of_remedies[column].min(), of_remedies[column].max()
    table.loc[of_remedies.size() < 2, ["low", "high", "gained_low", "gained_high"]] = np.nan
    return table.assign(values=of_remedies.size()).reset_index()


def _tasks(results: pd.DataFrame) -> pd.Series:
    return results["tested"].str.removesuffix(f", {CEILING}")


def answers(results: pd.DataFrame) -> list[str]:
    """For each set and condition what is lost, what the remedies gain, and whether an opponent does better."""
    shown = of_run(results)
    if shown.empty:
        return []
    table = points(shown)
    return [_answer(str(task), rows) for task, rows in table.groupby("task", sort=False)]


def _answer(task: str, rows: pd.DataFrame) -> str:
    network = rows[rows["classifier"] == NETWORK].set_index("remedy")
    said = [_lost(network.loc[name], words) for name, words in REACHED.items() if name in network.index]
    alone = network[~network.index.isin([*REACHED, CEILING]) & network["gained"].notna()]
    if len(alone):
        most = alone.sort_values("gained").iloc[-1]
        verb = "gains most" if most["gained"] > 0 else "loses least"
        said.append(f"of {len(alone)} others, '{most.name}' {verb}, {_points(most['gained'])}{_range(most)}")
    rival = best_opponent(rows[rows["remedy"] == DEFAULT])
    if DEFAULT in network.index and rival is not None:
        said.append(_beside(network.loc[DEFAULT], rival))
    if CEILING in network.index:
        said.append(f"trained on such trials, too, the network has {_percent(network.loc[CEILING, 'accuracy_test'])}")
    return f"{task}: {'; '.join(said)}."


def _lost(row: pd.Series, words: str) -> str:
    """What a network reaches at untrained and at trained conditions."""
    share, seen = row["accuracy_test"], row["accuracy_seen"]
    if pd.isna(seen):
        return f"{words} the network has {_percent(share)}"
    lost = f"{_points(seen - share)} are lost" if seen > share else "nothing is lost"
    return (
        f"{words} the network has {_percent(share)} at untrained values and {_percent(seen)} at trained ones ({lost})"
    )


def _beside(network: pd.Series, rival: pd.Series) -> str:
    """The best opponent, compared with the network under the same remedies."""
    more = rival["accuracy_test"] - network["accuracy_test"]
    share = rival["energy_estimate_nJ"] / network["energy_estimate_nJ"]
    verdict = f"{_points(more)} {'more' if more > 0 else 'fewer'}" if more else "as much"
    spent = "at a cost that is not counted" if pd.isna(share) else f"at {count(100 * share)} % of the network's energy"
    return (
        f"of opponents with the same remedies, the best on validation trials, {rival['classifier']} on "
        f"{rival['input']}, has {_percent(rival['accuracy_test'])}, {verdict}, {spent}"
    )


def best_opponent(rows: pd.DataFrame) -> pd.Series | None:
    """The opponent with the highest validation accuracy under one remedy; of equal ones the cheapest.

    rows: of `points`. None without opponents.
    """
    others = rows[rows["classifier"] != NETWORK]
    if others.empty:
        return None
    return others.sort_values(["validated", "energy_estimate_nJ"], ascending=[False, True]).iloc[0]


def _points(share: float) -> str:
    return f"{100 * abs(share):.1f} points"


def _percent(share: float) -> str:
    return f"{100 * share:.1f} %"


def _range(row: pd.Series) -> str:
    """The gain at the value that gains least and at the one that gains most; empty for one value."""
    if row["values"] < 2:
        return ""
    return f" ({100 * row['gained_low']:.1f} to {100 * row['gained_high']:.1f} over {row['values']} values)"


def cautions(results: pd.DataFrame) -> list[str]:
    """What limits the answers, one line each with the remedy."""
    shown = of_run(results)
    if shown.empty:
        return []
    lines = []
    has_condition = shown["condition"].fillna("-").str.strip("-") != ""
    chosen = shown[(shown["classifier"] == NETWORK) & (shown["remedy"] == DEFAULT) & has_condition]
    unranked = [
        str(task) for task, rows in chosen.groupby(_tasks(chosen), sort=False) if not rows["ranked"].astype(bool).all()
    ]
    if unranked:
        lines.append(
            f"{'; '.join(unranked)}: validation cannot leave out a value, so that copies and opponents are chosen on "
            "trained ones; record a third value"
        )
    if shown["seed"].nunique() == 1:
        more = "`settings={'sweep.seed': [0, 1, 2]}`"
        lines.append(f"one seed: another training may differ by several points; give more, as in {more}")
    return lines


def tables(results: pd.DataFrame) -> dict[str, tuple[Listed]]:
    """The remedies of each set and condition, with the best opponent of each."""
    shown = of_run(results)
    if shown.empty:
        return {}
    table = points(shown)
    return {str(task): (_listed(rows),) for task, rows in table.groupby("task", sort=False)}


def _listed(rows: pd.DataFrame) -> Listed:
    network = rows[rows["classifier"] == NETWORK]
    rivals = [best_opponent(rows[rows["remedy"] == remedy]) for remedy in network["remedy"]]
    return Listed(
        "The network under each remedy; in parentheses the worst and the best value of the condition. Points gained: "
        "compared with nothing, at the same value and seed. The best opponent on validation trials has the same "
        "windows, trials and copies.",
        pd.DataFrame(
            {
                "remedy": network["remedy"].to_numpy(),
                **{name: network[name].to_numpy() for name in ("accuracy_test", "low", "high", "accuracy_seen")},
                "points gained": [_signed(gained) for gained in network["gained"]],
                **{name: network[name].to_numpy() for name in ("sops_total", "energy_estimate_nJ", "signal_ms")},
                "best opponent": [_named(rival) for rival in rivals],
            }
        ),
    )


def _signed(gained: float) -> str:
    return "-" if pd.isna(gained) else f"{100 * gained:+.1f}"


def _named(rival: pd.Series | None) -> str:
    return "-" if rival is None else f"{rival['classifier']}: {_percent(rival['accuracy_test'])}"


def draw(results: pd.DataFrame, arrays: Arrays) -> Iterator[Drawn]:
    """The accuracy under each remedy, a panel per set and condition."""
    shown = of_run(results)
    if shown.empty:
        return
    yield Drawn(
        "untrained-conditions",
        "What each remedy gains at untrained conditions",
        draw_points(points(shown)),
        "Test accuracy of the network, means over seeds and values; lines reach from the worst to the best value of "
        "the condition. The best opponent on validation trials has the same windows, trials and copies.",
        "A panel per set and condition; a row per remedy, with a mark for the network at the untrained value, one at "
        "trained values, and one for the best opponent.",
    )


@printed
def draw_points(table: pd.DataFrame) -> Figure:
    """A panel per set and condition, a row per remedy.

    table: of `points`.
    """
    tasks, names = list(table["task"].unique()), list(table["remedy"].unique())
    figure, grid = new_panels(len(tasks), COLUMNS, 0.9 + 0.2 * len(names), sharey=True)
    for axes, task in zip(grid, tasks, strict=True):
        rows = table[table["task"] == task]
        network = rows[rows["classifier"] == NETWORK]
        y = [names.index(remedy) for remedy in network["remedy"]]
        shares = 100 * network["accuracy_test"].to_numpy()
        reach = np.array([shares - 100 * network["low"], 100 * network["high"] - shares])
        axes.errorbar(
            shares,
            y,
            xerr=np.nan_to_num(reach),
            fmt="o",
            color=INK,
            ms=4,
            elinewidth=0.8,
            label="network, untrained value",
        )
        axes.plot(100 * network["accuracy_seen"], y, "|", color=INK, ms=7, label="network, trained values")
        rivals = [best_opponent(rows[rows["remedy"] == remedy]) for remedy in network["remedy"]]
        theirs = [np.nan if rival is None else 100 * rival["accuracy_test"] for rival in rivals]
        axes.plot(theirs, y, "D", color=MUTED, mfc="none", ms=4, label="best opponent, untrained value")
        axes.set(title=task, xlabel="accuracy (%)")
        axes.grid(axis="x")
    grid[0].set_yticks(range(len(names)), names)
    grid[0].set_ylim(len(names) - 0.5, -0.5)
    add_legend(figure, grid, ncols=3)
    return figure
