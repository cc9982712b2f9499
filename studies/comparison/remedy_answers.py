"""What remedies against untrained conditions gain, in sentences, in a table and in a figure."""

from collections.abc import Iterator

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from neurotact_parts.studies.comparison import fronts
from neurotact_parts.studies.comparison.skipped import of_run

from neurotact.errors import number_of
from neurotact.figures.columns import quantity
from neurotact.figures.style import INK, MUTED, Drawn, add_legend, new_panels, printed
from neurotact.metrics.paired import p_in_words
from neurotact.metrics.resampled import sizes_of
from neurotact.report.wording import count
from neurotact.studies.way import Arrays, Listed, Named

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
    Columns: tested, remedy, classifier, input, values (number), `MEASURES`,
    low and high (accuracies at the worst and the best value), gained (accuracy, compared with `NOTHING` at the same
    value and seed; NaN without it), gained_low and gained_high (at the value that gains least and most). Of a single
    value, these ends are NaN.
    """
    by = ["tested", "remedy", "classifier", "input"]
    rows = (
        results.assign(value=results["value"].astype(str)).groupby([*by, "value", "seed"], sort=False)[MEASURES].mean()
    )
    plain = rows[rows.index.get_level_values("remedy") == NOTHING]["accuracy_test"].droplevel("remedy").rename("plain")
    rows = rows.join(plain, on=plain.index.names)
    rows["gained"] = rows["accuracy_test"] - rows["plain"]
    of_values = rows.groupby([*by, "value"], sort=False)[[*MEASURES, "gained"]].mean()  # over seeds
    of_remedies = of_values.groupby(by, sort=False)
    table = of_remedies.mean()
    for name, column in (("", "accuracy_test"), ("gained_", "gained")):
        table[f"{name}low"], table[f"{name}high"] = of_remedies[column].min(), of_remedies[column].max()
    table.loc[of_remedies.size() < 2, ["low", "high", "gained_low", "gained_high"]] = np.nan
    return table.assign(values=of_remedies.size()).reset_index()


def named(results: pd.DataFrame) -> dict[str, Named]:
    """Of each set and condition what the default gains; each remedy and the best opponent are named in the picture."""
    shown = of_run(results)
    if shown.empty:
        return {}
    tasks = shown.groupby("tested", sort=False)
    return {str(task): _named(points(rows), rows) for task, rows in tasks}


def _named(table: pd.DataFrame, results: pd.DataFrame) -> Named:
    network, rival = _under_each(table), best_opponent(table[table["remedy"] == DEFAULT])
    labels = {
        (one.remedy, one.classifier, one.input): f"{one.remedy} {_percent(one.accuracy_test)}"
        if one.classifier == NETWORK
        else ""
        for one in table.itertuples()
        if one.classifier == NETWORK or one.remedy == DEFAULT
    }
    if rival is not None:
        labels[DEFAULT, rival["classifier"], rival["input"]] = f"{_called(rival)} {_percent(rival['accuracy_test'])}"
    return Named(
        _headline(network, rival, results),
        [f"{said[0].upper()}{said[1:]}." for said in _answer(network, rival)],
        dict.fromkeys(("energy_estimate_nJ", "signal_ms"), labels),
        "the network under each remedy, and the best opponent under the default",
    )


def _under_each(table: pd.DataFrame) -> pd.DataFrame:
    """The rows of the network, by remedy."""
    return table[table["classifier"] == NETWORK].set_index("remedy", drop=False)


def _headline(network: pd.DataFrame, rival: pd.Series | None, results: pd.DataFrame) -> str:
    """What the default gains, how sure that is, and what the best opponent and a network trained on the value reach."""
    if unknown := [name for name in REACHED if name not in network.index]:
        first = network.iloc[0]
        reached = f"under '{first['remedy']}' the network has {_percent(first['accuracy_test'])}"
        return f"No gain is known, since '{unknown[0]}' has no results: {reached}."
    rows = results[(results["classifier"] == NETWORK) & (results["remedy"] == DEFAULT)]
    of_both = results[results["classifier"] == NETWORK].pivot_table("accuracy_test", ["split", "seed"], "remedy")
    splits = of_both[[*REACHED]].dropna().groupby("split").mean()
    found = fronts.compared(splits[DEFAULT], splits[NOTHING], sizes_of(rows))
    interval = fronts.interval_of((splits[DEFAULT] - splits[NOTHING]).to_numpy(), rows)
    verdict = "Remedies gain accuracy" if found.difference > 0 else "Remedies cost accuracy"
    sure = "" if pd.notna(interval.low) else f" ({number_of(found.n, 'test trial')}, {p_in_words(found.p)})"
    one, more = network.loc[DEFAULT], "more" if interval.mean >= 0 else "less"
    values = "an untrained value" if len(splits) == 1 else "untrained values"
    where = "" if pd.isna(one["accuracy_seen"]) else f" at {values} of {quantity(str(rows['condition'].iloc[0]))[0]}"
    said = [
        f"{verdict if found.is_clear else 'No clear gain by remedies'}: {DEFAULT} has {_percent(one['accuracy_test'])}"
        f"{where}, {fronts.in_points(interval)} {more} than {NOTHING}{sure}"
    ]
    if rival is not None:
        ratio = rival["energy_estimate_nJ"] / one["energy_estimate_nJ"]
        spent = "" if pd.isna(ratio) else f" for {fronts.times(ratio)} the network's energy"
        said.append(f"{_called(rival)} has {_percent(rival['accuracy_test'])} with the same remedies{spent}")
    if CEILING in network.index:
        said.append(f"trained on such trials, too, the network has {_percent(network.loc[CEILING, 'accuracy_test'])}")
    return f"{'; '.join(said)}."


def _answer(network: pd.DataFrame, rival: pd.Series | None) -> Iterator[str]:
    """What is lost with and without remedies, which gains most alone, and what the best opponent costs."""
    for name in network.index.intersection([*REACHED], sort=False):
        yield _lost(network.loc[name], REACHED[name])
    alone = network[~network.index.isin([*REACHED, CEILING]) & network["gained"].notna()]
    if len(alone):
        most = alone.sort_values("gained").iloc[-1]
        verb = "gains most" if most["gained"] > 0 else "loses least"
        yield f"of {len(alone)} others, '{most.name}' {verb}, {_points(most['gained'])}{_range(most)}"
    if DEFAULT in network.index and rival is not None:
        yield _beside(network.loc[DEFAULT], rival)


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
        f"of opponents with the same remedies, the best on validation trials, {_called(rival)}, has "
        f"{_percent(rival['accuracy_test'])}, {verdict}, {spent}"
    )


def _called(rival: pd.Series) -> str:
    return f"{rival['classifier']} on {rival['input']}"


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
        str(task) for task, rows in chosen.groupby("tested", sort=False) if not rows["ranked"].astype(bool).all()
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
    return {str(task): (_listed(rows),) for task, rows in points(shown).groupby("tested", sort=False)}


def _listed(rows: pd.DataFrame) -> Listed:
    network = _under_each(rows)
    rivals = [best_opponent(rows[rows["remedy"] == remedy]) for remedy in network["remedy"]]
    by_gain = network.sort_values("gained", ascending=False, kind="stable").index
    told = [*network.index.intersection([*REACHED, CEILING]), *by_gain]
    return Listed(
        "The network under each remedy (from the worst to the best value of the condition), points gained over nothing "
        "at the same value and seed, and the best opponent on validation trials.",
        pd.DataFrame(
            {
                "remedy": network["remedy"].to_numpy(),
                **{name: network[name].to_numpy() for name in ("accuracy_test", "low", "high", "accuracy_seen")},
                "points gained": [_signed(gained) for gained in network["gained"]],
                "energy_estimate_nJ": network["energy_estimate_nJ"].to_numpy(),
                "best opponent": [_in_table(rival) for rival in rivals],
            }
        ),
        network.index.get_indexer_for(told).tolist(),
    )


def _signed(gained: float) -> str:
    return "-" if pd.isna(gained) else f"{100 * gained:+.1f}"


def _in_table(rival: pd.Series | None) -> str:
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
    tasks, names = list(table["tested"].unique()), list(table["remedy"].unique())
    figure, grid = new_panels(len(tasks), COLUMNS, 0.9 + 0.2 * len(names), sharey=True)
    for axes, task in zip(grid, tasks, strict=True):
        rows = table[table["tested"] == task]
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
