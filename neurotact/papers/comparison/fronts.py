"""The ways to save on the Pareto front of accuracy and a cost, and the accuracy lost by each if it halves the SOPs."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import pandas as pd

from neurotact.metrics.fronts import pareto_front
from neurotact.metrics.resampled import Interval, resampled_interval
from neurotact.metrics.shares import wilson_interval
from neurotact.networks.training.cautions import FEW_PER_CLASS
from neurotact.studies.protocol import Listed

NOTHING = "nothing saved"
REFRACTORY = "refractory period"
HALF = 0.5
COSTS = {"sops_total": "SOPs per window", "energy_estimate_nJ": "energy estimate (nJ)", "signal_ms": "signal (ms)"}
"""The costs of a decision, with their axis labels."""
SHORT = {"sops_total": "SOPs", "energy_estimate_nJ": "nJ", "signal_ms": "ms"}
ENOUGH_SEEDS = 3


def fronts(results: pd.DataFrame, cost: str = "sops_total") -> pd.DataFrame:
    """A row for each set, way and setting: means over seeds, intervals, and whether it is on the Pareto fronts.

    results: rows with set, way, setting, seed, n_train, n_test, both accuracies, sops_total, energy_estimate_nJ and
        signal_ms. cost: the key of `COSTS` for the fronts.
    Columns: low, high (95 % interval of the accuracy, NaN for one seed); share (of the SOPs of `NOTHING`); on_own_front
    (no point of its way, nor `NOTHING`, dominates it) and on_front (no point of the set dominates it).
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
    interval = interval_of(part["accuracy_test"].to_numpy(), part)
    measures = ("accuracy_validation", "sops_total", "energy_estimate_nJ", "signal_ms")
    means = {name: float(part[name].mean()) for name in measures}
    return {"way": way, "setting": setting, "seeds": len(part), "accuracy_test": interval.mean, "low": interval.low,
            "high": interval.high, **means, "share": _share(part, base)}  # fmt: skip


def interval_of(values: np.ndarray, rows: pd.DataFrame) -> Interval:
    """The mean over splits with its interval; for one split, the bounds are NaN."""
    if len(values) < 2:
        return Interval(float(np.mean(values)), float("nan"), float("nan"))
    return resampled_interval(values, int(rows["n_train"].iloc[0]), int(rows["n_test"].iloc[0]))


class Halved(NamedTuple):
    """The cost of a way that halves the SOPs: the accuracy that each seed loses compared with `NOTHING`, `(seed,)`."""

    way: str
    setting: str
    share: float
    accuracy_validation: float
    lost: np.ndarray
    rows: pd.DataFrame


def halved(results: pd.DataFrame, share: float = HALF) -> list[Halved]:
    """For each way, the setting with the best validation accuracy among those with at most this share of the SOPs.

    results: rows of one set. The first of the list is the way with the best validation accuracy; of equal ones, the
    one with the fewest SOPs. Ways that never save as much are left out. No choice depends on test accuracy.
    """
    base = results[results["way"] == NOTHING]
    before = base.set_index("seed")["accuracy_test"]
    ways = []
    for way, rows in results[results["way"] != NOTHING].groupby("way", sort=False):
        enough = [part for _, part in rows.groupby("setting", sort=False) if _share(part, base) <= share]
        if enough:
            best = max(enough, key=lambda part: (part["accuracy_validation"].mean(), -part["sops_total"].mean()))
            mine = best.set_index("seed")
            seeds = [seed for seed in before.index if seed in mine.index]
            lost = (before.loc[seeds] - mine.loc[seeds, "accuracy_test"]).to_numpy()
            validation = float(best["accuracy_validation"].mean())
            ways.append(Halved(str(way), str(best["setting"].iloc[0]), _share(best, base), validation, lost, best))
    return sorted(ways, key=lambda way_: (-way_.accuracy_validation, way_.share))


def _share(part: pd.DataFrame, base: pd.DataFrame) -> float:
    """The share of the SOPs of the network that saves nothing, over the same seeds; NaN without such a network."""
    return float(part["sops_total"].mean() / base.loc[base["seed"].isin(part["seed"]), "sops_total"].mean())


def tables(results: pd.DataFrame) -> dict[str, Listed]:
    """The Pareto front of each set by its name, from the best network down."""
    return {str(name): _listed(rows) for name, rows in results.groupby("set", sort=False)}


def _listed(rows: pd.DataFrame) -> Listed:
    """The network that saves nothing, then the settings on the Pareto front of one of `COSTS`.

    Validation accuracy decides the fronts and the order. Settings that are not above guessing are left out, and so are
    settings with the same accuracies and costs as another.
    """
    points = fronts(rows)
    on_front = {cost: _on_front(points, cost, "accuracy_validation") for cost in COSTS}
    points["front"] = [", ".join(SHORT[cost] for cost in COSTS if on_front[cost][row]) for row in range(len(points))]
    points["is_base"] = points["way"] == NOTHING
    shown = points[points["is_base"] | ((points["front"] != "") & (points["accuracy_validation"] > _guess(rows)))]
    shown = shown.sort_values(
        ["is_base", "accuracy_validation", "sops_total"], ascending=[False, False, True], kind="stable"
    ).drop_duplicates(["accuracy_validation", "accuracy_test", *COSTS])
    return Listed(
        "The front, from the best network down: no other setting has both a higher validation accuracy and fewer SOPs, "
        "a lower energy (nJ, an estimate) or a shorter signal (ms). The accuracy is that of the test windows.",
        pd.DataFrame(
            {
                "how it is reached": [_point_name(*key) for key in zip(shown["way"], shown["setting"], strict=True)],
                **{name: shown[name].to_numpy() for name in ("accuracy_test", "low", "high")},
                **{SHORT[cost]: shown[cost].to_numpy() for cost in COSTS},
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
    return setting.removesuffix(", trained on")


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
    if seeds < ENOUGH_SEEDS:
        reason = "one seed, so there is no interval" if seeds == 1 else f"{seeds} seeds, so intervals are wide"
        yield f"{reason}: another split may reverse the answer; give `repeats={ENOUGH_SEEDS}` or more"
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
    """One sentence for each set: the cost of halving the SOPs in the best way, and with refractory periods.

    The set is named if there are several.
    """
    several = results["set"].nunique() > 1
    sentences = {str(name): _answer(rows, share) for name, rows in results.groupby("set", sort=False)}
    return [f"{name}: {text}" if several else text[0].upper() + text[1:] for name, text in sentences.items()]


def _answer(rows: pd.DataFrame, share: float) -> str:
    base = rows[rows["way"] == NOTHING]
    if base.empty:
        return "nothing to compare with, since no network without savings was trained."
    if unlearned := _not_learned(base):
        return f"nothing was learned, so no saving means anything: {unlearned}."
    ways = halved(rows, share)
    head = (
        f"a network that saves nothing has {_percent(base['accuracy_test'].mean())} at "
        f"{base['sops_total'].mean():,.0f} SOPs; "
    )
    if not ways:
        return f"{head}no way that was tried saves {_percent(1 - share)} of them."
    best = ways[0]
    refractory = next((half for half in ways if half.way == REFRACTORY), None)
    rival = next((half for half in ways if half.way != REFRACTORY), None)
    sentence = f"{_verdict(refractory, rival)}; {head}to save at least {_percent(1 - share)} of them, {_costs(best)}"
    if refractory is None:
        return f"{sentence}, and {_too_little(rows, base)}."
    if refractory is best:
        other = f", and {_costs(rival)}" if rival else ""
        return f"{sentence}{other}."
    more = _words(interval_of(refractory.lost - best.lost, refractory.rows), "more", "less")
    return f"{sentence}, and {_costs(refractory)}, {more} than {best.way}."


def _verdict(refractory: Halved | None, rival: Halved | None) -> str:
    """How a refractory period compares with the best of the other ways, by the interval of their difference."""
    if refractory is None:
        return "a refractory period saves too little"
    if rival is None:
        return "a refractory period alone saves enough"
    more = interval_of(refractory.lost - rival.lost, refractory.rows)
    if np.isnan(more.low):
        return "one seed cannot tell whether a refractory period is cheapest"
    if more.low > 0:
        return "a refractory period is not the cheapest way"
    return (
        "a refractory period is the cheapest way"
        if more.high < 0
        else "no clear difference between a refractory period and the best other way"
    )


def _costs(half: Halved) -> str:
    interval = interval_of(half.lost, half.rows)
    verb = "costs" if interval.mean >= 0 else "gains"
    name = f"a {half.way} of {half.setting}" if half.way == REFRACTORY else f"{half.way} ({_bare(half.setting)})"
    return f"{name} {verb} {_points(interval)} at {_percent(half.share)} of the SOPs"


def _too_little(rows: pd.DataFrame, base: pd.DataFrame) -> str:
    """The result of the refractory period that saves most, if none saves enough."""
    mine = [part for _, part in rows[rows["way"] == REFRACTORY].groupby("setting", sort=False)]
    if not mine:
        return "no refractory period was tried"
    most = min(mine, key=lambda part: part["sops_total"].mean())
    lost = base.set_index("seed")["accuracy_test"] - most.set_index("seed")["accuracy_test"]
    interval = interval_of(lost.dropna().to_numpy(), most)
    verb = "costs" if interval.mean >= 0 else "gains"
    share = _share(most, base)
    return (
        f"no refractory period that was tried saves as much: {most['setting'].iloc[0]} {verb} {_points(interval)} at "
        f"{_percent(share)} of the SOPs"
    )


def _points(interval: Interval) -> str:
    """Points of accuracy that are lost or gained, with the interval of this loss or gain, at most 100 points."""
    text = f"{100 * abs(interval.mean):.1f} points"
    if np.isnan(interval.low):
        return f"{text} (one seed)"
    low, high = np.clip([interval.low, interval.high], -1, 1) * (100 if interval.mean >= 0 else -100)
    return f"{text} (95 % interval {min(low, high):.1f} to {max(low, high):.1f})"


def _words(interval: Interval, more: str, less: str) -> str:
    return f"{_points(interval)} {more if interval.mean >= 0 else less}"


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %" if round(100 * share, 1) == round(100 * share) else f"{100 * share:.1f} %"
