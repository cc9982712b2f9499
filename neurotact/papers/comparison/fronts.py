"""Which ways to save are on the front of accuracy and SOPs, and what it costs to halve the SOPs in each way."""

from typing import NamedTuple

import numpy as np
import pandas as pd

from neurotact.metrics.fronts import pareto_front
from neurotact.metrics.resampled import Interval, resampled_interval

NOTHING = "nothing saved"
REFRACTORY = "refractory period"
HALF = 0.5


def fronts(results: pd.DataFrame) -> pd.DataFrame:
    """A row for each set, way and setting: means over seeds, intervals, and whether no other point beats it.

    results: rows with set, way, setting, seed, n_train, n_test, both accuracies, sops_total, energy_estimate_nJ and
        signal_ms.
    Columns: low, high (95 % interval of the accuracy, NaN for one seed); share (of the SOPs of `NOTHING`); on_own_front
    (no point of its way, or `NOTHING`, beats it) and on_front (none of the set).
    """
    parts = []
    for name, rows in results.groupby("set", sort=False):
        base = rows[rows["way"] == NOTHING]
        points = [_point(key, part, base) for key, part in rows.groupby(["way", "setting"], sort=False)]
        table = pd.DataFrame(points)
        table.insert(0, "set", name)
        table["on_front"] = _on_front(table)
        table["on_own_front"] = np.concatenate([_own_front(table, way) for way in table["way"].unique()])
        parts.append(table)
    return pd.concat(parts, ignore_index=True) if parts else pd.DataFrame()


def _own_front(table: pd.DataFrame, way: str) -> np.ndarray:
    """Which points of a way neither another of its points nor the network that saves nothing beats, `(point,)`."""
    mine = (table["way"] == way).to_numpy()
    beside = mine | (table["way"] == NOTHING).to_numpy()
    return _on_front(table[beside])[mine[beside]]


def _on_front(table: pd.DataFrame) -> np.ndarray:
    return pareto_front(table["sops_total"].to_numpy(), table["accuracy_test"].to_numpy())


def _point(key: object, part: pd.DataFrame, base: pd.DataFrame) -> dict:
    way, setting = key  # pyright: ignore[reportGeneralTypeIssues]
    found = interval_of(part["accuracy_test"].to_numpy(), part)
    measures = ("accuracy_validation", "sops_total", "energy_estimate_nJ", "signal_ms")
    means = {name: float(part[name].mean()) for name in measures}
    return {"way": way, "setting": setting, "seeds": len(part), "accuracy_test": found.mean, "low": found.low,
            "high": found.high, **means, "share": _share(part, base)}  # fmt: skip


def interval_of(values: np.ndarray, rows: pd.DataFrame) -> Interval:
    """Of a mean over splits; without bounds for one."""
    if len(values) < 2:
        return Interval(float(np.mean(values)), float("nan"), float("nan"))
    return resampled_interval(values, int(rows["n_train"].iloc[0]), int(rows["n_test"].iloc[0]))


class Halved(NamedTuple):
    """What a way costs to halve the SOPs: the accuracy that each seed loses beside `NOTHING`, `(seed,)`."""

    way: str
    setting: str
    share: float
    accuracy_validation: float
    lost: np.ndarray
    rows: pd.DataFrame


def halved(results: pd.DataFrame, share: float = HALF) -> list[Halved]:
    """Of each way the setting with the best validation accuracy among those with at most this share of the SOPs.

    results: rows of one set. The first of the list is the way with the best validation accuracy, of equal ones that
    with the fewest SOPs; ways that never save as much are left out. Test accuracy is read only afterwards.
    """
    base = results[results["way"] == NOTHING]
    before = base.set_index("seed")["accuracy_test"]
    found = []
    for way, rows in results[results["way"] != NOTHING].groupby("way", sort=False):
        enough = [part for _, part in rows.groupby("setting", sort=False) if _share(part, base) <= share]
        if enough:
            best = max(enough, key=lambda part: (part["accuracy_validation"].mean(), -part["sops_total"].mean()))
            mine = best.set_index("seed")
            seeds = [seed for seed in before.index if seed in mine.index]
            lost = (before.loc[seeds] - mine.loc[seeds, "accuracy_test"]).to_numpy()
            validation = float(best["accuracy_validation"].mean())
            found.append(Halved(str(way), str(best["setting"].iloc[0]), _share(best, base), validation, lost, best))
    return sorted(found, key=lambda each: (-each.accuracy_validation, each.share))


def _share(part: pd.DataFrame, base: pd.DataFrame) -> float:
    """Of the SOPs of the network that saves nothing, over the same seeds; NaN where there is none."""
    return float(part["sops_total"].mean() / base.loc[base["seed"].isin(part["seed"]), "sops_total"].mean())


def answers(results: pd.DataFrame, share: float = HALF) -> list[str]:
    """One sentence for each set: what halving the SOPs costs in the best way, and with refractory periods."""
    return [_answer(str(name), rows, share) for name, rows in results.groupby("set", sort=False)]


def _answer(name: str, rows: pd.DataFrame, share: float) -> str:
    base = rows[rows["way"] == NOTHING]
    if base.empty:
        return f"{name}: nothing to compare with, since no network without savings was trained."
    found = halved(rows, share)
    head = (
        f"{name}: a network that saves nothing has {_percent(base['accuracy_test'].mean())} at "
        f"{base['sops_total'].mean():,.0f} SOPs; "
    )
    if not found:
        return f"{head}no way that was tried saves {_percent(1 - share)} of them."
    best = found[0]
    said = f"{head}to save at least {_percent(1 - share)} of them, {_costs(best)}"
    refractory = next((each for each in found if each.way == REFRACTORY), None)
    if refractory is None:
        return f"{said}, and {_too_little(rows, base)}."
    if refractory is best:
        other = f", and {_costs(found[1])}" if len(found) > 1 else ""
        return f"{said}{other}."
    more = _words(interval_of(refractory.lost - best.lost, refractory.rows), "more", "less")
    return f"{said}, and {_costs(refractory)}, {more} than {best.way}."


def _costs(each: Halved) -> str:
    found = interval_of(each.lost, each.rows)
    verb = "costs" if found.mean >= 0 else "gains"
    name = f"a {each.way} of {each.setting}" if each.way == REFRACTORY else f"{each.way} ({each.setting})"
    return f"{name} {verb} {_points(found)} at {_percent(each.share)} of the SOPs"


def _too_little(rows: pd.DataFrame, base: pd.DataFrame) -> str:
    """What the refractory period that saves most does instead."""
    mine = [part for _, part in rows[rows["way"] == REFRACTORY].groupby("setting", sort=False)]
    if not mine:
        return "no refractory period was tried"
    most = min(mine, key=lambda part: part["sops_total"].mean())
    lost = base.set_index("seed")["accuracy_test"] - most.set_index("seed")["accuracy_test"]
    found = interval_of(lost.dropna().to_numpy(), most)
    verb = "costs" if found.mean >= 0 else "gains"
    share = _share(most, base)
    return (
        f"no refractory period that was tried saves as much: {most['setting'].iloc[0]} {verb} {_points(found)} at "
        f"{_percent(share)} of the SOPs"
    )


def _points(found: Interval) -> str:
    """Points of accuracy, as many as are lost or gained, with the interval of what is lost."""
    text = f"{100 * abs(found.mean):.1f} points"
    if np.isnan(found.low):
        return f"{text} (one seed)"
    low, high = (100 * bound if found.mean >= 0 else -100 * bound for bound in (found.low, found.high))
    return f"{text} (95 % interval {min(low, high):.1f} to {max(low, high):.1f})"


def _words(found: Interval, more: str, less: str) -> str:
    return f"{_points(found)} {more if found.mean >= 0 else less}"


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %" if round(100 * share, 1) == round(100 * share) else f"{100 * share:.1f} %"
