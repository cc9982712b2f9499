"""The first screen of a report: three figures of the best network, and the table that they are rows of."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import pandas as pd

from neurotact.metrics import referee
from neurotact.metrics.shares import wilson_interval
from neurotact.report import answer as answers
from neurotact.report import periods
from neurotact.report.answer import Answer, Baseline, Decision, Network, Trials
from neurotact.report.page import Figure, Table

HEADS = ["t_ref, neurons", "test accuracy (95 % interval)", "input spikes", "SOPs", "ms to decision", "energy estimate"]


class _Row(NamedTuple):
    """A network's decision as the table names it, with what the referee says of it."""

    name: str
    network: Network
    decision: Decision
    mark: str


def figures(outcome: Answer) -> list[Figure]:
    """Accuracy, energy and time of a decision by the best network; without what the run does not know.

    >>> used = Decision(0.9, 1000.0, 500.0, 80.0, 250.0)
    >>> rival = Baseline("SVM on signals", 0.9, 0.95, 25.0)
    >>> found = answers.answer([Network("1&1", 50, 1, 0.9, used, None)], [rival], 0.25, Trials(40, 40))
    >>> for one in figures(found):
    ...     print(one.value, "|", one.of, "|", one.against)
    90.0 % | 95 % interval 77 to 96 %, 40 test trials | SVM on signals: 95.0 % (83 to 99), p = 0.6
    250 nJ | an estimate of the arithmetic | 10 times as much as SVM on signals (25 nJ, 95.0 %)
    500 ms | the whole window | the others wait as long
    """
    return [*_accuracy(outcome), *_energy(outcome), *_time(outcome)]


def _accuracy(outcome: Answer) -> Iterator[Figure]:
    n_test, (low, high), rival = outcome.trials.test, outcome.interval, outcome.beside
    against = f"{rival.name}: {with_interval(rival.accuracy, n_test)}" if rival else f"guessing: {_guess(outcome)}"
    if outcome.verdict is not None and rival is outcome.decisive:
        against += f", {answers.p_of(outcome.verdict)}"
    trials = f"{n_test} test trial{'' if n_test == 1 else 's'}"
    of = f"95 % interval {100 * low:.0f} to {100 * high:.0f} %, {trials}"
    yield Figure("test accuracy", answers.percent(outcome.best.used.accuracy), of, against)


def _energy(outcome: Answer) -> Iterator[Figure]:
    priced = outcome.priced[0]
    spent, rival = priced.network.used.nJ, priced.comparable or priced.cheapest
    if spent is None:
        return
    against = ""
    if rival is not None and rival.nJ is not None:
        ratio, of = answers.times(priced), f"{answers.energy(rival.nJ)}, {answers.percent(rival.accuracy)}"
        against = f"{rival.name}: {of}" if ratio is None else f"{ratio.words} {ratio.than} {rival.name} ({of})"
    yield Figure("energy per decision", answers.energy(spent), "an estimate of the arithmetic", against)


def _time(outcome: Answer) -> Iterator[Figure]:
    best = outcome.best
    if pd.isna(best.used.ms):
        return
    whole = answers.milliseconds(best.whole.ms)
    of = f"with early exit, of a window of {whole}" if best.exits else "the whole window"
    others = f"the others wait for the whole window, {whole}" if best.exits else "the others wait as long"
    against = others if outcome.baseline else ""
    yield Figure("time to decision", answers.milliseconds(best.used.ms), of, against)


def chosen(outcome: Answer, networks: Sequence[Network], baselines: Sequence[Baseline]) -> str:
    """Which network the figures are of, and which rows of the table are more accurate on test trials."""
    best, rival = outcome.best, outcome.beside
    exits = ", with early exit" if best.exits else ""
    network = f"{best.name}{exits}"
    ahead = [(row.name, row.decision.accuracy) for row in _network_rows(outcome, networks)]
    better = [max((one for one in ahead if one[1] > best.used.accuracy), key=lambda one: one[1], default=None)]
    bar = best.used.accuracy if rival is None else max(rival.accuracy, best.used.accuracy)
    others = [(one.name, one.accuracy) for one in _baselines_shown(outcome, baselines) if one.accuracy > bar]
    better.append(max(others, key=lambda one: one[1], default=None))
    said = [f"{name} has {answers.percent(share)}" for name, share in filter(None, better)]
    told = f"; on test trials {' and '.join(said)}, and a choice by them would flatter" if said else ""
    return f"{network}, chosen on validation trials{told}."


def table(outcome: Answer, networks: Sequence[Network], baselines: Sequence[Baseline], period: str = "t_ref") -> Table:
    """Every network and baseline that a sentence names, and the best of each pair and kind on validation trials.

    period: what the refractory periods are of (`periods.head`).
    """
    rows = [[f"{row.name}{row.mark}", *_in_words(row, outcome.trials)]
            for row in _network_rows(outcome, networks)]  # fmt: skip
    for baseline in _baselines_shown(outcome, baselines):
        mark = ": cheapest on signals that is not clearly less accurate"
        name = f"{baseline.name}{mark if baseline is outcome.comparable else ''}"
        spent = "not counted" if baseline.nJ is None else answers.energy(baseline.nJ)
        rows.append(
            [name, with_interval(baseline.accuracy, outcome.trials.test), "", "", _ms(outcome.best.whole), spent]
        )
    rows.append(["guessing", _guess(outcome), *[""] * (len(HEADS) - 2)])
    trainings = max(network.seeds for network in networks)
    over = f", of {trainings} trainings each" if trainings > 1 else ""
    caption = (
        f"Means over {outcome.trials.test} test trials{over}; energy is an estimate of the arithmetic. Choices: "
        "accuracy on validation trials, then the least energy, both on whole windows. Of each refractory period, or "
        "pair, the best network is shown."
    )
    return Table(caption, [f"{period}, neurons", *HEADS[1:]], rows, n_heads=1)


def _network_rows(outcome: Answer, networks: Sequence[Network]) -> Iterator[_Row]:
    """The networks that sentences name, and the best of each other pair; each with and without early exit."""
    for pair in dict.fromkeys(network.pair for network in networks):
        own = [network for network in networks if network.pair == pair]
        told = [network for network in dict.fromkeys((outcome.best, outcome.cheapest)) if network in own]
        for one in told or [own[referee.best_of([network.way(outcome.trials) for network in own])]]:
            named = (("best on validation", outcome.best), ("cheapest within its error", outcome.cheapest))
            marks = [word for word, of in named if of == one]
            mark = f": {' and '.join(marks)}" if marks else ""
            is_early = one.exits and one == outcome.best  # the cheapest is that on whole windows
            name = f"{periods.in_ms(pair)}, {one.hidden}"
            yield _Row(name, one, one.whole, "" if is_early else mark)
            if one.early is not None:
                yield _Row(f"{name}, early exit", one, one.early, mark if is_early else "")


def _baselines_shown(outcome: Answer, baselines: Sequence[Baseline]) -> list[Baseline]:
    """The leading baselines and those that a sentence names, each once."""
    return list({one.name: one for one in (*leading(baselines, outcome.trials), *outcome.named)}.values())


def leading(baselines: Sequence[Baseline], trials: Trials) -> list[Baseline]:
    """The best on validation trials of logistic regression and of the others, on signals and on spikes."""
    groups: dict[tuple[bool, bool], list[Baseline]] = {}
    for one in baselines:
        groups.setdefault((one.is_of_spikes, not one.name.startswith("logistic")), []).append(one)
    return [group[referee.best_of([one.way(trials) for one in group])] for _, group in sorted(groups.items())]


def with_interval(share: float, n_test: int) -> str:
    """An accuracy with its 95 % interval.

    >>> with_interval(0.9, 40)
    '90.0 % (77 to 96)'
    """
    return within(share, wilson_interval(share, n_test))


def within(share: float, interval: tuple[float, float]) -> str:
    """A share with the limits of its interval."""
    low, high = interval
    return f"{answers.percent(share)} ({100 * low:.0f} to {100 * high:.0f})"


def _in_words(row: _Row, trials: Trials) -> list[str]:
    decision, interval = row.decision, answers.interval_of(row.network, row.decision, trials)
    spent = "-" if decision.nJ is None else answers.energy(decision.nJ)
    counts = answers.count(decision.spikes), answers.count(decision.sops)
    return [within(decision.accuracy, interval), *counts, _ms(decision), spent]


def _ms(decision: Decision) -> str:
    return "-" if pd.isna(decision.ms) else answers.milliseconds(decision.ms).removesuffix(" ms")


def _guess(outcome: Answer) -> str:
    return answers.percent(outcome.guess)
