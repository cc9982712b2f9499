"""The ways to save on the Pareto front of accuracy and a cost, and the accuracy lost by each if it halves a cost."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import pandas as pd

from neurotact.metrics.fronts import pareto_front
from neurotact.metrics.resampled import DIFFERENCES, LEAST_SPLITS, SHARES, Interval, resampled_interval, sizes_of
from neurotact.metrics.shares import wilson_interval
from neurotact.networks.training.cautions import FEW_PER_CLASS
from neurotact.studies.protocol import Listed

NOTHING = "nothing saved"
REFRACTORY = "refractory period"
LONGEST_STEPS = "longest steps"
LONGEST = f"{REFRACTORY}, {LONGEST_STEPS}"
PERIODS = (REFRACTORY, LONGEST)
"""The ways of a refractory period: with the network's clock of the recipe, and with the slowest that it allows."""
HALF = 0.5
SOPS, ENERGY, SIGNAL = "sops_total", "energy_estimate_nJ", "signal_ms"
EVENTS = "events"
"""In the column `afferents` of results: there are none."""


class Cost(NamedTuple):
    """What a cost of a decision is called: in a sentence, after a number and as the head of a column, on an axis."""

    called: str
    unit: str
    axis: str


COSTS = {
    SOPS: Cost("SOPs", "SOPs", "SOPs per window"),
    ENERGY: Cost("energy", "nJ", "energy estimate (nJ)"),
    SIGNAL: Cost("time", "ms", "signal (ms)"),
}
"""The costs of a decision, by their columns."""
ANSWERED = (SOPS, ENERGY)
"""Those of which half is saved in a sentence of their own."""


def fronts(results: pd.DataFrame, cost: str = SOPS) -> pd.DataFrame:
    """A row for each set, way and setting: means over seeds, intervals, and whether it is on the Pareto fronts.

    results: rows with set, way, setting, seed, n_train, n_test, both accuracies, and the columns of `COSTS`. cost: the
        one of these for the fronts.
    Columns: low, high (95 % interval of the accuracy, NaN for one or two seeds); share (of the SOPs of `NOTHING`);
    on_own_front (no point of its way, nor `NOTHING`, dominates it) and on_front (no point of the set dominates it).
    """
    parts = []
    for name, rows in results.groupby("set", sort=False):
        base = rows[rows["way"] == NOTHING]
        points = [_point(key, part, base) for key, part in rows.groupby(["way", "setting"], sort=False)]
        table = pd.DataFrame(points)
        table.insert(0, "set", name)
        table["on_front"] = _on_front(table, cost)
        table["on_own_front"] = np.concatenate([_own_front(table, way, cost) for way in table["way"].unique()])
        parts.append(table)
    return pd.concat(parts, ignore_index=True) if parts else pd.DataFrame()


def _own_front(table: pd.DataFrame, way: str, cost: str) -> np.ndarray:
    """The points of a way that neither its other points nor the network that saves nothing dominate, `(point,)`."""
    mine = (table["way"] == way).to_numpy()
    compared = mine | (table["way"] == NOTHING).to_numpy()
    return _on_front(table[compared], cost)[mine[compared]]


def _on_front(table: pd.DataFrame, cost: str, score: str = "accuracy_test") -> np.ndarray:
    return pareto_front(table[cost].to_numpy(), table[score].to_numpy())


def _point(key: object, part: pd.DataFrame, base: pd.DataFrame) -> dict:
    way, setting = key  # pyright: ignore[reportGeneralTypeIssues]
    interval = interval_of(part["accuracy_test"].to_numpy(), part, SHARES)
    means = {name: float(part[name].mean()) for name in ("accuracy_validation", *COSTS)}
    return {"way": way, "setting": setting, "seeds": len(part), "accuracy_test": interval.mean, "low": interval.low,
            "high": interval.high, **means, "share": _share(part, base)}  # fmt: skip


def interval_of(values: np.ndarray, rows: pd.DataFrame, within: tuple[float, float] = DIFFERENCES) -> Interval:
    """The mean over splits with its interval, as of `resampled_interval`; rows: as of `sizes_of`."""
    n_train, n_test, trials = sizes_of(rows)
    return resampled_interval(values, n_train, n_test, within=within, trials=trials)


class Halved(NamedTuple):
    """A way that halves a cost.

    share: of the cost of `NOTHING`. lost: the accuracy that each seed loses compared with `NOTHING`, `(seed,)`.
    """

    way: str
    setting: str
    share: float
    accuracy_validation: float
    lost: np.ndarray
    rows: pd.DataFrame


def halved(results: pd.DataFrame, share: float = HALF, cost: str = SOPS) -> list[Halved]:
    """For each way, the setting with the best validation accuracy among those with at most this share of the cost.

    results: rows of one set. cost: a key of `COSTS`. The first of the list is the way with the best validation
    accuracy; of equal ones, the one with the lowest cost. Ways that never save as much are left out. No choice depends
    on test accuracy.
    """
    base = results[results["way"] == NOTHING]
    before = base.set_index("seed")["accuracy_test"]
    ways = []
    for way, rows in results[results["way"] != NOTHING].groupby("way", sort=False):
        enough = [part for _, part in rows.groupby("setting", sort=False) if _share(part, base, cost) <= share]
        if enough:
            best = max(enough, key=lambda part: (part["accuracy_validation"].mean(), -part[cost].mean()))
            mine = best.set_index("seed")
            seeds = [seed for seed in before.index if seed in mine.index]
            lost = (before.loc[seeds] - mine.loc[seeds, "accuracy_test"]).to_numpy()
            validation = float(best["accuracy_validation"].mean())
            setting, left = str(best["setting"].iloc[0]), _share(best, base, cost)
            ways.append(Halved(str(way), setting, left, validation, lost, best))
    return sorted(ways, key=lambda way_: (-way_.accuracy_validation, way_.share))


def _share(part: pd.DataFrame, base: pd.DataFrame, cost: str = SOPS) -> float:
    """The share of a cost of the network that saves nothing, over the same seeds; NaN without such a network."""
    return float(part[cost].mean() / base.loc[base["seed"].isin(part["seed"]), cost].mean())


def tables(results: pd.DataFrame) -> dict[str, tuple[Listed, Listed]]:
    """Of each set by its name: the Pareto front from the best network down, and what half of each cost costs."""
    return {str(name): (_listed(rows), _halves(rows)) for name, rows in results.groupby("set", sort=False)}


def _halves(rows: pd.DataFrame) -> Listed:
    """The setting and the accuracy lost of each way that halves a cost, a column per cost of `COSTS`."""
    found = {cost: {half.way: half for half in halved(rows, cost=cost)} for cost in COSTS}
    ways = [way for way in rows["way"].unique() if any(way in halves for halves in found.values())]
    within = ", with their 95 % interval from the differences of the seeds," if has_intervals(rows) else ""
    return Listed(
        f"What it costs to save half, way by way: the points of accuracy that are lost{within} and the share that is "
        "left of the cost. Validation accuracy chooses the setting. Ways that never save half of any cost are left "
        "out.",
        pd.DataFrame(
            {
                "way": ways,
                **{
                    f"half of the {COSTS[cost].unit}": [_half_in_words(halves.get(way)) for way in ways]
                    for cost, halves in found.items()
                },
            }
        ),
    )


def has_intervals(rows: pd.DataFrame) -> bool:
    """Whether there are enough seeds for an interval of their mean."""
    return rows["seed"].nunique() >= LEAST_SPLITS


def _half_in_words(half: Halved | None) -> str:
    if half is None:
        return "-"
    interval = interval_of(half.lost, half.rows)
    within = "" if np.isnan(interval.low) else f" ({100 * interval.low:.1f} to {100 * interval.high:.1f})"
    return f"{_bare(half.setting)}: {100 * interval.mean:.1f} points{within}, {_percent(half.share)} left"


def _listed(rows: pd.DataFrame) -> Listed:
    """The network that saves nothing, then the settings on the Pareto front of one of `COSTS`.

    Validation accuracy decides the fronts and the order. Settings that are not above guessing are left out, and so are
    settings with the same accuracies and costs as another.
    """
    points = fronts(rows)
    on_front = {cost: _on_front(points, cost, "accuracy_validation") for cost in COSTS}
    points["front"] = [
        ", ".join(called.unit for cost, called in COSTS.items() if on_front[cost][row]) for row in range(len(points))
    ]
    points["is_base"] = points["way"] == NOTHING
    shown = points[points["is_base"] | ((points["front"] != "") & (points["accuracy_validation"] > _guess(rows)))]
    shown = shown.sort_values(
        ["is_base", "accuracy_validation", SOPS], ascending=[False, False, True], kind="stable"
    ).drop_duplicates(["accuracy_validation", "accuracy_test", *COSTS])
    return Listed(
        "The front, from the best network down: no other setting has both a higher validation accuracy and fewer SOPs, "
        "a lower energy (nJ, an estimate) or a shorter signal (ms). The accuracy is that of the test windows.",
        pd.DataFrame(
            {
                "how it is reached": [_point_name(*key) for key in zip(shown["way"], shown["setting"], strict=True)],
                **{name: shown[name].to_numpy() for name in ("accuracy_test", "low", "high")},
                **{called.unit: shown[cost].to_numpy() for cost, called in COSTS.items()},
                "on the front of": shown["front"].to_numpy(),
            }
        ),
    )


def _point_name(way: str, setting: str) -> str:
    """
    >>> _point_name("pruning, trained on", "50 % of the weights, trained on"), _point_name(NOTHING, "-")
    ('pruning, trained on: 50 % of the weights', 'nothing saved')
    """
    return way if way == NOTHING else f"{way}: {_bare(setting)}"


def _bare(setting: str) -> str:
    """A setting without the words that the name of its way already contains."""
    return setting.removesuffix(", trained on").removesuffix(f", {LONGEST_STEPS}")


def _guess(rows: pd.DataFrame) -> float:
    """The accuracy of guessing; 0 if a run of an earlier version does not contain it."""
    return float(rows["chance"].mean()) if "chance" in rows and rows["chance"].notna().all() else 0.0


def cautions(results: pd.DataFrame) -> list[str]:
    """What limits the answers of some sets, one line each with the remedy."""
    several = results["set"].nunique() > 1
    return [
        f"{name}: {line}" if several else line
        for name, rows in results.groupby("set", sort=False)
        for line in _cautions_of(rows)
    ]


def _cautions_of(rows: pd.DataFrame) -> Iterator[str]:
    base = rows[rows["way"] == NOTHING]
    if base.empty:
        return
    learned = _not_learned(base)
    if learned:
        windows = "`settings={'window.length_ms': ..., 'window.align': 'onset'}`"
        yield f"{learned}; give more trials, or windows that contain the touch ({windows})"
    seeds = base["seed"].nunique()
    if seeds < LEAST_SPLITS:
        yield (
            f"{in_seeds(seeds)}, so there is no interval: another split may reverse the answer; give "
            f"`repeats={LEAST_SPLITS}` or more"
        )
    if "least_test_trials" in base and base["least_test_trials"].min() < FEW_PER_CLASS:
        least, trials = int(base["least_test_trials"].min()), int(base["test_trials"].min())
        yield (
            f"a seed tests {trials} trials, {least} of the rarest class: one trial is {100 / trials:.1f} points of "
            "accuracy, and smaller differences mean nothing; record more"
        )


def _not_learned(base: pd.DataFrame) -> str:
    """A statement that the network that saves nothing is no better than guessing; empty if it is better."""
    if "test_trials" not in base or base["test_trials"].isna().any():
        return ""
    accuracy, guess = float(base["accuracy_test"].mean()), _guess(base)
    low, high = wilson_interval(accuracy, int(base["test_trials"].mean()))
    if low > guess:
        return ""
    return (
        f"the network that saves nothing is right in {_percent(accuracy)} of the test windows (95 % interval "
        f"{100 * low:.0f} to {100 * high:.0f} %), which guessing reaches too ({_percent(guess)})"
    )


def answers(results: pd.DataFrame, share: float = HALF) -> list[str]:
    """Two sentences for each set: the cost of halving SOPs and energy in the best way, and with refractory periods.

    The set is named if there are several. Where nothing was learned, there is one sentence.
    """
    several = results["set"].nunique() > 1
    sentences = []
    for name, rows in results.groupby("set", sort=False):
        if unfit := _unfit(rows):
            sentences.append(f"{name}: {unfit}" if several else _capital(unfit))
            continue
        for cost in ANSWERED:
            called = COSTS[cost].called
            heads = [str(name)] * several + [called if several else _capital(called)] * (cost != SOPS)
            text = _answer(rows, share, cost)
            sentences.append(f"{', '.join(heads)}: {text}" if heads else _capital(text))
    return sentences


def _capital(text: str) -> str:
    return text[0].upper() + text[1:]


def _unfit(rows: pd.DataFrame) -> str:
    """Why nothing can be said of a set; empty if something can."""
    base = rows[rows["way"] == NOTHING]
    if base.empty:
        return "nothing to compare with, since no network without savings was trained."
    if unlearned := _not_learned(base):
        return f"nothing was learned, so no saving means anything: {unlearned}."
    return ""


def _answer(rows: pd.DataFrame, share: float, cost: str) -> str:
    base = rows[rows["way"] == NOTHING]
    ways, called = halved(rows, share, cost), COSTS[cost].called
    head = (
        f"a network that saves nothing has {_percent(base['accuracy_test'].mean())} at {base[cost].mean():,.0f} "
        f"{COSTS[cost].unit}{afferents_in_words(base) if cost == ENERGY else ''}; "
    )
    of_them = "of them" if cost == SOPS else "of it"
    if not ways:
        return f"{head}no way that was tried saves {_percent(1 - share)} {of_them}."
    best = ways[0]
    refractory = next((half for half in ways if half.way in PERIODS), None)
    rival = next((half for half in ways if half.way not in PERIODS), None)
    sentence = (
        f"{_verdict(refractory, rival)}; {head}to save at least {_percent(1 - share)} {of_them}, {_costs(best, called)}"
    )
    if refractory is None:
        return f"{sentence}, and {_too_little(rows, base, cost)}."
    if refractory is best:
        other = f", and {_costs(rival, called)}" if rival else ""
        return f"{sentence}{other}."
    more = _words(refractory.lost - best.lost, refractory.rows, "more", "less")
    return f"{sentence}, and {_costs(refractory, called)}, {more} than {best.way}."


def afferents_in_words(rows: pd.DataFrame) -> str:
    """When the afferents of a set are computed; empty for events, and for a run that does not say it."""
    said = str(rows["afferents"].iloc[0]) if "afferents" in rows else EVENTS
    return "" if said == EVENTS else f", with afferents computed {said}"


def _verdict(refractory: Halved | None, rival: Halved | None) -> str:
    """How a refractory period compares with the best of the other ways, by the interval of their difference."""
    if refractory is None:
        return "a refractory period saves too little"
    if rival is None:
        return "a refractory period alone saves enough"
    more = interval_of(refractory.lost - rival.lost, refractory.rows)
    if np.isnan(more.low):
        return f"{in_seeds(len(refractory.lost))} cannot tell whether a refractory period is cheapest"
    if more.low > 0:
        return "a refractory period is not the cheapest way"
    return (
        "a refractory period is the cheapest way"
        if more.high < 0
        else "no clear difference between a refractory period and the best other way"
    )


def _costs(half: Halved, called: str) -> str:
    verb = "costs" if half.lost.mean() >= 0 else "gains"
    name = f"a {_period(half.way, half.setting)}" if half.way in PERIODS else f"{half.way} ({_bare(half.setting)})"
    return f"{name} {verb} {_points(half.lost, half.rows)} at {_percent(half.share)} of the {called}"


def _period(way: str, setting: str) -> str:
    """
    >>> _period(LONGEST, "5 & 5 ms, longest steps")
    'refractory period of 5 & 5 ms with the longest steps'
    """
    return f"{REFRACTORY} of {_bare(setting)}{f' with the {LONGEST_STEPS}' if way == LONGEST else ''}"


def _too_little(rows: pd.DataFrame, base: pd.DataFrame, cost: str) -> str:
    """The result of the refractory period that saves most, if none saves enough."""
    mine = [part for _, part in rows[rows["way"].isin(PERIODS)].groupby(["way", "setting"], sort=False)]
    if not mine:
        return "no refractory period was tried"
    most = min(mine, key=lambda part: part[cost].mean())
    lost = (base.set_index("seed")["accuracy_test"] - most.set_index("seed")["accuracy_test"]).dropna().to_numpy()
    verb = "costs" if lost.mean() >= 0 else "gains"
    setting, share = _bare(str(most["setting"].iloc[0])), _percent(_share(most, base, cost))
    return (
        f"no refractory period that was tried saves as much: {setting} {verb} {_points(lost, most)} at {share} of the "
        f"{COSTS[cost].called}"
    )


def _points(lost: np.ndarray, rows: pd.DataFrame) -> str:
    """Points of accuracy that are lost or gained, with the interval of this loss or gain, or its number of seeds."""
    mean, low, high = interval_of(lost, rows)
    text = f"{100 * abs(mean):.1f} points"
    if np.isnan(low):
        return f"{text} ({in_seeds(len(lost))})"
    ends = sorted((100 if mean >= 0 else -100) * end for end in (low, high))
    return f"{text} (95 % interval {ends[0]:.1f} to {ends[1]:.1f})"


def in_seeds(n: int) -> str:
    """
    >>> in_seeds(1), in_seeds(2)
    ('one seed', '2 seeds')
    """
    return "one seed" if n == 1 else f"{n} seeds"


def _words(lost: np.ndarray, rows: pd.DataFrame, more: str, less: str) -> str:
    return f"{_points(lost, rows)} {more if lost.mean() >= 0 else less}"


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %" if round(100 * share, 1) == round(100 * share) else f"{100 * share:.1f} %"
