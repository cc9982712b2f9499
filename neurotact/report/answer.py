"""The answer of a run: the best network, the cheapest one within its error, and the comparison with the baselines.

The referee (`metrics.referee`) chooses on validation trials and judges on test trials; this module tells its verdicts
in sentences. Networks are chosen by whole windows, and judged as they are used: with early exit where it saves
something, and where an upper bound of what it loses is within the tolerance.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Literal, NamedTuple

from scipy.stats import binom

from neurotact.metrics import power, referee, starts
from neurotact.metrics.paired import Paired, compare_shares
from neurotact.metrics.referee import Verdict, Way
from neurotact.metrics.shares import standard_error, wilson_interval
from neurotact.metrics.starts import Spread
from neurotact.networks.exit import patience
from neurotact.report import periods

Kind = Literal["nothing learned", "unclear", "no baseline", "worse", "tie", "better", "too few trials"]
"""nothing learned: no better than guessing. unclear: better, and chance alone may do as well. too few trials: no clear
difference, and only a large one would have shown (`metrics.power`)."""
NOTHING = 0.005
"""Share of the milliseconds and of the SOPs below which early exit saves nothing."""


class Decision(NamedTuple):
    """One way to decide: its accuracy on test windows, and its mean cost.

    sops: synaptic operations. ms: length of the signal it needs. spikes: of the afferents. nJ: an estimate for encoding
    and network; None if unknown.
    """

    accuracy: float
    sops: float
    ms: float
    spikes: float
    nJ: float | None


class Network(NamedTuple):
    """One pair of refractory periods and one size; all numbers are means over seeds and splits.

    pair: refractory periods of RA-I and SA-I in ms, as "1&10". validation: accuracy on validation windows, on whole
    ones: early exit chooses no network.
    whole, early: decisions on the whole window and with early exit; early is None if there is none.
    exit_bound: upper bound of the accuracy that early exit loses, on validation trials that did not choose it; None if
    unknown. tolerance: how much may be lost.
    starts: seeds of one split, the fewest of any. apart, apart_early: how far both accuracies lie apart between starts;
    None if no network of the data set has two starts on a split.
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

    @property
    def name(self) -> str:
        size = f"{self.hidden} neurons" if self.hidden else "the network"
        return size if self.pair == periods.NONE else f"{self.pair} ms with {size}"

    @property
    def exits(self) -> bool:
        """Whether early exit is used: it saves time or SOPs, and the bound of its loss is within the tolerance."""
        if self.early is None or self.exit_bound is None or not _saves(self.whole, self.early):
            return False
        return bool(patience.is_tolerated(self.exit_bound, self.tolerance))

    @property
    def used(self) -> Decision:
        """The decision as it is used: with early exit if that is used."""
        return self.early if self.exits and self.early is not None else self.whole

    def way(self, trials: "Trials", decision: Decision | None = None) -> Way:
        """What the referee knows of it; the cost, of whole windows or of `decision`, is energy or else SOPs."""
        spent = decision or self.whole
        cost = spent.sops if spent.nJ is None else spent.nJ
        cost = math.inf if math.isnan(cost) else cost  # it is not counted
        return Way(self.validation, standard_error(self.validation, trials.validation), cost)


class Baseline(NamedTuple):
    """A classifier without spikes in its decision; nJ is None if its cost is not counted.

    rows: the rows of `baselines.csv` that it averages, one per split. right: for the referee (`Way.right`).
    """

    name: str
    validation: float
    accuracy: float
    nJ: float | None
    rows: tuple[int, ...] = ()
    right: Mapping[Any, float] | None = None

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
    than the network: a ratio is of it. None if none is. cheaper: all that take less energy and are at least as accurate
    on test trials, the cheapest first. cheapest: of all; None without any.
    """

    network: Network
    comparable: Baseline | None = None
    cheaper: tuple[Baseline, ...] = ()
    cheapest: Baseline | None = None


class Answer(NamedTuple):
    """The answer for one data set.

    best, cheapest: networks chosen by the referee. interval: 95 % interval of the test accuracy of the best one, as it
    is used. error: one standard error of its validation accuracy.
    baseline: the most accurate one on validation trials; None if there is none.
    priced: the energy of the best network, and of the cheapest one if that is another.
    rivals: the baselines that validation cannot tell from the best one. verdict: on the best network against them.
    unranked: a baseline that validation ranks lower, and that is at least as accurate on test trials; None if none is.
    guess: the accuracy of guessing, or of always predicting the most frequent class.
    uncounted: the baselines whose cost is not counted.
    """

    best: Network
    interval: tuple[float, float]
    error: float
    cheapest: Network
    baseline: Baseline | None
    priced: tuple[Priced, ...]
    rivals: tuple[Baseline, ...]
    verdict: Verdict | None
    unranked: Baseline | None
    guess: float
    trials: Trials
    uncounted: tuple[Baseline, ...] = ()

    @property
    def is_above_chance(self) -> bool:
        """Whether the best network is clearly better than guessing."""
        return self.interval[0] > self.guess

    @property
    def kind(self) -> Kind:
        """The result of the comparison. A table with a more accurate baseline contradicts `better`: that is a tie."""
        if not self.is_above_chance:
            if not power.can_beat_guessing(self.trials.test, self.guess):
                return "too few trials"
            return "nothing learned" if self.best.used.accuracy <= self.guess else "unclear"
        if self.verdict is None:
            return "no baseline"
        if power.is_too_weak(self.verdict):
            return "too few trials"
        return "tie" if self.verdict.kind == "better" and self.unranked is not None else self.verdict.kind

    @property
    def comparable(self) -> Baseline | None:
        """The baseline on signals whose energy is compared with that of the best network."""
        return self.priced[0].comparable

    @property
    def decisive(self) -> Baseline | None:
        """The baseline that decides the verdict; None if there is none."""
        return None if self.verdict is None else self.rivals[self.verdict.decisive]

    @property
    def beside(self) -> Baseline | None:
        """The baseline that stands beside the best network: the one that the verdict rests on, or the best one."""
        if self.kind in ("worse", "better"):
            return self.decisive
        is_unranked = self.kind == "tie" and self.verdict is not None and self.verdict.kind == "better"
        return self.unranked if is_unranked else self.baseline

    @property
    def named(self) -> list[Baseline]:
        """Every baseline that a sentence of the answer may name, each once."""
        of_energy = [one for each in self.priced for one in (each.comparable or each.cheapest, *each.cheaper)]
        known = [self.baseline, self.decisive, self.unranked, *_ends(self.rivals), *of_energy]
        return list({one.name: one for one in known if one is not None}.values())


Compare = Callable[[Network, Baseline], Paired | None]
"""A network, as it is used, minus a baseline on the same test trials; None if single trials are unknown."""


def answer(
    networks: Sequence[Network],
    baselines: Sequence[Baseline],
    guess: float,
    trials: Trials,
    compare: Compare = lambda network, baseline: None,
) -> Answer:
    """Choose on validation trials, judge on test trials.

    networks: at least one. compare: without single trials, the two shares are compared as those of different trials.

    >>> whole = Decision(0.9, 1000.0, 500.0, 80.0, None)
    >>> networks = [Network("1&1", 50, 3, 0.95, whole, None),
    ...             Network("5&5", 20, 3, 0.93, whole._replace(sops=400.0), None)]
    >>> found = answer(networks, [Baseline("SVM on the signals", 0.9, 0.5, None)], 0.25, Trials(45, 45))
    >>> found.kind, found.cheapest.pair
    ('better', '5&5')
    """
    ways = [network.way(trials) for network in networks]
    best, cheapest = networks[referee.best_of(ways)], networks[referee.cheapest_of(ways)]
    error = best.way(trials).error
    interval = interval_of(best, best.used, trials)
    others = [baseline.way(trials) for baseline in baselines]

    def compared(network: Network, baseline: Baseline) -> Paired:
        found = compare(network, baseline)
        return found or compare_shares(network.used.accuracy, baseline.accuracy, trials.test)

    priced = tuple(_priced(one, baselines, guess, compared) for one in dict.fromkeys((best, cheapest)))
    if not others:
        return Answer(best, interval, error, cheapest, None, priced, (), None, None, guess, trials)
    rivals = [baselines[index] for index in referee.level_with_best(others)]
    lower = [one for one in baselines if one not in rivals and one.accuracy >= best.used.accuracy]
    return Answer(
        best,
        interval,
        error,
        cheapest,
        baselines[referee.best_of(others)],
        priced,
        tuple(rivals),
        referee.judge([compared(best, rival) for rival in rivals]),
        max(lower, key=lambda one: one.accuracy, default=None),
        guess,
        trials,
        tuple(one for one in baselines if one.nJ is None),
    )


def interval_of(network: Network, decision: Decision, trials: Trials) -> tuple[float, float]:
    """The 95 % interval of the test accuracy of a network, with that of other starts where several are known.

    decision: one of both of the network.
    """
    apart = network.apart_early if decision is network.early else network.apart
    return starts.interval(decision.accuracy, trials.test, network.starts, apart)


def of_starts(outcome: Answer) -> str:
    """What the interval of the headline knows of other starts of the weights."""
    best = outcome.best
    apart = best.apart_early if best.exits else best.apart
    if apart is None:
        each = ", of each split" if best.seeds > best.starts else ""
        return f"The 95 % interval knows {starts.ONE.replace(':', f'{each}:', 1)}."
    return (
        "The 95 % interval is that of another start of the weights on other trials: accuracies of starts lie "
        f"{100 * apart.deviation:.1f} points apart (standard deviation)."
    )


def _priced(
    network: Network, baselines: Sequence[Baseline], guess: float, compared: Callable[[Network, Baseline], Paired]
) -> Priced:
    """Which baselines on signals the energy of a network is compared with, whatever validation ranks first."""
    known = [one for one in baselines if not one.is_of_spikes and one.nJ is not None]
    ordered = sorted(known, key=lambda one: (_cost(one), -one.accuracy))
    least, spent = network.used.accuracy, network.used.nJ

    def is_comparable(one: Baseline) -> bool:
        return one.accuracy > guess and (one.accuracy >= least or not _is_ahead(compared(network, one)))

    cheaper = [one for one in ordered if spent is not None and _cost(one) < spent and one.accuracy >= least]
    return Priced(network, next(filter(is_comparable, ordered), None), tuple(cheaper), next(iter(ordered), None))


def _cost(one: Baseline) -> float:
    """Infinite if it is not counted: then no other is dearer."""
    return math.inf if one.nJ is None else one.nJ


def _is_ahead(comparison: Paired) -> bool:
    """Whether the network is clearly more accurate than one baseline on test trials, taken alone.

    Without Holm's correction: a baseline that looks worse is rather not compared by energy.
    """
    return comparison.difference > 0 and comparison.is_clear


def headline(outcome: Answer) -> str:
    """Whether spiking is worth it, in one sentence: the verdict, and the numbers that it rests on."""
    if outcome.kind == "no baseline":
        said = evidence(outcome)
        return f"{said[0].upper()}{said[1:]}."
    join = ";" if outcome.kind == "too few trials" else ":"
    return f"{verdict(outcome)}{join} {evidence(outcome)}."


def verdict(outcome: Answer) -> str:
    """The verdict of the headline, without its numbers."""
    return {
        "nothing learned": _nothing_learned(outcome),
        "unclear": "Not clearly better than guessing",
        "no baseline": "Clearly better than guessing, and compared with no other classifier",
        "worse": "Spiking costs accuracy",
        "tie": f"No clear difference in accuracy{_at_energy(outcome)}",
        "better": "Spiking is more accurate",
        "too few trials": _too_few(outcome),
    }[outcome.kind]


def _too_few(outcome: Answer) -> str:
    """What the test trials cannot show."""
    if not outcome.is_above_chance or outcome.verdict is None:
        return "Too few test trials: a network that is right in all of them would not be clearly better than guessing"
    said = power.in_words(outcome.verdict)
    return f"{said[0].upper()}{said[1:]}"


def _nothing_learned(outcome: Answer) -> str:
    """That nothing holds on test trials, and whether baselines learned something that does."""
    if _learned(outcome):
        return "The network learned nothing that holds on test trials, other classifiers did"
    seen, n = outcome.best.validation, outcome.trials.validation
    holds_there = n > 0 and wilson_interval(seen, n)[0] > outcome.guess
    return "Nothing was learned that holds on test trials" if holds_there else "Nothing was learned"


def _learned(outcome: Answer) -> bool:
    """Whether a rival is clearly better than guessing on test trials: binomial tests with Holm's correction."""
    n = outcome.trials.test
    p = [float(binom.sf(round(one.accuracy * n) - 1, n, outcome.guess)) for one in outcome.rivals]
    return bool(p) and min(referee.holm(p)) < referee.LEVEL


def evidence(outcome: Answer) -> str:
    """The numbers of the headline: the best network with its interval, and what it is compared with."""
    best, (low, high) = outcome.best, outcome.interval
    share, guess = percent(best.used.accuracy), percent(outcome.guess)
    network = f"the best network{', with early exit,' if best.exits else ''} is right in"
    said = f"{network} {share} of the test windows (95 % interval {100 * low:.0f} to {100 * high:.0f} %{_other(best)})"
    if outcome.kind == "nothing learned":
        return f"{said}, which guessing reaches too ({guess}){_learned_without(outcome)}"
    if not outcome.is_above_chance:
        n_test = outcome.trials.test
        of = f"of {n_test} test trial{'' if n_test == 1 else 's'}"
        return f"{said} {of}, guessing in {guess}{_learned_without(outcome)}"
    if outcome.kind == "no baseline":
        return f"{said}; guessing reaches {guess}"
    return f"{said}, {_rivals(outcome)}"


def _other(network: Network) -> str:
    """The accuracy of the other way to decide, after that of the one that is used; empty if there is no other."""
    if network.early is None or not _saves(network.whole, network.early):
        return ""
    if network.exits:
        return f"; on whole windows {percent(network.whole.accuracy)}"
    return f"; with early exit, which is not used, {percent(network.early.accuracy)}"


def _rivals(outcome: Answer) -> str:
    """The baselines that the verdict is about, in words, with the chance of the difference."""
    verdict, decisive = outcome.verdict, outcome.decisive
    assert verdict is not None
    assert decisive is not None
    if outcome.unranked is not None and verdict.kind == "better":
        return (
            f"{outcome.unranked.name} in {percent(outcome.unranked.accuracy)}, although it is less accurate on "
            "validation windows than other baselines"
        )
    if len(outcome.rivals) == 1:
        return f"the best baseline is {decisive.name}, {percent(decisive.accuracy)} ({chance_of(verdict)})"
    if verdict.kind == "worse":
        return f"{decisive.name} in {percent(decisive.accuracy)} ({chance_of(verdict)})"
    worst, best = _ends(outcome.rivals)
    return (
        f"{len(outcome.rivals)} baselines that validation cannot tell apart in {percent(worst.accuracy)} "
        f"({worst.name}) to {percent(best.accuracy)} ({best.name}; {chance_of(verdict)})"
    )


def _ends(rivals: Sequence[Baseline]) -> list[Baseline]:
    """The least and the most accurate baseline on test windows; empty if there is none."""
    ordered = sorted(rivals, key=lambda one: one.accuracy)
    return [ordered[0], ordered[-1]] if ordered else []


def _at_energy(outcome: Answer) -> str:
    """For equal accuracy, the energy against the comparable baseline on signals; empty if about equal or unknown."""
    rival, ratio = outcome.comparable, times(outcome.priced[0])
    if rival is None or ratio is None:
        return ""
    return (
        f", and spiking takes {ratio.words} energy {ratio.than} {rival.short} with {percent(rival.accuracy)} (estimate)"
    )


class Ratio(NamedTuple):
    """A ratio in words, and the word that joins it to what it is compared with: `16 times as much`, `as`."""

    words: str
    than: str


def times(priced: Priced) -> Ratio | None:
    """The ratio of the energy of a network to that of the comparable baseline; None if about equal or unknown.

    Less is said only if every comparable baseline on signals takes more, since this one is the cheapest of them.
    """
    spent = priced.network.used.nJ
    rival = None if priced.comparable is None else priced.comparable.nJ
    if spent is None or rival is None or min(spent, rival) <= 0 or max(spent, rival) / min(spent, rival) < 1.2:
        return None
    ratio = count(float(f"{max(spent, rival) / min(spent, rival):.2g}"))
    return Ratio(f"{ratio} times as much", "as") if spent > rival else Ratio(f"{ratio} times less", "than")


def _learned_without(outcome: Answer) -> str:
    """Where no network is clearly better than guessing: whether baselines are."""
    if outcome.baseline is None:
        return ""
    worst, best = _ends(outcome.rivals)
    learned, n = _learned(outcome), len(outcome.rivals)
    if n == 1:
        verdict = "is clearly better than guessing" if learned else "is not clearly better than guessing either"
        return f"; the best baseline {verdict} ({best.name}, {percent(best.accuracy)})"
    verdict = "some of them are clearly better than guessing" if learned else "none is clearly better than guessing"
    return (
        f"; {n} baselines that validation cannot tell apart are right in {percent(worst.accuracy)} ({worst.name}) to "
        f"{percent(best.accuracy)} ({best.name}): {verdict}, after correction for {n} comparisons"
    )


def details(outcome: Answer) -> Iterator[str]:
    """What the cheapest network within the error saves and costs, in sentences; none if guessing may do as well."""
    best, cheapest = outcome.best, outcome.cheapest
    if not outcome.is_above_chance:
        return
    if math.isinf(best.way(outcome.trials).cost):
        yield f"What a decision of {best.name} costs is not counted, so none is said to be the cheapest."
    elif cheapest == best:
        yield f"The most accurate network on validation trials, {best.name}, is also the cheapest within its error."
    else:
        on = " on whole windows" if best.exits or cheapest.exits else ""
        yield (
            f"Within its error ({100 * outcome.error:.1f} points on validation trials), {cheapest.name} "
            f"{_is_cheapest(best.whole, cheapest.whole)}{on}: {_saved(best.whole, cheapest.whole)} than {best.name}, "
            f"{_lost(best.whole, cheapest.whole, outcome.trials.test)}."
        )
    for each in outcome.priced:
        yield from _early(each.network, outcome.trials.test, "it" if len(outcome.priced) == 1 else each.network.name)
    for each in outcome.priced:
        yield from _energy(each)
    if outcome.uncounted:
        names = " and of ".join(dict.fromkeys(one.name.partition(" on ")[0] for one in outcome.uncounted))
        yield f"The cost of {names} is not counted, so that no sentence on energy compares with it."


def _energy(priced: Priced) -> Iterator[str]:
    """The energy of a network with and without early exit, and of the baselines on signals that it is compared with."""
    network, fair = priced.network, priced.comparable
    whole, used = network.whole.nJ, network.used.nJ
    if whole is None or used is None or priced.cheapest is None:
        return
    early = f", {energy(used)} with early exit" if network.exits else ""
    said = f"Energy of {network.name}, an estimate of the arithmetic: {energy(whole)} for a whole window{early}"
    if fair is None:
        said += (
            f". No ratio to a baseline on signals: each is no better than guessing, or clearly less accurate than the "
            f"network; the cheapest is {_with_price(priced.cheapest)}"
        )
    else:
        ratio = times(priced)
        against = "beside" if ratio is None else f"that is {ratio.words} {ratio.than}"
        said += f"; {against} {_with_price(fair)}, the cheapest baseline on signals that is not clearly less accurate"
    more = [one for one in priced.cheaper if one != fair]
    if more:
        also = "" if fair is None or fair not in priced.cheaper else "also "
        said += f"; {also}cheaper and at least as accurate: {', '.join(map(_with_price, more))}"
    yield f"{said}."


def _with_price(one: Baseline) -> str:
    """A baseline with its energy and its accuracy on test windows."""
    spent = "an energy that is not counted" if one.nJ is None else energy(one.nJ)
    return f"{one.name} at {spent} and {percent(one.accuracy)} on test windows"


def of_refractory_periods(outcome: Answer, networks: Sequence[Network]) -> Iterator[str]:
    """What the refractory periods of the cheapest network save, against the shortest ones of the run.

    The other network is chosen by the referee among those with the shortest periods. Nothing if these are the same.
    """
    shortest = min((network.pair for network in networks), key=lambda pair: sum(periods.sizes(pair)))
    if not outcome.is_above_chance or outcome.cheapest.pair == shortest:
        return
    with_shortest = [network for network in networks if network.pair == shortest]
    other = with_shortest[referee.cheapest_of([network.way(outcome.trials) for network in with_shortest])]
    on = ", on whole windows" if other.exits or outcome.cheapest.exits else ""
    yield (
        f"Refractory periods of {outcome.cheapest.pair} ms in place of {shortest} ms: "
        f"{_saved(other.whole, outcome.cheapest.whole)}, "
        f"{_lost(other.whole, outcome.cheapest.whole, outcome.trials.test)}{on}."
    )


def gaps(outcome: Answer, cause: str) -> Iterator[str]:
    """A warning if the test accuracy of the best network or baseline is clearly below that on validation trials.

    Where the network is not clearly better than guessing on test trials, weaker evidence is enough (`referee.LEVEL` in
    place of `GAP`): something has failed, and this tells what. cause: the likely one, as the split has it.
    """
    level = referee.GAP if outcome.is_above_chance else referee.LEVEL
    network = outcome.best
    sides = [("the best network", network.validation, network.whole.accuracy)]
    if outcome.baseline is not None:
        sides.append((outcome.baseline.name, outcome.baseline.validation, outcome.baseline.accuracy))
    apart = [
        f"{name} {percent(validation)} and {percent(test)}"
        for name, validation, test in sides
        if referee.is_gap(validation, outcome.trials.validation, test, outcome.trials.test, level)
    ]
    if apart:
        yield (
            f"accuracy on test trials is clearly below that on validation trials ({'; '.join(apart)}): {cause}, so "
            "that validation does not rank classifiers for the test"
        )


def where_lost(outcome: Answer, baselines: Sequence[Baseline]) -> Iterator[str]:
    """If spiking costs accuracy: the loss of the encoding, the loss of the network, and remedies.

    The same windows are classified from the signals and from the afferents' spikes, by the classifiers chosen on
    validation trials, and by the network. A loss of one test trial or less is not reported.

    >>> network = Network("1&1", 20, 1, 0.6, Decision(0.5, 1000.0, 500.0, 80.0, None), None)
    >>> baselines = [Baseline("SVM on signals", 0.9, 0.9, 1.0), Baseline("SVM on spikes (counts)", 0.7, 0.51, 1.0)]
    >>> [words[:67] for words in where_lost(answer([network], baselines, 0.25, Trials(40, 40)), baselines)]
    ['the encoding loses 39.0 points (90.0 % by SVM on signals, 51.0 % by']
    """
    groups = [[one for one in baselines if one.is_of_spikes == of_spikes] for of_spikes in (False, True)]
    if outcome.verdict is None or outcome.verdict.kind != "worse" or not all(groups):
        return
    of_signals, of_spikes = (group[referee.best_of([one.way(outcome.trials) for one in group])] for group in groups)
    used = outcome.best.used.accuracy
    encoding, network = of_signals.accuracy - of_spikes.accuracy, of_spikes.accuracy - used
    lost = {
        f"the encoding loses {100 * encoding:.1f} points ({percent(of_signals.accuracy)} by {of_signals.name}, "
        f"{percent(of_spikes.accuracy)} by {of_spikes.name}); look at `nt.calibrate(..., compare=True)`, at other "
        "windows (`settings={'window.length_ms': ..., 'window.align': 'onset'}`), at afferents of other membranes "
        "(`settings={'encoder.tau_mem_ms': ...}`: 10 sends more spikes than 50) and at more afferents per taxel "
        "(`settings={'encoder': 'sa1-ra1-lif-graded'}`)": encoding,
        f"the network loses {100 * network:.1f} points ({percent(of_spikes.accuracy)} by {of_spikes.name}, "
        f"{percent(used)} by the best network); record more trials, or run the "
        "whole study if this is a quick one": network,
    }
    yield from (words for words, loss in lost.items() if loss > 1 / outcome.trials.test)


def _saves(whole: Decision, early: Decision) -> bool:
    return early.ms < (1 - NOTHING) * whole.ms or early.sops < (1 - NOTHING) * whole.sops


def _early(network: Network, n_test: int, name: str) -> Iterator[str]:
    """What early exit saves and loses on test trials, and whether it is used."""
    whole, early = network.whole, network.early
    if early is None:
        return
    if not _saves(whole, early):
        yield f"Early exit saves nothing here: {name} decides at the end of the window, after {milliseconds(whole.ms)}."
        return
    verb = "decides" if network.exits else "would decide"
    said = (
        f"With early exit {name} {verb} after {milliseconds(early.ms)} of {milliseconds(whole.ms)} on average: "
        f"{_saved(whole, early)}, {_lost(whole, early, n_test)}."
    )
    if network.exit_bound is None:
        yield f"{said} Whole windows are used: validation trials do not tell what early exit may lose."
        return
    used = "It is used" if network.exits else "Whole windows are used"
    yield f"{said} {used}: {patience.in_words(network.exit_bound, network.tolerance)}."


def _is_cheapest(before: Decision, after: Decision) -> str:
    """What the cheapest network is the cheapest in: energy, or SOPs if energies are unknown."""
    is_known = before.nJ is not None and after.nJ is not None
    return "is the cheapest in energy (an estimate)" if is_known else "is the cheapest in SOPs"


def _saved(before: Decision, after: Decision) -> str:
    """The change of SOPs and of energy, what is saved first."""
    if math.isnan(before.sops) or math.isnan(after.sops):
        return "SOPs are not counted"
    change = 1 - after.sops / before.sops if before.sops > 0 else 0.0
    how = f"{100 * change:.0f} % fewer SOPs" if change >= 0 else f"{-100 * change:.0f} % more SOPs"
    said = f"{how} ({count(after.sops)} against {count(before.sops)})"
    if before.nJ is None or after.nJ is None or before.nJ <= 0:
        return said
    # Conditioning and encoding cost the same for any number of spikes: energy falls by less than SOPs.
    less = 1 - after.nJ / before.nJ
    spent = f"{100 * abs(less):.2g} % {'less' if less >= 0 else 'more'} energy"
    return f"{spent}, although {said}," if less >= 0 > change else f"{said} and {spent}"


def _lost(before: Decision, after: Decision, n_test: int) -> str:
    """The change of the accuracy, in points and in test trials: with few trials, one trial is many points."""
    points = 100 * (before.accuracy - after.accuracy)
    if abs(points) < 0.05:
        return f"at the same test accuracy, {percent(after.accuracy)}"
    way = "falls" if points > 0 else "rises"
    trials = abs(points) / 100 * n_test
    of = f" ({trials:.2g} of {n_test} test trials)" if n_test and trials < 3 else ""
    return f"and test accuracy {way} by {abs(points):.1f} points{of} to {percent(after.accuracy)}"


def chance_of(verdict: Verdict) -> str:
    """The p-value of a verdict, in words.

    >>> chance_of(Verdict("better", 0, 0.0002, 45, 1)), chance_of(Verdict("tie", 2, 0.312, 45, 6))
    ('45 test trials, p < 0.001', '45 test trials, p = 0.3 after correction for 6 comparisons')
    """
    return f"{verdict.n} test trials, {p_of(verdict)}"


def p_of(verdict: Verdict) -> str:
    """The p-value alone, and for how many comparisons it is corrected."""
    p = "p < 0.001" if verdict.p < 0.001 else f"p = {verdict.p:.1g}"
    return p if verdict.opponents == 1 else f"{p} after correction for {verdict.opponents} comparisons"


def percent(share: float) -> str:
    """
    >>> percent(0.9333)
    '93.3 %'
    """
    return f"{100 * share:.1f} %"


def count(value: float) -> str:
    """A number of operations: three digits, with commas.

    >>> count(41234.0), count(7.26)
    ('41,200', '7.26')
    """
    return "not counted" if math.isnan(value) else f"{float(f'{value:.3g}'):,.6g}"


def milliseconds(value: float) -> str:
    """
    >>> milliseconds(420.4), milliseconds(0.25), milliseconds(1055.2)
    ('420 ms', '0.25 ms', '1,055 ms')
    """
    return f"{round(value) if value >= 100 else float(f'{value:.3g}'):,.6g} ms"


def energy(nJ: float) -> str:
    """
    >>> energy(0.812), energy(999.8), energy(12345.0)
    ('0.812 nJ', '1 µJ', '12.3 µJ')
    """
    return f"{nJ / 1e3:.3g} µJ" if nJ >= 999.5 else f"{nJ:.3g} nJ"
