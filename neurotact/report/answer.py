"""The answer of a run: the best network, the cheapest one within its error, and the comparison with the baseline.

Networks are chosen on validation trials and judged on test trials: the accuracy used for the choice is optimistic.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import Literal, NamedTuple

from neurotact.metrics.paired import Paired
from neurotact.metrics.shares import standard_error, wilson_interval

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

    pair: refractory periods of RA-I and SA-I in ms, as "1&10". validation: accuracy on validation windows.
    whole, early: decisions on the whole window and with early exit; early is None if there is none.
    """

    pair: str
    hidden: int
    seeds: int
    validation: float
    whole: Decision
    early: Decision | None

    @property
    def name(self) -> str:
        return f"{self.pair} ms with {self.hidden} neurons"


class Baseline(NamedTuple):
    """A classifier without spikes in its decision; nJ is None if unknown.

    rows: the rows of `baselines.csv` that it averages, one per split.
    """

    name: str
    validation: float
    accuracy: float
    nJ: float | None
    rows: tuple[int, ...] = ()

    @property
    def is_of_spikes(self) -> bool:
        """Whether its input is the afferents' spikes, and not the signals."""
        return " spikes (" in self.name


class Trials(NamedTuple):
    """Numbers of independent trials on two sides of the split: windows of one trial are not independent."""

    validation: int
    test: int


class Answer(NamedTuple):
    """The answer for one data set.

    best: the network with the highest validation accuracy (ties: the cheapest).
    interval: 95 % interval of its test accuracy. error: one standard error of its validation accuracy.
    cheapest: of the networks within that error on validation trials, the one with the fewest SOPs.
    baseline: the one with the highest validation accuracy; None if there is none.
    paired: the best network minus the baseline, on the same test trials; None if the correct trials are unknown.
    guess: the accuracy of guessing, or of always predicting the most frequent class.
    """

    best: Network
    interval: tuple[float, float]
    error: float
    cheapest: Network
    baseline: Baseline | None
    paired: Paired | None
    guess: float
    trials: Trials

    @property
    def difference(self) -> float:
        """The gain in accuracy of the best network over the baseline; 0 if there is no clear difference."""
        if self.baseline is None:
            return 0.0
        if self.paired is not None:
            return self.paired.difference if self.paired.is_clear else 0.0
        low, high = self.interval
        return 0.0 if low <= self.baseline.accuracy <= high else self.best.whole.accuracy - self.baseline.accuracy

    @property
    def is_above_chance(self) -> bool:
        """Whether the best network is clearly better than guessing."""
        return self.interval[0] > self.guess

    @property
    def kind(self) -> Kind:
        """The result of the comparison."""
        if not self.is_above_chance:
            return "nothing learned" if self.best.whole.accuracy <= self.guess else "unclear"
        if self.baseline is None:
            return "no baseline"
        return "worse" if self.difference < 0 else "better" if self.difference > 0 else "tie"


Compare = Callable[[Network, Baseline], Paired | None]
"""A network minus a baseline on the same test trials; None if unknown."""


def answer(
    networks: Sequence[Network],
    baselines: Sequence[Baseline],
    guess: float,
    trials: Trials,
    compare: Compare = lambda network, baseline: None,
) -> Answer:
    """Choose on validation trials, judge on test trials.

    networks: at least one. compare: compares the two that are chosen; without it a baseline differs clearly
    if its accuracy is outside the network's interval.

    >>> whole = Decision(0.9, 1000.0, 500.0, 80.0, None)
    >>> networks = [Network("1&1", 50, 3, 0.95, whole, None),
    ...             Network("5&5", 20, 3, 0.93, whole._replace(sops=400.0), None)]
    >>> found = answer(networks, [Baseline("SVM on the signals", 0.9, 0.5, None)], 0.25, Trials(45, 45))
    >>> found.kind, found.cheapest.pair
    ('better', '5&5')
    """
    best = max(networks, key=lambda network: (network.validation, -network.whole.sops))
    error = standard_error(best.validation, trials.validation)
    near = [network for network in networks if network.validation >= best.validation - error - 1e-12]
    cheapest = min(near, key=lambda network: (network.whole.sops, -network.validation))
    interval = wilson_interval(best.whole.accuracy, trials.test)
    # Ties: the cheapest; an unknown cost counts as zero.
    baseline = max(baselines, key=lambda one: (one.validation, -(one.nJ or 0.0)), default=None)
    paired = None if baseline is None else compare(best, baseline)
    return Answer(best, interval, error, cheapest, baseline, paired, guess, trials)


def headline(found: Answer) -> str:
    """Whether spiking is worth it, in one sentence."""
    best, (low, high) = found.best.whole, found.interval
    said = f"{percent(best.accuracy)} of the test windows (95 % interval {100 * low:.0f} to {100 * high:.0f} %)"
    rival = "" if found.baseline is None else f"{found.baseline.name}, {percent(found.baseline.accuracy)}"
    rival += "" if found.paired is None else f" ({chance_of(found.paired)})"
    guess = percent(found.guess)
    n_test = found.trials.test
    return {
        "nothing learned": f"Nothing was learned: the best network is right in {said}, which guessing reaches too "
        f"({guess}){_learned_without(found)}.",
        "unclear": f"Not clearly better than guessing: the best network is right in {said} of {n_test} test "
        f"trial{'' if n_test == 1 else 's'}, guessing in {guess}{_learned_without(found)}.",
        "no baseline": f"The best network is right in {said}; guessing reaches {guess}.",
        "worse": f"Spiking costs accuracy: the best network is right in {said}, the best baseline is {rival}.",
        "tie": f"No clear difference in accuracy{_at_energy(found)}: the best network is right in {said}, the best "
        f"baseline is {rival}.",
        "better": f"Spiking is more accurate: the best network is right in {said}, the best baseline is {rival}.",
    }[found.kind]


def _at_energy(found: Answer) -> str:
    """For two of equal accuracy, the comparison of energy; empty if it is about equal or unknown."""
    rival = None if found.baseline is None else found.baseline.nJ
    spent = found.best.whole.nJ
    if rival is None or spent is None or not (ratio := _times(spent, rival)):
        return ""
    return f", and spiking takes{ratio.removeprefix(',')} energy (estimate)"


def _learned_without(found: Answer) -> str:
    """Where no network is clearly better than guessing: whether the best baseline is."""
    if found.baseline is None:
        return ""
    learned = wilson_interval(found.baseline.accuracy, found.trials.test)[0] > found.guess
    verdict = "is clearly better than guessing" if learned else "is not clearly better than guessing either"
    return f"; the best baseline {verdict} ({found.baseline.name}, {percent(found.baseline.accuracy)})"


def details(found: Answer) -> Iterator[str]:
    """What the cheapest network within the error saves and costs, in sentences; none if guessing may do as well."""
    best, cheapest = found.best, found.cheapest
    if not found.is_above_chance:
        return
    if cheapest == best:
        yield f"The most accurate network on validation trials, {best.name}, is also the cheapest within its error."
    else:
        yield (
            f"Within its error ({100 * found.error:.1f} points on validation trials), {cheapest.name} is the cheapest: "
            f"{_saved(best.whole, cheapest.whole)} than {best.name}, "
            f"{_lost(best.whole, cheapest.whole, found.trials.test)}."
        )
    if cheapest.early is not None:
        yield _early(cheapest.whole, cheapest.early, found.trials.test)
    rival = found.baseline
    spent = (cheapest.early or cheapest.whole).nJ
    if rival is not None and rival.nJ is not None and spent is not None:
        yield (
            f"Energy, an estimate of the arithmetic: {energy(spent)} against {energy(rival.nJ)} for {rival.name}"
            f"{_times(spent, rival.nJ)}."
        )


def where_lost(found: Answer, baselines: Sequence[Baseline]) -> Iterator[str]:
    """If spiking costs accuracy: the loss of the encoding, the loss of the network, and remedies.

    The same windows are classified from the signals and from the afferents' spikes, by the classifiers chosen on
    validation trials, and by the network. A loss of one test trial or less is not reported.

    >>> network = Network("1&1", 20, 1, 0.6, Decision(0.5, 1000.0, 500.0, 80.0, None), None)
    >>> baselines = [Baseline("SVM on signals", 0.9, 0.9, 1.0), Baseline("SVM on spikes (counts)", 0.7, 0.51, 1.0)]
    >>> [words[:67] for words in where_lost(answer([network], baselines, 0.25, Trials(40, 40)), baselines)]
    ['the encoding loses 39.0 points (90.0 % by SVM on signals, 51.0 % by']
    """
    rivals = [[one for one in baselines if one.is_of_spikes == of_spikes] for of_spikes in (False, True)]
    if found.difference >= 0 or not all(rivals):
        return
    of_signals, of_spikes = (max(group, key=lambda one: one.validation) for group in rivals)
    encoding = of_signals.accuracy - of_spikes.accuracy
    network = of_spikes.accuracy - found.best.whole.accuracy
    lost = {
        f"the encoding loses {100 * encoding:.1f} points ({percent(of_signals.accuracy)} by {of_signals.name}, "
        f"{percent(of_spikes.accuracy)} by {of_spikes.name}); look at neurotact calibrate --compare, at other windows "
        "(--window-ms, --set window.align=onset) and at more afferents per taxel (--set "
        "encoder=sa1-ra1-lif-graded)": encoding,
        f"the network loses {100 * network:.1f} points ({percent(of_spikes.accuracy)} by {of_spikes.name}, "
        f"{percent(found.best.whole.accuracy)} by the best network); record more trials, or run the "
        "whole study if this is --quick": network,
    }
    yield from (words for words, loss in lost.items() if loss > 1 / found.trials.test)


def _early(whole: Decision, early: Decision, n_test: int) -> str:
    if early.ms >= (1 - NOTHING) * whole.ms and early.sops >= (1 - NOTHING) * whole.sops:
        return f"Early exit saves nothing here: it decides at the end of the window, after {milliseconds(whole.ms)}."
    return (
        f"With early exit it decides after {milliseconds(early.ms)} of {milliseconds(whole.ms)} on average: "
        f"{_saved(whole, early)}, {_lost(whole, early, n_test)}."
    )


def _saved(before: Decision, after: Decision) -> str:
    change = 1 - after.sops / before.sops if before.sops > 0 else 0.0
    how = f"{100 * change:.0f} % fewer SOPs" if change >= 0 else f"{-100 * change:.0f} % more SOPs"
    said = f"{how} ({count(after.sops)} against {count(before.sops)})"
    if before.nJ is None or after.nJ is None or before.nJ <= 0:
        return said
    # Conditioning and encoding cost the same for any number of spikes: energy falls by less than SOPs.
    less = 1 - after.nJ / before.nJ
    return f"{said} and {100 * abs(less):.2g} % {'less' if less >= 0 else 'more'} energy"


def _times(spent: float, rival: float) -> str:
    """The ratio of the energy of a network to its rival's, in words; empty if they are about equal.

    >>> _times(366.0, 23.5), _times(2910.0, 10.0), _times(10.0, 25.0), _times(11.0, 10.0)
    (', 16 times as much', ', 290 times as much', ', 2.5 times less', '')
    """
    if min(spent, rival) <= 0 or max(spent, rival) / min(spent, rival) < 1.2:
        return ""
    ratio = count(float(f"{max(spent, rival) / min(spent, rival):.2g}"))
    return f", {ratio} times as much" if spent > rival else f", {ratio} times less"


def _lost(before: Decision, after: Decision, n_test: int) -> str:
    """The change of the accuracy, in points and in test trials: with few trials, one trial is many points."""
    points = 100 * (before.accuracy - after.accuracy)
    if abs(points) < 0.05:
        return f"at the same test accuracy, {percent(after.accuracy)}"
    way = "falls" if points > 0 else "rises"
    trials = abs(points) / 100 * n_test
    of = f" ({trials:.2g} of {n_test} test trials)" if n_test and trials < 3 else ""
    return f"and test accuracy {way} by {abs(points):.1f} points{of} to {percent(after.accuracy)}"


def chance_of(paired: Paired) -> str:
    """The p-value of the difference, in words.

    >>> chance_of(Paired(0.1, 0.0002, 45)), chance_of(Paired(0.1, 0.0312, 45))
    ('paired over 45 test trials, p < 0.001', 'paired over 45 test trials, p = 0.03')
    """
    p = "p < 0.001" if paired.p < 0.001 else f"p = {paired.p:.1g}"
    return f"paired over {paired.n} test trials, {p}"


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
    >>> milliseconds(420.4), milliseconds(0.25)
    ('420 ms', '0.25 ms')
    """
    return f"{float(f'{value:.3g}'):,.6g} ms"


def energy(nJ: float) -> str:
    """
    >>> energy(0.812), energy(12345.0)
    ('0.812 nJ', '12.3 µJ')
    """
    return f"{nJ / 1e3:.3g} µJ" if nJ >= 1e3 else f"{nJ:.3g} nJ"
