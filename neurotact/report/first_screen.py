"""The first screen of a report: large figures of the row that is shown, and the table that they are rows of."""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import pandas as pd

from neurotact.errors import number_of
from neurotact.metrics import referee
from neurotact.metrics.shares import wilson_interval
from neurotact.report import periods, sentences
from neurotact.report.answer import Answer, Baseline, Decision, Network, OfNetworks, Trials, interval_of
from neurotact.report.page import Figure, Table
from neurotact.report.way_answer import SPENT, Configuration, WayAnswer
from neurotact.report.wording import count, energy, milliseconds, p_of, percent

HEADS = ["t_ref, neurons", "test accuracy (95 % interval)", "input spikes", "SOPs", "ms to decision", "energy estimate"]


class _Row(NamedTuple):
    """A network's decision as the table names it, with what the referee says of it."""

    name: str
    network: Network
    decision: Decision
    mark: str


def figures(outcome: Answer[Any, Any]) -> list[Figure]:
    """The score and the costs of the row that is shown, beside what it is compared with; without what is not known.

    >>> from neurotact.report.answer import answer
    >>> used = Decision(0.9, 1000.0, 500.0, 80.0, 250.0)
    >>> rival = Baseline("SVM on signals", 0.9, 0.95, 25.0)
    >>> found = answer([Network("1&1", 50, 1, 0.9, used, None)], [rival], 0.25, Trials(40, 40))
    >>> for one in figures(found):
    ...     print(one.value, "|", one.of, "|", one.against)
    90.0 % | 95 % interval 77 to 96 %, 40 test trials | SVM on signals: 95.0 % (83 to 99)
    250 nJ | an estimate | 10 times as much as SVM on signals (25 nJ, 95.0 %)
    500 ms | the whole window | the others wait as long
    """
    if isinstance(outcome.best, Network):
        return [_accuracy(outcome), *_energy(outcome), *_time(outcome)]
    return [_accuracy(outcome), *_costs(outcome)]


def _accuracy(outcome: Answer[Any, Any]) -> Figure:
    shown, rival, measure = outcome.shown, outcome.beside, outcome.measure
    against = "" if math.isnan(outcome.guess) else f"guessing: {measure.of(outcome.guess)}"
    if rival is not None:
        against = f"{rival.name}: {_in_doubt(rival, outcome)}"
    if outcome.verdict is not None and outcome.verdict.kind != "tie" and rival is outcome.decisive:
        against += f", {p_of(outcome.verdict)}"
    if isinstance(shown, Network):
        of = interval_in_words(outcome.interval, outcome.trials.test)
    else:
        of = f"{'' if math.isnan(shown.error) else f'± {measure.points(shown.error)}, '}{shown.name}"
    return Figure(measure.what, measure.of(shown.accuracy), of, against)


def interval_in_words(interval: tuple[float, float], n_test: int) -> str:
    """An interval of an accuracy, and its test trials.

    >>> interval_in_words((0.88, 1.0), 27)
    '95 % interval 88 to 100 %, 27 test trials'
    """
    low, high = interval
    return f"95 % interval {100 * low:.0f} to {100 * high:.0f} %, {number_of(n_test, 'test trial')}"


def _in_doubt(one: Baseline | Configuration, outcome: Answer[Any, Any]) -> str:
    """A score with its interval or error."""
    if isinstance(one, Configuration):
        return outcome.measure.with_error(one.accuracy, one.error)
    return with_interval(one.accuracy, outcome.trials.test)


def _costs(outcome: WayAnswer) -> Iterator[Figure]:
    shown, rival = outcome.shown, outcome.beside
    theirs: Mapping[str, float] = rival.costs if rival else {}
    for head, value in shown.costs.items():
        against = f"{rival.name}: {count(theirs[head])}" if rival and head in theirs else ""
        yield Figure(head, count(value), shown.name, against)


def _energy(outcome: OfNetworks) -> Iterator[Figure]:
    priced = outcome.priced[0]
    spent, rival = priced.network.used.nJ, priced.comparable or priced.cheapest
    if spent is None:
        return
    against = ""
    if rival is not None and rival.nJ is not None:
        ratio, of = sentences.times(priced), f"{energy(rival.nJ)}, {percent(rival.accuracy)}"
        against = f"{rival.name}: {of}" if ratio is None else f"{ratio.words} {ratio.than} {rival.name} ({of})"
    yield Figure(
        "energy per decision", energy(spent), f"an estimate{outcome.prices and ' by '}{outcome.prices}", against
    )


def _time(outcome: OfNetworks) -> Iterator[Figure]:
    best = outcome.best
    if pd.isna(best.used.ms):
        return
    whole = milliseconds(best.whole.ms)
    of = f"with early exit, of a window of {whole}" if best.exits else "the whole window"
    others = f"the others wait for the whole window, {whole}" if best.exits else "the others wait as long"
    against = others if outcome.baseline else ""
    yield Figure("time to decision", milliseconds(best.used.ms), of, against)


def chosen(outcome: OfNetworks) -> str:
    """Which network the figures are of, and which rows of the table are more accurate on test trials."""
    best, rival = outcome.best, outcome.beside
    exits = ", with early exit" if best.exits else ""
    network = f"{best.name}{exits}"
    ahead = [(row.name, row.decision.accuracy) for row in _network_rows(outcome)]
    better = [max((one for one in ahead if one[1] > best.accuracy), key=lambda one: one[1], default=None)]
    bar = best.accuracy if rival is None else max(rival.accuracy, best.accuracy)
    others = [(one.name, one.accuracy) for one in _baselines_shown(outcome) if one.accuracy > bar]
    better.append(max(others, key=lambda one: one[1], default=None))
    said = [f"{name} has {percent(share)}" for name, share in filter(None, better)]
    told = f"; on test trials {' and '.join(said)}, and a choice by them would flatter" if said else ""
    return f"{network}, chosen on validation trials{told}."


def table(outcome: OfNetworks, period: str = "t_ref", sample_ms: float = 0.0) -> Table:
    """Every network and baseline that a sentence names, and the best of each pair and kind on validation trials.

    period: what the refractory periods are of (`periods.head`). sample_ms: between samples of the sensor.
    """
    every = [*_network_rows(outcome)]
    rows = [[f"{row.name}{_marks(row, sample_ms)}", *_in_words(row, outcome.trials)] for row in every]
    for baseline in _baselines_shown(outcome):
        note = ": cheapest on signals that is not clearly less accurate"
        name = f"{baseline.name}{note if baseline is outcome.comparable else ''}"
        spent = "not counted" if baseline.nJ is None else energy(baseline.nJ)
        rows.append(
            [name, with_interval(baseline.accuracy, outcome.trials.test), "", "", _ms(outcome.best.whole), spent]
        )
    rows.append(["guessing", percent(outcome.guess), *[""] * (len(HEADS) - 2)])
    trainings = max(network.seeds for network in outcome.rows)
    over = f", of {trainings} trainings each" if trainings > 1 else ""
    choice = "the least energy within one standard error of the best accuracy on validation trials"
    if not outcome.is_chosen:
        choice = "accuracy on validation trials, then the least energy"
    sample = f" A sample lasts {milliseconds(sample_ms)}." if any(_is_short(row, sample_ms) for row in every) else ""
    caption = (
        f"Means over {outcome.trials.test} test trials{over}; energy is an estimate. Choices: {choice}, both on whole "
        f"windows.{sample}"
    )
    return Table(caption, [f"{period}, neurons", *HEADS[1:]], rows, 1, _named(outcome, every))


def _named(outcome: OfNetworks, every: Sequence[_Row]) -> list[int]:
    """The rows that the verdict rests on: the chosen network, both rivals, guessing, and the best network."""
    used = [row.network if row.decision == row.network.used else None for row in every]
    rows = [*used, *_baselines_shown(outcome), "guessing"]
    asked = outcome.best, outcome.beside, outcome.comparable, "guessing", outcome.leader, outcome.cheapest
    return [rows.index(one) for one in asked if one is not None and one in rows]


def _network_rows(outcome: OfNetworks) -> Iterator[_Row]:
    """The networks that sentences name, and the best of each other pair; each with and without early exit."""
    for pair in dict.fromkeys(network.pair for network in outcome.rows):
        own = [network for network in outcome.rows if network.pair == pair]
        told = [network for network in dict.fromkeys((outcome.best, outcome.cheapest)) if network in own]
        for one in told or [own[referee.best_of([network.way(outcome.trials) for network in own])]]:
            said = mark(is_best=one == outcome.best, is_cheapest=one == outcome.cheapest)
            if outcome.is_chosen:
                said = ": chosen" if one == outcome.best else ""
            is_early = one.exits and one == outcome.best  # the cheapest is that on whole windows
            size = one.size if one.is_fitted or not one.hidden else one.layers or str(one.hidden)
            name = ", ".join(filter(None, (periods.in_ms(pair), size)))
            yield _Row(name, one, one.whole, "" if is_early else said)
            if one.early is not None:
                yield _Row(f"{name}, early exit", one, one.early, said if is_early else "")


def _is_short(row: _Row, sample_ms: float) -> bool:
    return periods.is_short(row.network.pair, sample_ms)


def _marks(row: _Row, sample_ms: float) -> str:
    """That a row was chosen, and that a refractory period of it is shorter than a sample."""
    if not _is_short(row, sample_ms):
        return row.mark
    return f"{row.mark}{' and' if row.mark else ':'} shorter than a sample"


def mark(*, is_best: bool, is_cheapest: bool, best: str = "best on validation") -> str:
    """What is written after the name of a row that was chosen."""
    words = ((best, is_best), ("cheapest within its error", is_cheapest))
    said = " and ".join(word for word, is_said in words if is_said)
    return f": {said}" if said else ""


def _baselines_shown(outcome: OfNetworks) -> list[Baseline]:
    """The leading baselines and those that a sentence names, each once."""
    return list({one.name: one for one in (*leading(outcome.others, outcome.trials), *outcome.named)}.values())


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
    return f"{percent(share)} ({100 * low:.0f} to {100 * high:.0f})"


def _in_words(row: _Row, trials: Trials) -> list[str]:
    decision, interval = row.decision, interval_of(row.network, row.decision, trials)
    spent = "-" if decision.nJ is None else energy(decision.nJ)
    counts = count(decision.spikes), count(decision.sops)
    return [within(decision.accuracy, interval), *counts, _ms(decision), spent]


def _ms(decision: Decision) -> str:
    return "-" if pd.isna(decision.ms) else milliseconds(decision.ms).removesuffix(" ms")


def table_of_configurations(outcome: WayAnswer) -> Table:
    """The best of each kind, the cheapest within the error, every other that a sentence may name, and guessing."""
    kinds: dict[str, Configuration] = {}
    for one in sorted(outcome.rows, key=lambda one: (math.isnan(one.chosen_by), -one.chosen_by)):
        kinds.setdefault(one.kind, one)
    named = (outcome.cheapest, outcome.shown, *(outcome.named if outcome.spiking else ()))
    shown = [*{one.index: one for one in (*kinds.values(), *named)}.values()]
    measure, is_known = outcome.measure, not math.isnan(outcome.error)
    spent = [head for head in SPENT.values() if head != measure.cost and any(head in one.costs for one in shown)]
    rows = []
    for one in shown:
        is_cheapest = is_known and one.index == outcome.cheapest.index
        said = mark(is_best=one.index == outcome.best.index, is_cheapest=is_cheapest, best="best")
        costs = (count(one.costs[head]) if head in one.costs else "-" for head in spent)
        rows.append([f"{one.name}{said}", _in_doubt(one, outcome), count(one.cost), *costs])
    if not math.isnan(outcome.guess):
        rows.append(["guessing", measure.of(outcome.guess), *[""] * (1 + len(spent))])
    least, most = (of(one.rows for one in shown) for of in (min, max))
    over = f"{least} to {most}" if least < most else f"{most}"
    error = "" if all(math.isnan(one.error) for one in shown) else " ± their standard error"
    what = f"means over {over} rows of results.csv{error}" if most > 1 else f"one row of results.csv each{error}"
    setting = f", {outcome.setting}" if outcome.setting else ""
    chosen = ", chosen on validation rows" if outcome.is_validated else ""
    caption = f"The best of each kind{setting}{chosen}: {what}."
    first = [one.index for one in (outcome.shown, outcome.beside, outcome.cheapest) if one is not None]
    order = sorted(range(len(rows)), key=lambda row: row < len(shown) and shown[row].index not in first)
    return Table(caption, ["configuration", measure.score, measure.cost, *spent], rows, 1, order)
