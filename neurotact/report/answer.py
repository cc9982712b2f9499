"""The answer of a run: the best network, the cheapest one within its error, and the comparison with the baselines.

The referee (`metrics.referee`) chooses on validation trials and judges on test trials; this module tells its verdicts
in sentences. Networks are judged as they are used: with early exit where it saves something.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Literal, NamedTuple

from scipy.stats import binom

from neurotact.metrics import referee
from neurotact.metrics.paired import Paired, compare_shares
from neurotact.metrics.referee import Verdict, Way
from neurotact.metrics.shares import standard_error, wilson_interval
from neurotact.report import periods

Kind = Literal["nothing learned", "unclear", "no baseline", "worse", "tie", "better"]
"""nothing learned: no better than guessing. unclear: better, and chance alone may do as well."""
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

    pair: refractory periods of RA-I and SA-I in ms, as "1&10". validation, early_validation: accuracy on validation
    windows, on whole windows and with early exit; the latter is None where validation windows cannot tell it.
    whole, early: decisions on the whole window and with early exit; early is None if there is none.
    """

    pair: str
    hidden: int
    seeds: int
    validation: float
    whole: Decision
    early: Decision | None
    early_validation: float | None = None

    @property
    def name(self) -> str:
        size = f"{self.hidden} neurons"
        return size if self.pair == periods.NONE else f"{self.pair} ms with {size}"

    @property
    def exits(self) -> bool:
        """Whether early exit is advised: it saves time or SOPs, and its accuracy on validation windows is known."""
        return self.early is not None and self.early_validation is not None and _saves(self.whole, self.early)

    @property
    def used(self) -> Decision:
        """The decision as it is used: with early exit if that is advised."""
        return self.early if self.exits and self.early is not None else self.whole

    def way(self, trials: "Trials") -> Way:
        """What the referee knows of the network, as it is used; its cost is energy, or SOPs if that is unknown."""
        validation = self.early_validation if self.exits and self.early_validation is not None else self.validation
        cost = self.used.sops if self.used.nJ is None else self.used.nJ
        return Way(validation, standard_error(validation, trials.validation), cost)


class Baseline(NamedTuple):
    """A classifier without spikes in its decision; nJ is None if unknown.

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
        """What the referee knows of it; an unknown cost counts as zero."""
        error = standard_error(self.validation, trials.validation)
        return Way(self.validation, error, self.nJ or 0.0, self.right)


class Trials(NamedTuple):
    """Numbers of independent trials on two sides of the split: windows of one trial are not independent."""

    validation: int
    test: int


class Answer(NamedTuple):
    """The answer for one data set.

    best, cheapest: networks chosen by the referee. interval: 95 % interval of the test accuracy of the best one, as it
    is used. error: one standard error of its validation accuracy.
    baseline: the most accurate one on validation trials; None if there is none. cheapest_on_signals: the cheapest
    baseline on signals within one standard error of the best baseline; None if none is.
    comparable: the cheapest of those within the error that is better than guessing and that test trials do not show to
    be clearly worse than the best network: ratios of energy are of it; None if none is.
    rivals: the baselines that validation cannot tell from the best one. verdict: on the best network against them.
    unranked: a baseline that validation ranks lower, and that is at least as accurate on test trials; None if none is.
    guess: the accuracy of guessing, or of always predicting the most frequent class.
    """

    best: Network
    interval: tuple[float, float]
    error: float
    cheapest: Network
    baseline: Baseline | None
    cheapest_on_signals: Baseline | None
    comparable: Baseline | None
    rivals: tuple[Baseline, ...]
    verdict: Verdict | None
    unranked: Baseline | None
    guess: float
    trials: Trials

    @property
    def is_above_chance(self) -> bool:
        """Whether the best network is clearly better than guessing."""
        return self.interval[0] > self.guess

    @property
    def kind(self) -> Kind:
        """The result of the comparison. A table with a more accurate baseline contradicts `better`: that is a tie."""
        if not self.is_above_chance:
            return "nothing learned" if self.best.used.accuracy <= self.guess else "unclear"
        if self.verdict is None:
            return "no baseline"
        return "tie" if self.verdict.kind == "better" and self.unranked is not None else self.verdict.kind

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
        known = [
            self.baseline,
            self.cheapest_on_signals,
            self.comparable,
            self.decisive,
            self.unranked,
            *_ends(self.rivals),
        ]
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
    interval = wilson_interval(best.used.accuracy, trials.test)
    others = [baseline.way(trials) for baseline in baselines]
    if not others:
        return Answer(best, interval, error, cheapest, None, None, None, (), None, None, guess, trials)
    level = referee.level_with_best(others)
    rivals = [baselines[index] for index in level]
    comparisons = [
        compare(best, rival) or compare_shares(best.used.accuracy, rival.accuracy, trials.test) for rival in rivals
    ]
    tested = dict(zip(level, comparisons, strict=True))  # whatever is within the error is a rival, too
    on_signals = [index for index in referee.within_error(others) if not baselines[index].is_of_spikes]
    near = sorted((baselines[index].nJ or 0.0, index) for index in on_signals)
    fair = [index for _, index in near if baselines[index].accuracy > guess and not _is_ahead(tested[index])]
    lower = [one for one in baselines if one not in rivals and one.accuracy >= best.used.accuracy]
    return Answer(
        best,
        interval,
        error,
        cheapest,
        baselines[referee.best_of(others)],
        baselines[near[0][1]] if near else None,
        baselines[fair[0]] if fair else None,
        tuple(rivals),
        referee.judge(comparisons),
        max(lower, key=lambda one: one.accuracy, default=None),
        guess,
        trials,
    )


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
    return f"{verdict(outcome)}: {evidence(outcome)}."


def verdict(outcome: Answer) -> str:
    """The verdict of the headline, without its numbers."""
    return {
        "nothing learned": _nothing_learned(outcome),
        "unclear": "Not clearly better than guessing",
        "no baseline": "Clearly better than guessing, and compared with no other classifier",
        "worse": "Spiking costs accuracy",
        "tie": f"No clear difference in accuracy{_at_energy(outcome)}",
        "better": "Spiking is more accurate",
    }[outcome.kind]


def _nothing_learned(outcome: Answer) -> str:
    """That nothing holds on test trials, and whether baselines learned something that does."""
    if _learned(outcome):
        return "The network learned nothing that holds on test trials, other classifiers did"
    seen, n = outcome.best.way(outcome.trials).validation, outcome.trials.validation
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
    said = f"{network} {share} of the test windows (95 % interval {100 * low:.0f} to {100 * high:.0f} %)"
    if outcome.kind == "nothing learned":
        return f"{said}, which guessing reaches too ({guess}){_learned_without(outcome)}"
    if outcome.kind == "unclear":
        n_test = outcome.trials.test
        of = f"of {n_test} test trial{'' if n_test == 1 else 's'}"
        return f"{said} {of}, guessing in {guess}{_learned_without(outcome)}"
    if outcome.kind == "no baseline":
        return f"{said}; guessing reaches {guess}"
    return f"{said}, {_rivals(outcome)}"


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
    rival, spent = outcome.comparable, outcome.best.used.nJ
    if rival is None or spent is None or (ratio := times(outcome, spent)) is None:
        return ""
    return (
        f", and spiking takes {ratio.words} energy {ratio.than} {rival.short} with {percent(rival.accuracy)} (estimate)"
    )


class Ratio(NamedTuple):
    """A ratio in words, and the word that joins it to what it is compared with: `16 times as much`, `as`."""

    words: str
    than: str


def times(outcome: Answer, spent: float) -> Ratio | None:
    """The ratio of an energy to that of the comparable baseline on signals; None if about equal or unknown.

    Less is said only if it is below that of every baseline on signals that validation cannot tell from the best.
    """
    rival = None if outcome.comparable is None else outcome.comparable.nJ
    if rival is None or min(spent, rival) <= 0 or max(spent, rival) / min(spent, rival) < 1.2:
        return None
    ratio = count(float(f"{max(spent, rival) / min(spent, rival):.2g}"))
    if spent > rival:
        return Ratio(f"{ratio} times as much", "as")
    level = (one.nJ for one in outcome.rivals if not one.is_of_spikes and one.nJ is not None)
    return None if any(energy_nJ <= spent for energy_nJ in level) else Ratio(f"{ratio} times less", "than")


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
    if cheapest == best:
        yield f"The most accurate network on validation trials, {best.name}, is also the cheapest within its error."
    else:
        yield (
            f"Within its error ({100 * outcome.error:.1f} points on validation trials), {cheapest.name} "
            f"{_is_cheapest(best.used, cheapest.used)}: {_saved(best.used, cheapest.used)} than {best.name}, "
            f"{_lost(best.used, cheapest.used, outcome.trials.test)}."
        )
    if cheapest.early is not None:
        said = _early(cheapest.whole, cheapest.early, outcome.trials.test)
        is_known = cheapest.early_validation is not None or not _saves(cheapest.whole, cheapest.early)
        yield said if is_known else f"{said} Whole windows are used, since validation cannot tell this loss."
    yield from _energy(outcome)


def _energy(outcome: Answer) -> Iterator[str]:
    """The energy of the cheapest network with and without early exit, and of baselines on signals.

    Only the best network has a ratio, the one of the headline.
    """
    whole, used, rival = outcome.cheapest.whole.nJ, outcome.cheapest.used.nJ, outcome.cheapest_on_signals
    if whole is None or used is None or rival is None or rival.nJ is None:
        return
    early = f", {energy(used)} with early exit" if outcome.cheapest.exits else ""
    both = f"{energy(whole)} for a whole window{early}"
    ratio = times(outcome, used) if outcome.cheapest == outcome.best else None
    against = "beside " if ratio is None else f"that is {ratio.words} {ratio.than} "
    said = f"Energy of {outcome.cheapest.name}, an estimate of the arithmetic: {both}"
    of, fair = "the cheapest baseline on signals within the error of the best one", outcome.comparable
    if fair == rival:
        yield f"{said}; {against}{_priced(rival)}, {of}."
    elif fair is None:
        yield (
            f"{said}. No ratio to {of}, {_priced(rival)}: it is no better than guessing, or clearly less accurate than "
            "the network."
        )
    else:
        yield (
            f"{said}; {against}{_priced(fair)}, the cheapest that test trials do not show to be worse than the "
            f"network; cheaper, but worse, is {_priced(rival)}, {of}."
        )


def _priced(one: Baseline) -> str:
    """A baseline with its energy and its accuracy on test windows."""
    spent = "unknown energy" if one.nJ is None else energy(one.nJ)
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
    yield (
        f"Refractory periods of {outcome.cheapest.pair} ms in place of {shortest} ms: "
        f"{_saved(other.used, outcome.cheapest.used)}, {_lost(other.used, outcome.cheapest.used, outcome.trials.test)}."
    )


def gaps(outcome: Answer, cause: str) -> Iterator[str]:
    """A warning if the test accuracy of the best network or baseline is clearly below that on validation trials.

    Where the network is not clearly better than guessing on test trials, weaker evidence is enough (`referee.LEVEL` in
    place of `GAP`): something has failed, and this tells what. cause: the likely one, as the split has it.
    """
    level = referee.GAP if outcome.is_above_chance else referee.LEVEL
    network = outcome.best
    sides = [("the best network", network.way(outcome.trials).validation, network.used.accuracy)]
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


def _early(whole: Decision, early: Decision, n_test: int) -> str:
    if not _saves(whole, early):
        return f"Early exit saves nothing here: it decides at the end of the window, after {milliseconds(whole.ms)}."
    return (
        f"With early exit it decides after {milliseconds(early.ms)} of {milliseconds(whole.ms)} on average: "
        f"{_saved(whole, early)}, {_lost(whole, early, n_test)}."
    )


def _is_cheapest(before: Decision, after: Decision) -> str:
    """What the cheapest network is the cheapest in: energy, or SOPs if energies are unknown."""
    is_known = before.nJ is not None and after.nJ is not None
    return "is the cheapest in energy (an estimate)" if is_known else "is the cheapest in SOPs"


def _saved(before: Decision, after: Decision) -> str:
    """The change of SOPs and of energy, what is saved first."""
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
    return f"{float(f'{value:.3g}'):,.6g}"


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
