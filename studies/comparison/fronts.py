"""The ways to save on the Pareto front of accuracy and a cost, and the cheapest of those that keep the accuracy.

The referee chooses on validation (`metrics.savings`); no share of a cost is a threshold.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd
from neurotact_parts.studies.comparison import by_list

from neurotact.metrics.fronts import pareto_front
from neurotact.metrics.paired import Paired, compare_shares
from neurotact.metrics.referee import Way
from neurotact.metrics.resampled import (
    DIFFERENCES,
    LEAST_SPLITS,
    SHARES,
    Interval,
    compare_over_splits,
    resampled_error,
    resampled_interval,
    sizes_of,
)
from neurotact.metrics.savings import Savings, savings, worse_than_another
from neurotact.metrics.shares import standard_error, wilson_interval
from neurotact.networks.training.cautions import FEW_PER_CLASS
from neurotact.report.wording import count
from neurotact.studies.way import Listed

NOTHING = "nothing saved"
REFRACTORY = "refractory period"
LONGEST_STEPS = "longest steps"
LONGEST = f"{REFRACTORY}, {LONGEST_STEPS}"
PERIODS = (REFRACTORY, LONGEST)
"""The ways of a refractory period: with the network's clock of the recipe, and with the slowest that it allows."""
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
"""Those whose saving has a sentence of its own."""
PICTURED = (ENERGY, SOPS, SIGNAL)
"""All, that of the headline first."""
MINUS = "\u2212"
LEAST = 0.02
"""The share of a cost from which on a saving has a name in the picture."""


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


class Saved(NamedTuple):
    """A setting of a way. share: of the cost of `NOTHING`. lost: test accuracy, seed by seed, `(seed,)`."""

    way: str
    setting: str
    share: float
    lost: np.ndarray
    rows: pd.DataFrame

    @property
    def is_refractory(self) -> bool:
        return self.way in PERIODS

    @property
    def saves(self) -> bool:
        """Whether it costs less than the network that saves nothing."""
        return self.share < 1


class Compared(NamedTuple):
    """The settings of one set with `NOTHING` first, and what the referee knows of them for one cost.

    worse: settings within the standard error that test windows show to be clearly less accurate than another.
    """

    settings: list[Saved]
    ways: list[Way]
    worse: set[int]

    @staticmethod
    def of(rows: pd.DataFrame, cost: str) -> "Compared":
        """rows: of one set, with a network that saves nothing. cost: a key of `COSTS`."""
        base = rows[rows["way"] == NOTHING]
        others = [part for _, part in rows[rows["way"] != NOTHING].groupby(["way", "setting"], sort=False)]
        settings = [_saved(part, base, cost) for part in (base, *others)]
        ways, tested = [_way(one.rows, one.share) for one in settings], [_by_seed(one.rows) for one in settings]
        sizes = sizes_of(rows)
        worse = worse_than_another(ways, lambda one, other: compared(tested[one], tested[other], sizes))
        return Compared(settings, ways, worse)

    def savings(self, of: Callable[[Saved], bool] | None = None) -> Savings:
        """The cheapest setting that keeps the accuracy; of: of those for which it holds."""
        among = None if of is None else [at for at, one in enumerate(self.settings) if of(one)]
        return savings(self.ways, [_tested(one.rows) for one in self.settings], self.worse, among)


def compared(one: pd.Series, other: pd.Series, sizes: tuple[int, int, float]) -> Paired:
    """One setting minus another on test windows, split by split; both by split. sizes: of `sizes_of`."""
    gained = (one - other).dropna().to_numpy()
    if len(gained) >= LEAST_SPLITS:
        return compare_over_splits(gained, *sizes)
    return compare_shares(float(one.mean()), float(other.mean()), max(1, round(sizes[2])))


def _by_seed(rows: pd.DataFrame) -> pd.Series:
    return rows.set_index("seed")["accuracy_test"]


def _saved(part: pd.DataFrame, base: pd.DataFrame, cost: str) -> Saved:
    way, setting = (str(part[name].iloc[0]) for name in ("way", "setting"))
    return Saved(way, setting, _share(part, base, cost), (_by_seed(base) - _by_seed(part)).dropna().to_numpy(), part)


def _way(part: pd.DataFrame, share: float) -> Way:
    """What the referee knows of a setting."""
    values = part["accuracy_validation"].to_numpy()
    n_train, n_validation, trials = sizes_of(part, "validation")
    error = resampled_error(values, n_train, n_validation, trials)
    if np.isnan(error):  # of one or two seeds: that of the trials alone
        error = standard_error(float(values.mean()), max(1, round(trials)))
    return Way(float(values.mean()), error, share)


def _share(part: pd.DataFrame, base: pd.DataFrame, cost: str = SOPS) -> float:
    """The share of a cost of the network that saves nothing, over the same seeds; NaN without such a network."""
    return float(part[cost].mean() / base.loc[base["seed"].isin(part["seed"]), cost].mean())


def tables(results: pd.DataFrame) -> dict[str, tuple[Listed, ...]]:
    """Of each set by its name: what each way saves at its accuracy, and the Pareto front from the best network down."""
    return {str(name): (*_kept(rows), _listed(rows)) for name, rows in results.groupby("set", sort=False)}


def _kept(rows: pd.DataFrame) -> Iterator[Listed]:
    """The setting of each way that is the cheapest at the accuracy of the best, a column per cost of `COSTS`."""
    ways = [way for way in rows["way"].unique() if way != NOTHING]
    if not ways or not (rows["way"] == NOTHING).any():
        return
    table, first = {"way": ways}, []
    for cost in PICTURED:
        settings, found = _of_ways(rows, cost)
        table[f"fewest {COSTS[cost].unit}"] = [_kept_in_words(settings, found[way]) for way in ways]
        if cost == ENERGY:
            order = sorted(ways, key=lambda way: _left(settings, found[way]))
            periods = [way for way in order if way in PERIODS][:1]
            first = [ways.index(way) for way in dict.fromkeys((*order[:1], *periods, *order[1:]))]
    within = ", with their 95 % interval from the differences of the seeds," if has_intervals(rows) else ""
    yield Listed(
        "What each way saves: its cheapest setting within the standard error of the best validation accuracy that test "
        f"windows do not show to be clearly less accurate than another; the points of accuracy that are lost{within} "
        "and the share that is left of the cost. -: the way has no such setting that saves.",
        pd.DataFrame(table),
        first,
    )
    priced = energies_of_ways(rows)
    if len(priced):
        cells = priced.assign(said=[f"{_bare(one.setting)}: {_percent(one.left)}" for one in priced.itertuples()])
        left = cells.pivot_table(index="way", columns="prices", values="said", aggfunc="first", sort=False)
        yield Listed(
            "The share of the energy that is left by each price list: of each way its cheapest setting that keeps the "
            "accuracy, as above. -: the way has no such setting that saves.",
            left.reindex(ways).fillna("-").reset_index(),
        )


def _of_ways(rows: pd.DataFrame, cost: str) -> tuple[list[Saved], dict[str, int | None]]:
    """The settings of one set, and for each way which of them is the cheapest that keeps the accuracy."""
    compared = Compared.of(rows, cost)
    ways = dict.fromkeys(one.way for one in compared.settings if one.way != NOTHING)
    return compared.settings, {way: compared.savings(lambda one, way=way: one.way == way).cheapest for way in ways}


def _left(settings: Sequence[Saved], at: int | None) -> float:
    """The share of the cost that is left; 1 where nothing is saved."""
    return 1.0 if at is None else min(1.0, settings[at].share)


def labels(rows: pd.DataFrame, cost: str) -> dict[tuple[str, str], str]:
    """The names in a picture of one set: of the setting of each way that keeps the accuracy, if it saves."""
    if not (rows["way"] == NOTHING).any():
        return {}
    settings, found = _of_ways(rows, cost)
    saving = {at for at in found.values() if at is not None and settings[at].share <= 1 - LEAST}

    def label(at: int, one: Saved) -> str:
        return f"{one.way} {in_signs(one.share, one.lost.mean())}" if at in saving else ""

    return {(one.way, one.setting): label(at, one) if at else NOTHING for at, one in enumerate(settings)}


def in_signs(share: float, lost: float) -> str:
    r"""What is saved and lost, in few words.

    >>> [in_signs(*pair).replace("\u00a0", " ") for pair in ((0.806, 0.034), (0.999, -0.017))] == [
    ...     f"{MINUS}19 %, {MINUS}3.4 points", "0 %, +1.7 points"]
    True
    """
    cost, points = (f"{change + 0.0:+g}" for change in (round(100 * (share - 1)), round(-100 * lost, 1)))
    said = f"{cost}~%, {points}~points".replace("-", MINUS).replace("+0~", "0~")
    return said.replace("~", "\u00a0")


def headline(rows: pd.DataFrame) -> str:
    """One sentence on one set: whether a refractory period is the cheapest way, and what both save of the energy."""
    if unfit := _unfit(rows):
        return _capital(unfit)
    compared = Compared.of(rows, ENERGY)
    found, called = compared.savings(), COSTS[ENERGY].called
    said = _capital(_verdict(compared, found, called))
    period, other = (compared.savings(lambda one, own=own: one.is_refractory == own).cheapest for own in (True, False))
    told = [compared.settings[at] for at in (found.cheapest, period, other) if at is not None]
    saving = {one.is_refractory: one for one in reversed(told) if one.saves}
    if not saving:
        return f"{said}."
    first, *more = sorted(saving.values(), key=lambda one: one.share)
    parts = [f"{100 * (1 - first.share):.0f} % of the {called} is saved by {_by(first)}"]
    parts += [f"{100 * (1 - one.share):.0f} % by {_by(one)}" for one in more]
    if True not in saving:
        parts.append(f"nothing by a {REFRACTORY}")
    return f"{said}: {', '.join(parts)}."


def _by(one: Saved) -> str:
    points = f"{100 * abs(one.lost.mean()):.1f} points {'gained' if one.lost.mean() < 0 else 'lost'}"
    return f"{f'a {REFRACTORY}' if one.is_refractory else one.way} ({points})"


def energies_of_ways(rows: pd.DataFrame) -> pd.DataFrame:
    """What is left of the energy of one set by every price list, in the setting of each way that keeps the accuracy.

    Columns: prices (the list), way, setting, lost (test accuracy, a share), left (share of the energy), clear (whether
    test windows do not speak against the way being the cheapest of all). Ways that save nothing are left out, and lists
    by which the rows hold no energy.
    """
    energies, found = by_list.energies(rows), []
    for name in energies.columns[energies.notna().all()]:
        compared = Compared.of(rows.assign(**{name: energies[name]}), str(name))
        every = compared.savings()
        for way in rows.loc[rows["way"] != NOTHING, "way"].unique():
            at = compared.savings(lambda one, way=way: one.way == way).cheapest
            if at is not None and (one := compared.settings[at]).saves:
                clear = at == every.cheapest and every.is_clear
                found.append((name, way, one.setting, float(one.lost.mean()), one.share, clear))
    return pd.DataFrame(found, columns=["prices", "way", "setting", "lost", "left", "clear"])


def has_intervals(rows: pd.DataFrame) -> bool:
    """Whether there are enough seeds for an interval of their mean."""
    return rows["seed"].nunique() >= LEAST_SPLITS


def _kept_in_words(settings: Sequence[Saved], at: int | None) -> str:
    if at is None or not settings[at].saves:
        return "-"
    one = settings[at]
    interval = interval_of(one.lost, one.rows)
    within = "" if np.isnan(interval.low) else f" ({100 * interval.low:.1f} to {100 * interval.high:.1f})"
    return f"{_bare(one.setting)}: {100 * interval.mean:.1f} points{within}, {_percent(one.share)} left"


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
    base = rows[rows["way"] == NOTHING]
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
                "lost (points)": [f"{100 * share:.1f}" for share in _tested(base) - shown["accuracy_test"]],
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
    learned = not_learned(base)
    if learned:
        windows = "`settings={'window.length_ms': ..., 'window.align': 'onset'}`"
        yield f"{learned}; give more trials, or windows that contain the touch ({windows})"
    seeds = base["seed"].nunique()
    if seeds < LEAST_SPLITS:
        yield (
            f"{in_seeds(seeds)}, so there is no interval: another split may reverse the answer; give "
            f"`split=nt.Split(repeats={LEAST_SPLITS})` or more"
        )
    if "least_test_trials" in base and base["least_test_trials"].min() < FEW_PER_CLASS:
        least, trials = int(base["least_test_trials"].min()), int(base["test_trials"].min())
        yield (
            f"a seed tests {trials} trials, {least} of the rarest class: one trial is {100 / trials:.1f} points of "
            "accuracy, and smaller differences mean nothing; record more"
        )


def not_learned(base: pd.DataFrame) -> str:
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


def answers(results: pd.DataFrame) -> list[str]:
    """Two sentences for each set: the cheapest way in SOPs and in energy that keeps the accuracy, and a refractory one.

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
            text = _answer(rows, cost)
            sentences.append(f"{', '.join(heads)}: {text}" if heads else _capital(text))
        if text := _by_lists(rows):
            sentences.append(f"{name}: {text}" if several else _capital(text))
    return sentences


def _by_lists(rows: pd.DataFrame) -> str:
    """The way that leaves the least energy by each price list, beside a refractory period or, of that, the next way."""
    groups: dict[str, list[tuple[str, float, float]]] = {}
    for name, part in energies_of_ways(rows).groupby("prices", sort=False):
        is_period = part["way"].isin(PERIODS)
        period, other = (float(part.loc[own, "left"].min()) for own in (is_period, ~is_period))
        first = part.loc[part["left"].idxmin()]
        own = period <= other or np.isnan(other)
        least, next_ = (period, other) if own else (other, period)
        groups.setdefault(f"a {REFRACTORY}" if own else str(first["way"]), []).append((str(name), least, next_))
    if not groups:
        return ""
    said = "; ".join(f"{way} by {_leaves(way, found)}" for way, found in groups.items())
    verdict = "prices decide which way leaves" if len(groups) > 1 else "by all prices one way leaves"
    return f"{verdict} the least energy. Of those that keep the accuracy it is {said}."


def _leaves(way: str, found: Sequence[tuple[str, float, float]]) -> str:
    names, least, next_ = zip(*found, strict=True)
    other = "the next way" if REFRACTORY in way else f"a {REFRACTORY}"
    beside = "saves nothing" if np.isnan(next_).all() else _between(next_)
    return f"{', '.join(names)} ({_between(least)}, {other} {beside})"


def _between(shares: Sequence[float]) -> str:
    """
    >>> _between([0.8, 0.86]), _between([0.5])
    ('80 to 86 %', '50 %')
    """
    low, high = (round(100 * end(share for share in shares if not np.isnan(share))) for end in (min, max))
    return f"{low} %" if low == high else f"{low} to {high} %"


def _capital(text: str) -> str:
    return text[0].upper() + text[1:]


def _unfit(rows: pd.DataFrame) -> str:
    """Why nothing can be said of a set; empty if something can."""
    base = rows[rows["way"] == NOTHING]
    if base.empty:
        return "nothing to compare with, since no network without savings was trained."
    if unlearned := not_learned(base):
        return f"nothing was learned, so no saving means anything: {unlearned}."
    return ""


def _answer(rows: pd.DataFrame, cost: str) -> str:
    base, called = rows[rows["way"] == NOTHING], COSTS[cost].called
    compared = Compared.of(rows, cost)
    settings, found = compared.settings, compared.savings()
    head = (
        f"a network that saves nothing has {_percent(_tested(base))} at {base[cost].mean():,.0f} "
        f"{COSTS[cost].unit}{afferents_in_words(base) if cost == ENERGY else ''}"
    )
    level = f"validation windows cannot tell {len(found.level)} of {len(settings)} settings from the most accurate"
    said = f"{_verdict(compared, found, called)}; {head}; {level}"
    if found.cheapest is None:
        return f"{said}, and test windows show each one within its standard error to be clearly less accurate."
    cheapest = settings[found.cheapest]
    if found.contrary:
        other = settings[found.contrary[0]]
        return (
            f"{said}; validation prefers the cheapest within its standard error, where {_costs(cheapest, called)}, and "
            f"on test windows another is no dearer and no less accurate: {_costs(other, called)}."
        )
    if not cheapest.saves:
        return f"{said}, and none within its standard error saves {called}{_refractory(compared, called, None)}."
    chosen = f"{said}; the cheapest within its standard error: {_costs(cheapest, called)}"
    if not cheapest.is_refractory:
        return f"{chosen}{_refractory(compared, called, cheapest)}."
    rival = compared.savings(lambda one: not one.is_refractory).cheapest
    if rival is None or not settings[rival].saves:
        return f"{chosen}, and no other way saves {called}."
    return f"{chosen}, and {_costs(settings[rival], called)}."


def _verdict(compared: Compared, found: Savings, called: str) -> str:
    """Whether a refractory period is the cheapest way that keeps the accuracy."""
    kept = "at an accuracy that cannot be told from the best"
    if (seeds := len(compared.settings[0].rows)) < LEAST_SPLITS:
        return f"{in_seeds(seeds)} cannot tell which way is the cheapest"
    if found.cheapest is None or found.contrary:
        return "validation and test windows cannot tell which way is the cheapest"
    cheapest = compared.settings[found.cheapest]
    if not cheapest.saves:
        return f"no way that was tried saves {called} {kept}"
    equal = {compared.settings[at].is_refractory for at in found.kept if compared.settings[at].share == cheapest.share}
    place = "among the cheapest ways" if len(equal) > 1 else "the cheapest way"
    return f"a refractory period is {'' if True in equal else 'not '}{place} {kept}"


def _refractory(compared: Compared, called: str, cheapest: Saved | None) -> str:
    """The cheapest refractory period that keeps the accuracy, after another way; else the best that there is."""
    settings = compared.settings
    tried = [at for at, one in enumerate(settings) if one.is_refractory]
    if not tried:
        return "; no refractory period was tried"
    at = compared.savings(lambda one: one.is_refractory).cheapest
    if at is not None and settings[at].saves:
        more = ""
        if cheapest is not None:
            more = (
                f", {_words(settings[at].lost - cheapest.lost, settings[at].rows, 'more', 'less')} than {cheapest.way}"
            )
        return f", and {_costs(settings[at], called)}{more}"
    most = settings[max(tried, key=lambda at: (compared.ways[at].validation, -settings[at].share))]
    return f"; no refractory period does: validation is highest where {_costs(most, called)}"


def _tested(rows: pd.DataFrame) -> float:
    return float(rows["accuracy_test"].mean())


def afferents_in_words(rows: pd.DataFrame) -> str:
    """When the afferents of a set are computed; empty for events, and for a run that does not say it."""
    said = str(rows["afferents"].iloc[0]) if "afferents" in rows else EVENTS
    return "" if said == EVENTS else f", with afferents computed {said}"


def _costs(one: Saved, called: str) -> str:
    verb = "costs" if round(one.lost.mean(), 3) >= 0 else "gains"
    name = f"a {_period(one.way, one.setting)}" if one.is_refractory else f"{one.way} ({_bare(one.setting)})"
    name = "a network that saves nothing" if one.way == NOTHING else name
    return f"{name} {verb} {_points(one.lost, one.rows)} at {_percent(one.share)} of the {called}"


def _period(way: str, setting: str) -> str:
    """
    >>> _period(LONGEST, "5 & 5 ms, longest steps")
    'refractory period of 5 & 5 ms with the longest steps'
    """
    return f"{REFRACTORY} of {_bare(setting)}{f' with the {LONGEST_STEPS}' if way == LONGEST else ''}"


def _points(lost: np.ndarray, rows: pd.DataFrame) -> str:
    """Points of accuracy that are lost or gained, with the interval of this loss or gain, or its number of seeds."""
    interval = interval_of(lost, rows)
    return in_points(interval) + (f" ({in_seeds(len(lost))})" if np.isnan(interval.low) else "")


def in_points(change: Interval) -> str:
    """How many points a loss or gain of accuracy is, with its interval if it has one.

    >>> in_points(Interval(-0.1, -0.13, -0.02)), in_points(Interval(0.1, np.nan, np.nan))
    ('10.0 points (95 % interval 2.0 to 13.0)', '10.0 points')
    """
    mean, *ends = (100 * (1 if change.mean >= 0 else -1) * value for value in change)
    low, high = sorted(ends)
    return f"{mean:.1f} points" + ("" if np.isnan(low) else f" (95 % interval {low:.1f} to {high:.1f})")


def times(ratio: float) -> str:
    """
    >>> times(18.2), times(0.0812)
    ('18 times', '8.1 % of')
    """
    return f"{count(ratio, 2)} times" if ratio >= 1 else f"{count(100 * ratio, 2)} % of"


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
