"""Which refractory period: one answer, with what it saves, what it costs, how sure that is, and what to do next.

Validation trials alone choose, by the rule of `metrics.referee`: the cheapest network within one standard error of the
best. It is compared with the shortest period that was tried, at the same size. A period is named only if a few trials
left out, or other starts of the weights, would choose it too, and if no row of the run speaks against it; else the
answer is that these recordings cannot tell.
"""

import math
import shlex
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import pandas as pd
from scipy.stats import t

from neurotact.metrics import power, referee
from neurotact.metrics.resampled import (
    DIFFERENCES,
    LEAST_SPLITS,
    Interval,
    compare_over_splits,
    resampled_interval,
)
from neurotact.report import periods
from neurotact.report.answer import Network, OfNetworks, Trials
from neurotact.report.robustness import of_network
from neurotact.report.wording import milliseconds, percent
from neurotact.studies.automatic import FOLDS

Kind = Literal["use", "none", "unclear"]
SAVED = (-math.inf, 1.0)
"""What the mean of shares that are saved can be."""
INDEPENDENT = 10**12
"""Training examples beside which values are as independent ones: the corrected t test is then Student's."""
SEEDS = 5
"""Starts of the weights from which on more of them tell little."""
MINUS = "\u2212"


class Evidence(NamedTuple):
    """What a network saves beside another one, and what it costs, all as shares.

    sops, nJ: what it saves, with the interval over trainings; NaN and None where it is not counted. lost: of the
    accuracy on test trials. seen: of that on validation trials, and whether splits show that to be clear.
    """

    sops: Interval
    nJ: Interval | None
    lost: Interval
    seen: tuple[float, bool] = (0.0, False)

    @property
    def is_counted(self) -> bool:
        """Whether SOPs or energy are counted."""
        return self.nJ is not None or not math.isnan(self.sops.mean)

    @property
    def saves(self) -> bool:
        """Whether it takes clearly less energy, or else fewer SOPs: the whole interval, where there is one."""
        saved = self.nJ or self.sops
        return saved.mean > 0 and not saved.low <= 0


class Sure(NamedTuple):
    """What the numbers are of: test trials, splits, trainings of each network, recorded trials of each class."""

    test: int
    splits: int
    trainings: int
    each: int


class Places(NamedTuple):
    """Names of a run that commands need: its folder, that of the chosen network, the recordings.

    may_fold: whether the split is a random one without folds, of classes that are large enough for them.
    """

    run: Path
    cell: Path
    recordings: Path | None = None
    may_fold: bool = False


class PeriodChoice(NamedTuple):
    """The refractory period of one answer.

    network: the chosen one. other: what it is compared with: the shortest period at its size (`_peers`); where the
    shortest is chosen, the best longer one. larger: the best network of the shortest period where that is another one,
    with its evidence. why: what is in doubt; empty if nothing is. fix: which remedy, of `unclear`.
    """

    kind: Kind
    network: Network
    other: Network
    evidence: Evidence
    larger: tuple[Network, Evidence] | None = None
    why: str = ""
    fix: Literal["", "trials", "seeds"] = ""

    @property
    def longer(self) -> Network:
        """Of the two that are compared, the one with the longer period."""
        return max(self.network, self.other, key=_length)


def _length(network: Network) -> float:
    return sum(periods.sizes(network.pair))


def chosen(networks: Sequence[Network], trials: Trials) -> Network | None:
    """The network that validation chooses; None where no two refractory periods were tried.

    >>> from neurotact.report.answer import Decision
    >>> two = [Network(pair, 20, 3, 0.9, Decision(0.9, sops, 500.0, 80.0, None), None)
    ...        for pair, sops in (("1&1", 1000.0), ("5&5", 700.0))]
    >>> chosen(two, Trials(40, 40)).pair, chosen(two[:1], Trials(40, 40))
    ('5&5', None)
    """
    found = networks[referee.cheapest_of([network.way(trials) for network in networks])]
    pairs = {found.pair, *(one.pair for one in _peers(networks, found))} - {periods.NONE}
    shortest = min((one.pair for one in networks), key=lambda pair: sum(periods.sizes(pair)))
    return found if len(pairs) > 1 and shortest in pairs else None


def _peers(networks: Sequence[Network], found: Network) -> list[Network]:
    """The networks of other periods to compare one with: of its size, or all where each period searched a size."""
    is_searched = len({one.pair for one in networks}) == len(networks)
    return [one for one in networks if one.pair != found.pair and (is_searched or one.size == found.size)]


def noise_of(network: Network, trials: Trials) -> float:
    """One standard error of a mean over starts of the weights; with a single start, that of other validation trials.

    A network without a hidden layer is the same from every start.
    """
    if network.is_fitted:
        return 0.0
    apart = network.way(trials).error if network.apart is None else network.apart.deviation
    return apart / math.sqrt(max(1, network.seeds))


def choose(
    outcome: OfNetworks,
    compared: Callable[[Network, Network], Evidence],
    untold: str = "",
    tolerance: float = 0.01,
) -> PeriodChoice | None:
    """What may be said of the period that validation chose, `outcome.best`; None where nothing was to choose.

    compared: a network beside another one. untold: why validation cannot choose for the test; empty if it can.
    tolerance: a clear loss on test trials that speaks against no period.
    """
    found = chosen(outcome.rows, outcome.trials)
    if found is None:
        return None
    shortest = min((one.pair for one in outcome.rows), key=lambda pair: sum(periods.sizes(pair)))
    peers = _peers(outcome.rows, found)
    longer = [one for one in peers if one.pair != shortest]
    is_longer = found.pair != shortest
    other = next((one for one in peers if one.pair == shortest), None) if is_longer else None
    other = other or longer[referee.best_of([one.way(outcome.trials) for one in longer])]
    evidence = compared(found, other) if is_longer else compared(other, found)
    alone = [one for one in outcome.rows if one.pair == shortest]
    best = alone[referee.best_of([one.way(outcome.trials) for one in alone])]
    larger = (best, compared(found, best)) if is_longer and best is not other else None
    against = [evidence] if is_longer else [compared(one, found) for one in longer]
    why, fix = _in_doubt(outcome, found, evidence, against, untold, tolerance)
    kind = "unclear" if why else "use" if is_longer else "none"
    return PeriodChoice(kind, found, other, evidence, larger, why, fix)


def _in_doubt(
    outcome: OfNetworks,
    found: Network,
    evidence: Evidence,
    against: Sequence[Evidence],
    untold: str,
    tolerance: float,
) -> tuple[str, Literal["", "trials", "seeds"]]:
    """Why no period is named, and what would help; empty where one is. against: of each longer one, if none is used."""
    if untold:
        return untold[:1].lower() + untold[1:], "trials"
    if not outcome.is_above_chance:
        return "no network is clearly better than guessing", "trials"
    if not evidence.is_counted:
        return "what their decisions cost is not counted", "trials"
    ways = [one.way(outcome.trials) for one in outcome.rows]
    noise = [noise_of(one, outcome.trials) for one in outcome.rows]
    may_be = referee.may_be_cheapest(ways, outcome.trials.validation, noise)
    rivals = [outcome.rows[index] for index in may_be if outcome.rows[index].pair != found.pair]
    others = dict.fromkeys(one.pair for one in rivals)
    if others:
        *first, last = [pair if len({*periods.sizes(pair)}) > 1 else pair.partition("&")[0] for pair in others]
        named = f"{', '.join(first)} or {last} ms" if first else f"{last} ms"
        if found.is_fitted and all(one.is_fitted for one in rivals):
            return f"a few other validation trials would choose {named}", "trials"
        trained = next(one for one in (found, *rivals) if not one.is_fitted)
        fix = "seeds" if trained.starts < SEEDS and trained.seeds < SEEDS else "trials"
        whose = " of networks with a hidden layer" if found.is_fitted else ""
        return f"a few other validation trials, or other starts of the weights{whose}, would choose {named}", fix
    if math.isnan(evidence.lost.high):
        return "the error of so few test trials is not known", "trials"
    if _length(found) > min(map(_length, outcome.rows)):
        why, fix = _against_longer(evidence, tolerance)
        return why, "trials" if fix == "seeds" and found.is_fitted else fix
    if any(one.saves and one.lost.mean <= 0 for one in against):
        return "on test trials a longer one saves and loses nothing", "trials"
    if evidence.lost.high - evidence.lost.low > 2 * power.WEAK:
        return "so few test trials leave open differences of ten points", "trials"
    return "", ""


def _against_longer(evidence: Evidence, tolerance: float) -> tuple[str, Literal["", "trials", "seeds"]]:
    """As `_in_doubt`, for a period that validation prefers to the shortest."""
    (lost_seen, is_clear), lost = evidence.seen, evidence.lost
    if is_clear and lost_seen > tolerance:
        return (
            "the preferred one is clearly less accurate on validation trials, although within the error of the best",
            "trials",
        )
    if lost.low > 0 and lost.mean > tolerance:
        return "test trials show a clear loss by the preferred one, which validation trials did not", "trials"
    if not evidence.saves:
        return "trainings differ by more than the preferred one saves", "seeds"
    if lost.high > power.WEAK:
        return "so few test trials leave open a loss of more than ten points", "trials"
    return "", ""


def in_words(choice: PeriodChoice, sure: Sure, populations: Sequence[str] = (), sample_ms: float = 0.0) -> str:
    """The one sentence on refractory periods.

    populations: names of those that the two numbers of a pair are of; none for an encoder whose taxels have one dead
    time. sample_ms: between samples of the sensor.
    """

    def named(network: Network, *, is_said: bool = False) -> str:
        short = "" if is_said else _short(network.pair, sample_ms)
        return f"{_period(network.pair, populations)}{short}{'' if both else network.with_size}"

    def other_named(network: Network) -> str:
        return named(network, is_said=periods.is_short(longer.pair, sample_ms))

    what = "t_ref" if populations else "a dead time (t_ref)"
    network, other, longer = choice.network, choice.other, choice.longer
    size = network.with_size
    both = f", both{size}" if size and size == other.with_size else ""
    between = _basis(sure)
    if choice.kind == "use":
        against = f"against {other_named(other)}{both}"
        more = _beside_larger(choice, populations)
        return f"Use {what} of {named(network)}: it {_gain(choice.evidence)}, {against}{more}; {between}."
    if choice.kind == "none":
        return (
            f"No refractory period pays on these recordings: the best longer one, {named(longer)}, "
            f"{_gain(choice.evidence)}, against {other_named(network)}{both}; {between}."
        )
    if longer is network:
        said = f"Validation prefers {named(longer)}: it {_gain(choice.evidence)}, against {other_named(other)}{both}"
    else:
        said = f"Validation prefers {named(network)}: {other_named(longer)} {_gain(choice.evidence)} against it{both}"
    return f"These recordings cannot tell which refractory period to use: {choice.why}. {said}; {between}."


def _basis(sure: Sure) -> str:
    """How many trials, splits and trainings the numbers are of."""
    trials = f"{sure.test} test trial{'' if sure.test == 1 else 's'}"
    splits = "one split" if sure.splits == 1 else f"{sure.splits} splits"
    each = "one training each" if sure.trainings == 1 else f"{sure.trainings} trainings each"
    return f"{trials} of {splits}, {each}"


def _period(pair: str, populations: Sequence[str]) -> str:
    """
    >>> _period("10&10", ("RA-I", "SA-I")), _period("10&5", ("RA-I", "SA-I")), _period("5", ())
    ('10 ms', '10 ms for RA-I and 5 ms for SA-I', '5 ms')
    """
    sizes = periods.sizes(pair)
    if len(set(sizes)) < 2 or len(populations) < len(sizes):
        return f"{sizes[0]:g} ms" if len(set(sizes)) == 1 else periods.in_ms(pair)
    return " and ".join(f"{size:g} ms for {name}" for size, name in zip(sizes, populations, strict=False))


def _short(pair: str, sample_ms: float) -> str:
    return f" (shorter than a sample of {milliseconds(sample_ms)})" if periods.is_short(pair, sample_ms) else ""


def _gain(evidence: Evidence) -> str:
    """What is saved, and for how many points."""
    if not evidence.is_counted:
        return _for(evidence.lost, "loses", "gains")
    saved = _saved(evidence.sops, "SOPs", "of the SOPs") if not math.isnan(evidence.sops.mean) else ""
    if evidence.nJ is not None:
        energy = _saved(evidence.nJ, "energy", "of the energy")
        same = saved.split(" ", 1)[0] == energy.split(" ", 1)[0]
        saved = f"{saved} and {energy.split(' ', 1)[1] if same else energy}" if saved else energy
    return f"{saved} {_for(evidence.lost)}"


def _saved(saved: Interval, what: str, of: str) -> str:
    """
    >>> _saved(Interval(0.41, 0.35, 0.47), "SOPs", "of the SOPs"), _saved(_alone(-0.02), "SOPs", "of the SOPs")
    ('saves 41 % of the SOPs (35 to 47)', 'takes 2 % more SOPs')
    """
    sign = 1 if saved.mean >= 0 else -1
    ends = sorted((sign * saved.low, sign * saved.high))
    within = "" if math.isnan(saved.low) else f" ({' to '.join(_number(100 * end, 0) for end in ends)})"
    share = percent(abs(saved.mean)) if abs(saved.mean) < 0.095 else f"{100 * abs(saved.mean):.0f} %"
    share = share.replace(".0 %", " %")
    return f"saves {share} {of}{within}" if sign > 0 else f"takes {share} more {what}{within}"


def _for(lost: Interval, loses: str = "for", gains: str = "and gains") -> str:
    """
    >>> _for(Interval(0.004, -0.006, 0.014)), _for(Interval(-0.02, -0.03, -0.01))
    ('for 0.4 points (\u22120.6 to 1.4)', 'and gains 2.0 points (1.0 to 3.0)')
    """
    sign = 1 if round(1000 * lost.mean) >= 0 else -1
    ends = sorted((sign * lost.low, sign * lost.high))
    within = "" if math.isnan(lost.low) else f" ({' to '.join(_number(100 * end, 1) for end in ends)})"
    points = f"{_number(100 * abs(lost.mean), 1)} points"
    return f"{loses if sign > 0 else gains} {points}{within}"


def _number(value: float, digits: int) -> str:
    said = f"{value:.{digits}f}"
    return said.replace("-", MINUS) if float(said) else said.lstrip("-")


def _beside_larger(choice: PeriodChoice, populations: Sequence[str]) -> str:
    """The best network of the shortest period, where it has another size; empty if it has the same."""
    if choice.larger is None:
        return ""
    best, evidence = choice.larger
    size = best.with_size.strip() if best.is_fitted else f"of {best.size or 'another size'}"
    return f"; against the best with {_period(best.pair, populations)}, {size}, it {_gain(evidence)}"


def next_step(
    choice: PeriodChoice, sure: Sure, places: Places, lost: str = "", *, few: bool = False
) -> tuple[str, list[str]]:
    """The one thing that decides most, in words, and the commands that do it, which run as they stand.

    lost: how much the encoding loses, if that is much: then neither more tests nor another period help. few: whether
    the test trials are too few to compare networks with their rivals.
    """
    run, cell = places.run.absolute(), places.cell.absolute()
    study = run / "study.toml"
    if lost and places.recordings is not None:
        compared = "study", "run", "which-encoder", "--data", places.recordings, "-o", _beside(run, "encoders")
        return f"{lost}; compare encoders:", [_command(*compared)]
    if choice.kind != "unclear" and not (few and places.may_fold):
        save = _command("save", cell, *_recorded(places), "-o", _beside(run, "saved"))
        return "Let all ways to save be tried together, or take it along as it is, as C:", [save, as_c(places)]
    if places.may_fold:
        return in_folds(run)
    if choice.fix == "seeds":
        words = f"Train {SEEDS} networks of each kind, from other starts of the weights:"
        seeds = f"sweep.seed={[*range(SEEDS)]}"
        return words, [_command("study", "run", study, "--set", seeds, "-o", _beside(run, "seeds"))]
    needed = f"about {trials_needed(choice, sure)} trials per class, of {sure.each} now"
    words = f"Record more: {needed}; then, with the file imported again:"
    return words, [_command("study", "run", study, "-o", _beside(run, "more"))]


def in_folds(run: Path) -> tuple[str, list[str]]:
    """To test every trial, in words, and the command."""
    words = f"Test each trial once, in {FOLDS} folds, each from another start of the weights:"
    return words, [_command("study", "run", run / "study.toml", "--folds", FOLDS, "-o", _beside(run, "folds"))]


def as_c(places: Places) -> str:
    """The command that exports the chosen network to C."""
    run, cell = places.run.absolute(), places.cell.absolute()
    return _command("export", cell, "--to", "c", *_recorded(places), "-o", run / "c")


def _recorded(places: Places) -> list[Any]:
    return [] if places.recordings is None else ["--recordings", places.recordings]


def _beside(run: Path, name: str) -> Path:
    return run.with_name(f"{run.name}-{name}")


def _command(*words: object) -> str:
    return shlex.join(["neurotact", *map(str, words)])


def trials_needed(choice: PeriodChoice, sure: Sure) -> int:
    """Recorded trials per class that make the interval of the loss as narrow as a verdict needs; at least twice those.

    Half of it must fit between the loss and `power.WEAK`; it shrinks with the root of the trials.
    """
    lost = choice.evidence.lost
    half = 0.0 if math.isnan(lost.low) else (lost.high - lost.low) / 2
    room = max(power.WEAK / 2, power.WEAK - abs(lost.mean))
    return math.ceil(max(1, sure.each) * max(2.0, (half / room) ** 2))


class Comparison(NamedTuple):
    """Compares networks by the rows of `results.csv`, which have the columns of `front.costs_of`.

    right: of a row, by its index, the share of right windows of each test trial. splits: columns that tell splits
    apart. sides: training and test examples of a split, and its test trials.
    """

    rows: pd.DataFrame
    right: Callable[[int], dict[str, float] | None]
    splits: Sequence[str]
    sides: tuple[int, int, float]

    def __call__(self, one: Network, other: Network) -> Evidence:
        """What `one` saves and costs beside `other`; both are trained from the same starts on the same splits."""
        by = [*self.splits, "seed"]
        both = self._of(one).merge(self._of(other), on=by, suffixes=("", " of other"))
        costs = [self._saved(both, "whole_sops"), self._saved(both, "whole_nJ")]
        # Without pairs, means alone are compared.
        sops = costs[0] or _alone(0.0 if other.whole.sops == 0 else 1 - one.whole.sops / other.whole.sops)
        lost, seen = other.whole.accuracy - one.whole.accuracy, other.validation - one.validation
        if self._n_splits(both) < LEAST_SPLITS:
            return Evidence(sops, costs[1], self._over_trials(one, other, both, lost), (seen, False))
        lost_in = self._of_splits(both, "accuracy_test")
        found = resampled_interval(lost_in, *self.sides[:2], DIFFERENCES, self.sides[2])
        clear = compare_over_splits(self._of_splits(both, "accuracy_validation"), *self.sides).is_clear
        return Evidence(sops, costs[1], found, (seen, clear))

    def _of(self, network: Network) -> pd.DataFrame:
        own = of_network(self.rows, network)
        return own.assign(row=own.index)

    def _n_splits(self, both: pd.DataFrame) -> int:
        return len(both[[*self.splits]].drop_duplicates()) if self.splits else 1

    def _of_splits(self, both: pd.DataFrame, column: str) -> np.ndarray:
        """What the first one loses in each split, mean over its seeds."""
        return (both[f"{column} of other"] - both[column]).groupby([both[key] for key in self.splits]).mean().to_numpy()

    def _saved(self, both: pd.DataFrame, column: str) -> Interval | None:
        """The share of the mean that is saved, with the interval over trainings; None where it is not counted."""
        before, after = (both[name].to_numpy(float) for name in (f"{column} of other", column))
        known = np.isfinite(before) & np.isfinite(after) & (before > 0)
        if not known.any() or not known.all():
            return None
        left = after.mean() / before.mean()
        saved = 1 - left - (after - left * before) / before.mean()  # whose mean is that of the tables, 1 - left
        if self._n_splits(both) < LEAST_SPLITS:
            return resampled_interval(saved, INDEPENDENT, 1, SAVED)
        in_splits = pd.Series(saved).groupby([both[key] for key in self.splits]).mean()
        return resampled_interval(in_splits.to_numpy(), *self.sides[:2], SAVED)

    def _over_trials(self, one: Network, other: Network, both: pd.DataFrame, lost: float) -> Interval:
        """The loss on single test trials, with that of other starts where known; no ends if trials are unknown."""
        pairs = [tuple(map(self.right, pair)) for pair in zip(both["row"], both["row of other"], strict=True)]
        if not pairs or any(right is None for pair in pairs for right in pair):
            return _alone(lost)
        by_trial = [pd.DataFrame(list(side)).mean() for side in zip(*pairs, strict=True)]
        apart = (by_trial[1] - by_trial[0]).dropna()
        if len(apart) < LEAST_SPLITS:
            return _alone(lost)
        found = resampled_interval(apart.to_numpy(), INDEPENDENT, 1, DIFFERENCES)
        starts = 0.0
        if one.apart is not None:
            starts = float(t.ppf(0.975, one.apart.freedom)) * one.apart.deviation * math.sqrt(2 / max(1, one.seeds))
        half = math.hypot(found.high - found.mean, starts), math.hypot(found.mean - found.low, starts)
        return Interval(lost, max(-1.0, lost - half[1]), min(1.0, lost + half[0]))


def _alone(mean: float) -> Interval:
    """A mean without an interval."""
    return Interval(mean, math.nan, math.nan)
