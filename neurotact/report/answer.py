"""The answer of a study: the best way to decide, the cheapest one within its error, and the comparison with the others.

A row of an answer is a way to decide: a network or a baseline of a study of networks, or a configuration of a paper's
way (`way_answer`). The referee (`metrics.referee`) chooses on validation trials and judges on test trials; `sentences`
tells its verdicts. Networks are chosen by whole windows, and judged as they are used: with early exit where it saves
something, and where an upper bound of what it loses is within the tolerance.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Generic, Literal, NamedTuple, Protocol, TypeVar

from neurotact.metrics import power, referee, starts
from neurotact.metrics.paired import Paired, compare_shares
from neurotact.metrics.referee import Verdict, Way
from neurotact.metrics.shares import standard_error
from neurotact.metrics.starts import Spread
from neurotact.networks.exit import patience
from neurotact.report import periods
from neurotact.report.wording import Measure

Kind = Literal["nothing learned", "unclear", "no baseline", "untested", "worse", "tie", "better", "too few trials"]
"""nothing learned: no better than guessing. unclear: better, and chance alone may do as well. untested: no test is
possible. too few trials: no clear difference, and only a large one would have shown (`metrics.power`)."""
ByList = tuple[tuple[str, float], ...]
"""The energy in nJ by the name of each price list."""
NOTHING = 0.005
"""Share of the milliseconds and of the SOPs below which early exit saves nothing."""


class Row(Protocol):
    """What an answer asks of a way to decide.

    accuracy: on test trials, as it is used; of a way that has another score, that score.
    """

    @property
    def name(self) -> str: ...

    @property
    def accuracy(self) -> float: ...


class Decision(NamedTuple):
    """One way to decide: its accuracy on test windows, and its mean cost.

    sops: synaptic operations. ms: length of the signal it needs. spikes: of the afferents. nJ: an estimate for encoding
    and network; None if unknown. by_list: the same by the name of each price list that counts it.
    """

    accuracy: float
    sops: float
    ms: float
    spikes: float
    nJ: float | None
    by_list: ByList = ()


class Network(NamedTuple):
    """One pair of refractory periods and one size; all numbers are means over seeds and splits.

    pair: refractory periods of RA-I and SA-I in ms, as "1&10". validation: accuracy on validation windows, on whole
    ones: early exit chooses no network.
    whole, early: decisions on the whole window and with early exit; early is None if there is none.
    exit_bound: upper bound of the accuracy that early exit loses, on validation trials that did not choose it; None if
    unknown. tolerance: how much may be lost.
    starts: seeds of one split, the fewest of any. apart, apart_early: how far both accuracies lie apart between starts;
    None if no network of the data set has two starts on a split, and of one that has a single solution.
    is_part: whether it is no RSNN, so that hidden = 0 may also say that its neurons are not counted. layers: the
    neurons of each layer, as "20+10"; empty for one layer.
    """

    pair: str
    hidden: int
    seeds: int
    validation: float
    whole: Decision
    early: Decision | None
    exit_bound: float | None = None
    tolerance: float = 0.01
    starts: int = 1
    apart: Spread | None = None
    apart_early: Spread | None = None
    is_part: bool = False
    layers: str = ""

    @property
    def is_fitted(self) -> bool:
        """Whether it has no hidden layer: then one fit of its weights is the best, wherever it starts."""
        return not (self.hidden or self.is_part)

    @property
    def size(self) -> str:
        """Its hidden neurons in words; empty where they are not counted."""
        return "no hidden layer" if self.is_fitted else f"{self.layers or self.hidden} neurons" if self.hidden else ""

    @property
    def with_size(self) -> str:
        """The same after a noun, with a space before it."""
        return " without a hidden layer" if self.is_fitted else self.size and f" with {self.size}"

    @property
    def name(self) -> str:
        if self.pair == periods.NONE:
            return self.size or "the network"
        return f"{self.pair} ms{self.with_size or ' with the network'}"

    @property
    def saves(self) -> bool:
        """Whether early exit saves time or SOPs."""
        if self.early is None:
            return False
        return self.early.ms < (1 - NOTHING) * self.whole.ms or self.early.sops < (1 - NOTHING) * self.whole.sops

    @property
    def exits(self) -> bool:
        """Whether early exit is used: it saves time or SOPs, and the bound of its loss is within the tolerance."""
        if self.exit_bound is None or not self.saves:
            return False
        return bool(patience.is_tolerated(self.exit_bound, self.tolerance))

    @property
    def used(self) -> Decision:
        """The decision as it is used: with early exit if that is used."""
        return self.early if self.exits and self.early is not None else self.whole

    @property
    def accuracy(self) -> float:
        """On test windows, as it is used."""
        return self.used.accuracy

    def way(self, trials: "Trials", decision: Decision | None = None) -> Way:
        """What the referee knows of it; the cost, of whole windows or of `decision`, is energy or else SOPs."""
        spent = decision or self.whole
        cost = spent.sops if spent.nJ is None else spent.nJ
        cost = math.inf if math.isnan(cost) else cost  # it is not counted
        return Way(self.validation, standard_error(self.validation, trials.validation), cost)


class Baseline(NamedTuple):
    """A classifier without spikes in its decision; nJ is None if its cost is not counted.

    rows: the rows of `baselines.csv` that it averages, one per split. right: for the referee (`Way.right`). by_list: as
    of a `Decision`. bytes: for parameters and state; None if not counted.
    """

    name: str
    validation: float
    accuracy: float
    nJ: float | None
    rows: tuple[int, ...] = ()
    right: Mapping[Any, float] | None = None
    by_list: ByList = ()
    bytes: float | None = None

    @property
    def is_of_spikes(self) -> bool:
        """Whether its input is the afferents' spikes, and not the signals."""
        return " spikes (" in self.name

    @property
    def short(self) -> str:
        """Its name without the features."""
        return self.name.partition(" (")[0]

    def way(self, trials: "Trials") -> Way:
        """What the referee knows of it."""
        error = standard_error(self.validation, trials.validation)
        return Way(self.validation, error, _cost(self), self.right)


class Trials(NamedTuple):
    """Numbers of independent trials on two sides of the split: windows of one trial are not independent."""

    validation: int
    test: int


class Priced(NamedTuple):
    """A network as it is used, and baselines on signals to compare its energy with; of those, energy is known.

    comparable: the cheapest that is better than guessing and that test trials do not show to be clearly less accurate
    than the network: a ratio is of it. None if none is. comparables: all such, the cheapest first. cheaper: all that
    take less energy and are at least as accurate on test trials, the cheapest first. cheapest: of all; None without
    any.
    """

    network: Network
    comparable: Baseline | None = None
    cheaper: tuple[Baseline, ...] = ()
    cheapest: Baseline | None = None
    comparables: tuple[Baseline, ...] = ()


R = TypeVar("R", bound=Row)
Other = TypeVar("Other", bound=Row)


class Answer(NamedTuple, Generic[R, Other]):
    """The answer for one data set, task or rule of a run.

    rows: all that are compared. best, cheapest: of them, chosen by the referee. error: one standard error of the
    validation accuracy of the best. spiking: the best that spikes, which is compared; None if none is known to.
    others: all without spikes. baseline: the most accurate of them on validation trials; None if there is none.
    rivals: those that validation cannot tell from that one. verdict: on `spiking` against them; None if there are none,
    or no test. guess: the accuracy of guessing, or of always predicting the most frequent class. setting: its name;
    empty where there is only one. measure: what the scores and costs are. is_validated: whether validation chooses, and
    not what is reported. untested: why there is no test; empty if there is one. least: the least difference that the
    test can show; None where it is that of so many trials. doubts: what else the reader must know, in sentences. NaN is
    what is not known.

    is_chosen: whether one network was chosen for its refractory period: then it is both best and cheapest, and `ahead`
    is the one that the referee finds best, if that is another, with its own verdict.
    Of networks alone: interval: 95 % interval of the test accuracy of the best one, as it is used. trials: of both
    sides. priced: the energy of the best network, and of the cheapest one if that is another. prices: the name of the
    list by which energies are.
    """

    rows: tuple[R, ...]
    best: R
    cheapest: R
    error: float
    spiking: R | None
    others: tuple[Other, ...]
    baseline: Other | None
    rivals: tuple[Other, ...]
    verdict: Verdict | None
    guess: float
    setting: str = ""
    measure: Measure = Measure()
    is_validated: bool = True
    untested: str = ""
    least: float | None = None
    doubts: tuple[str, ...] = ()
    interval: tuple[float, float] = (math.nan, math.nan)
    trials: Trials = Trials(0, 0)
    priced: tuple[Priced, ...] = ()
    prices: str = ""
    is_chosen: bool = False
    ahead: tuple[R, Verdict | None] | None = None

    @property
    def called(self) -> str:
        """The network that the answer is of, in a word."""
        return "chosen" if self.is_chosen else "best"

    @property
    def leader(self) -> R:
        """The best row on validation trials, whatever it costs."""
        return self.ahead[0] if self.ahead else self.best

    @property
    def shown(self) -> R:
        """The row that the headline and the figures are of."""
        return self.spiking or self.best

    @property
    def is_above_chance(self) -> bool:
        """Whether the best network is clearly better than guessing; where no interval is known, it is not doubted."""
        return math.isnan(self.interval[0]) or self.interval[0] > self.guess

    @property
    def kind(self) -> Kind:
        """The result of the comparison. A table with a more accurate baseline contradicts `better`: that is a tie."""
        if not self.is_above_chance:
            if not power.can_beat_guessing(self.trials.test, self.guess):
                return "too few trials"
            return "nothing learned" if self.best.accuracy <= self.guess else "unclear"
        if self.spiking is None or self.baseline is None:
            return "no baseline"
        if self.verdict is None:
            return "untested"
        if power.is_too_weak(self.verdict, self.least):
            return "too few trials"
        return "tie" if self.is_contradicted else self.verdict.kind

    @property
    def unranked(self) -> Other | None:
        """One without spikes that validation ranks lower, and that is at least as accurate as the one that spikes."""
        least = math.inf if self.spiking is None else self.spiking.accuracy
        lower = [one for one in self.others if one not in self.rivals and one.accuracy >= least]
        return max(lower, key=lambda one: one.accuracy, default=None)

    @property
    def is_contradicted(self) -> bool:
        """Whether the verdict is `better`, and a row that validation ranks lower is as accurate."""
        return self.verdict is not None and self.verdict.kind == "better" and self.unranked is not None

    @property
    def comparable(self) -> Baseline | None:
        """The baseline on signals whose energy is compared with that of the best network."""
        return self.priced[0].comparable

    @property
    def decisive(self) -> Other | None:
        """The rival that decides the verdict; None if there is none."""
        return None if self.verdict is None else self.rivals[self.verdict.decisive]

    @property
    def beside(self) -> Other | None:
        """What stands beside the best that spikes: the rival that the verdict rests on, or the best baseline."""
        if self.spiking is None:
            return None
        if self.kind in ("worse", "better"):
            return self.decisive
        return self.unranked if self.kind == "tie" and self.is_contradicted else self.baseline

    @property
    def ends(self) -> list[Other]:
        """The least and the most accurate rival; empty if there is none."""
        ordered = sorted(self.rivals, key=lambda one: one.accuracy)
        return [ordered[0], ordered[-1]] if ordered else []

    @property
    def named(self) -> list[Any]:
        """Every row without spikes that a sentence of the answer may name, each once."""
        of_energy = [one for each in self.priced for one in (each.comparable or each.cheapest, *each.cheaper)]
        known = [self.baseline, self.decisive, self.unranked, *self.ends, *of_energy]
        return list({one.name: one for one in known if one is not None}.values())


OfNetworks = Answer[Network, Baseline]
Compare = Callable[[Network, Baseline], Paired | None]
"""A network, as it is used, minus a baseline on the same test trials; None if single trials are unknown."""


def answer(
    networks: Sequence[Network],
    baselines: Sequence[Baseline],
    guess: float,
    trials: Trials,
    compare: Compare = lambda network, baseline: None,
    prices: str = "",
    chosen: Network | None = None,
) -> OfNetworks:
    """Choose on validation trials, judge on test trials.

    networks: at least one. prices: the name of the list of energies. compare: without single trials, the two shares are
    compared as those of different trials. chosen: the network that the whole answer is of; without it, those that the
    referee finds best and cheapest.

    >>> whole = Decision(0.9, 1000.0, 500.0, 80.0, None)
    >>> networks = [Network("1&1", 50, 3, 0.95, whole, None),
    ...             Network("5&5", 20, 3, 0.93, whole._replace(sops=400.0), None)]
    >>> found = answer(networks, [Baseline("SVM on the signals", 0.9, 0.5, None)], 0.25, Trials(45, 45))
    >>> found.kind, found.cheapest.pair
    ('better', '5&5')
    """
    ways = [network.way(trials) for network in networks]
    leader, cheapest = networks[referee.best_of(ways)], networks[referee.cheapest_of(ways)]
    best, cheapest = (leader, cheapest) if chosen is None else (chosen, chosen)

    def compared(network: Network, baseline: Baseline) -> Paired:
        found = compare(network, baseline)
        return found or compare_shares(network.accuracy, baseline.accuracy, trials.test)

    baseline, rivals = opponents_of(baselines, [one.way(trials) for one in baselines])

    def judged(network: Network) -> Verdict | None:
        return referee.judge([compared(network, rival) for rival in rivals]) if rivals else None

    return Answer(
        tuple(networks),
        best,
        cheapest,
        best.way(trials).error,
        best,
        tuple(baselines),
        baseline,
        rivals,
        judged(best),
        guess,
        interval=interval_of(best, best.used, trials),
        trials=trials,
        priced=tuple(_priced(one, baselines, guess, compared) for one in dict.fromkeys((best, cheapest))),
        prices=prices,
        is_chosen=chosen is not None,
        ahead=None if leader is best else (leader, judged(leader)),
    )


def opponents_of(others: Sequence[Other], ways: Sequence[Way]) -> tuple[Other | None, tuple[Other, ...]]:
    """The best of those without spikes, and all that validation cannot tell from it; `ways`: of each."""
    if not others:
        return None, ()
    return others[referee.best_of(ways)], tuple(others[index] for index in referee.level_with_best(ways))


def interval_of(network: Network, decision: Decision, trials: Trials) -> tuple[float, float]:
    """The 95 % interval of the test accuracy of a network, with that of other starts where several are known.

    decision: one of both of the network.
    """
    apart = network.apart_early if decision is network.early else network.apart
    return starts.interval(decision.accuracy, trials.test, network.starts, apart)


def _priced(
    network: Network, baselines: Sequence[Baseline], guess: float, compared: Callable[[Network, Baseline], Paired]
) -> Priced:
    """Which baselines on signals the energy of a network is compared with, whatever validation ranks first."""
    known = [one for one in baselines if not one.is_of_spikes and one.nJ is not None]
    ordered = sorted(known, key=lambda one: (_cost(one), -one.accuracy))
    least, spent = network.accuracy, network.used.nJ

    def is_comparable(one: Baseline) -> bool:
        return one.accuracy > guess and (one.accuracy >= least or not _is_ahead(compared(network, one)))

    cheaper = [one for one in ordered if spent is not None and _cost(one) < spent and one.accuracy >= least]
    comparables = tuple(filter(is_comparable, ordered))
    first, cheapest = next(iter(comparables), None), next(iter(ordered), None)
    return Priced(network, first, tuple(cheaper), cheapest, comparables)


def _cost(one: Baseline) -> float:
    """Infinite if it is not counted: then no other is dearer."""
    return math.inf if one.nJ is None else one.nJ


def _is_ahead(comparison: Paired) -> bool:
    """Whether the network is clearly more accurate than one baseline on test trials, taken alone.

    Without Holm's correction: a baseline that looks worse is rather not compared by energy.
    """
    return comparison.difference > 0 and comparison.is_clear
