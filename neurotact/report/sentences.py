"""What an answer says, in sentences: the verdict with its numbers, then what it costs, saves and leaves in doubt."""

import math
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

from scipy.stats import binom

from neurotact.errors import number_of
from neurotact.metrics import power, referee, starts
from neurotact.metrics.shares import wilson_interval
from neurotact.networks.exit import patience
from neurotact.report.answer import Answer, Baseline, Decision, Network, OfNetworks, Priced
from neurotact.report.way_answer import Configuration, WayAnswer
from neurotact.report.wording import chance_of, count, energy, milliseconds, p_of, percent

POINT, TOLD = 0.01 + 1e-9, 3
"""A loss that a sentence on 8-bit weights leaves out, and how many it names."""


def headline(outcome: Answer[Any, Any]) -> str:
    """The answer in one sentence: the verdict, and the numbers that it rests on."""
    said = evidence(outcome)
    if outcome.kind == "no baseline":
        return f"{said}." if outcome.measure.cost else f"{said[0].upper()}{said[1:]}."
    return f"{verdict(outcome)}{';' if outcome.kind == 'too few trials' else ':'} {said}."


def verdict(outcome: Answer[Any, Any]) -> str:
    """The verdict of the headline, without its numbers; empty where the run says too little for one."""
    alone = "Clearly better than guessing, and compared with no other classifier"
    return {
        "nothing learned": _nothing_learned,
        "unclear": lambda _: "Not clearly better than guessing",
        "no baseline": lambda _: alone if outcome.trials.test else "",
        "untested": lambda _: f"Not tested, since {outcome.untested}",
        "worse": _worse,
        "tie": lambda _: f"No clear difference in accuracy{_at_energy(outcome)}",
        "better": lambda _: "Spiking is more accurate",
        "too few trials": _too_few,
    }[outcome.kind](outcome)


def _worse(outcome: Answer[Any, Any]) -> str:
    """Whether it is spiking that costs accuracy, or what the chosen network saves."""
    spares = outcome.ahead is not None and outcome.ahead[1] is not None and outcome.ahead[1].kind != "worse"
    return "Saving costs accuracy, spiking shows no clear loss" if spares else "Spiking costs accuracy"


def _too_few(outcome: Answer[Any, Any]) -> str:
    """What the test trials cannot show."""
    if not outcome.is_above_chance or outcome.verdict is None:
        return "Too few test trials: a network that is right in all of them would not be clearly better than guessing"
    said = power.in_words(outcome.verdict, outcome.least)
    return said.replace("too few test trials", "Too few test trials to tell whether spiking costs accuracy")


def _nothing_learned(outcome: OfNetworks) -> str:
    """That nothing holds on test trials, and whether baselines learned something that does."""
    if _learned(outcome):
        return "The network learned nothing that holds on test trials, other classifiers did"
    seen, n = outcome.best.validation, outcome.trials.validation
    holds_there = n > 0 and wilson_interval(seen, n)[0] > outcome.guess
    return "Nothing was learned that holds on test trials" if holds_there else "Nothing was learned"


def _learned(outcome: OfNetworks) -> bool:
    """Whether a rival is clearly better than guessing on test trials: binomial tests with Holm's correction."""
    n = outcome.trials.test
    p = [float(binom.sf(round(one.accuracy * n) - 1, n, outcome.guess)) for one in outcome.rivals]
    return bool(p) and min(referee.holm(p)) < referee.LEVEL


def evidence(outcome: Answer[Any, Any]) -> str:
    """The numbers of the headline: the row that it is of, and what it is compared with."""
    guess = "" if math.isnan(outcome.guess) else f"guessing reaches {outcome.measure.of(outcome.guess)}"
    if not isinstance(outcome.best, Network):
        shown, said = outcome.shown, outcome.measure
        is_alone = outcome.kind == "no baseline"
        compared = f" at {said.spent(shown.cost)}" if is_alone else f"; {_rivals(outcome, 'has', 'have')}"
        return f"{shown.name} has a {said.what} of {said.of(shown.accuracy)}{compared}{'; ' if guess else ''}{guess}"
    if outcome.kind == "no baseline":
        return f"{_of_best(outcome)}; {guess}"
    if outcome.is_above_chance:
        return f"{_of_best(outcome)}, {_rivals(outcome, 'in', 'in')}"
    share, n_test = percent(outcome.guess), outcome.trials.test
    if outcome.kind == "nothing learned":
        return f"{_of_best(outcome)}, which guessing reaches too ({share}){_learned_without(outcome)}"
    of = f"of {number_of(n_test, 'test trial')}"
    return f"{_of_best(outcome)} {of}, guessing in {share}{_learned_without(outcome)}"


def _of_best(outcome: OfNetworks) -> str:
    """The accuracy of the best network with its interval."""
    best, (low, high) = outcome.best, outcome.interval
    network = f"the {outcome.called} network{', with early exit,' if best.exits else ''}"
    network += f" is right in {percent(best.accuracy)}"
    return f"{network} of the test windows (95 % interval {100 * low:.0f} to {100 * high:.0f} %{_other(best)})"


def _other(network: Network) -> str:
    """The accuracy on whole windows, after that with early exit; empty where early exit is not used."""
    return f"; on whole windows {percent(network.whole.accuracy)}" if network.exits else ""


def _rivals(outcome: Answer[Any, Any], has: str, have: str) -> str:
    """What the verdict is about, in words, with the chance of the difference; `has`, `have` precede scores."""
    verdict, decisive, said = outcome.verdict, outcome.decisive, outcome.measure.of
    if verdict is None or decisive is None:
        assert outcome.baseline is not None
        return f"the best baseline is {outcome.baseline.name}, {said(outcome.baseline.accuracy)}"
    if outcome.is_contradicted and (unranked := outcome.unranked) is not None:
        return (
            f"{unranked.name} {has} {said(unranked.accuracy)}, although it is less accurate on validation windows than "
            "other baselines"
        )
    chance = chance_of(verdict) if outcome.trials.test else p_of(verdict)
    if len(outcome.rivals) == 1:
        return f"the best baseline is {decisive.name}, {said(decisive.accuracy)} ({chance})"
    baseline = outcome.baseline
    is_unsure = isinstance(baseline, Configuration) and math.isnan(baseline.choice_error)
    level = "finds equal" if is_unsure else "cannot tell apart"
    worst, best = outcome.ends
    if verdict.kind == "worse":
        between = f"{said(worst.accuracy)} to {said(best.accuracy)}"
        among = f"one of {len(outcome.rivals)} baselines that validation {level}: {between}"
        return f"{decisive.name} {has} {said(decisive.accuracy)} ({chance}), {among}"
    return (
        f"{len(outcome.rivals)} baselines that validation {level} {have} {said(worst.accuracy)} ({worst.name}) to "
        f"{said(best.accuracy)} ({best.name}; {chance})"
    )


def _at_energy(outcome: Answer[Any, Any]) -> str:
    """For equal accuracy, the energy against the comparable baseline on signals; empty if about equal or unknown."""
    priced = outcome.priced[0] if outcome.priced else None
    if priced is None or priced.comparable is None or (ratio := times(priced)) is None:
        return ""
    rival = priced.comparable
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
    ratio = count(max(spent, rival) / min(spent, rival), 2)
    return Ratio(f"{ratio} times as much", "as") if spent > rival else Ratio(f"{ratio} times less", "than")


def _learned_without(outcome: OfNetworks) -> str:
    """Where no network is clearly better than guessing: whether baselines are."""
    if outcome.baseline is None:
        return ""
    worst, best = outcome.ends
    learned, n = _learned(outcome), len(outcome.rivals)
    if n == 1:
        verdict = "is clearly better than guessing" if learned else "is not clearly better than guessing either"
        return f"; the best baseline {verdict} ({best.name}, {percent(best.accuracy)})"
    verdict = "some of them are clearly better than guessing" if learned else "none is clearly better than guessing"
    return (
        f"; {n} baselines that validation cannot tell apart are right in {percent(worst.accuracy)} ({worst.name}) to "
        f"{percent(best.accuracy)} ({best.name}): {verdict}, after correction for {n} comparisons"
    )


def details(outcome: Answer[Any, Any]) -> Iterator[str]:
    """What the cheapest within the error saves and costs, and what is in doubt; nothing if guessing may do as well."""
    if not outcome.is_above_chance:
        return
    yield from _of_leader(outcome) if outcome.is_chosen else _of_cheapest(outcome)
    for each in outcome.priced:
        yield from _early(each.network, outcome)
    for each in outcome.priced:
        yield from _energy(each, outcome.prices)
    uncounted = [one for one in outcome.others if isinstance(one, Baseline) and one.nJ is None]
    if uncounted:
        names = " and of ".join(dict.fromkeys(one.name.partition(" on ")[0] for one in uncounted))
        yield f"The cost of {names} is not counted, so that no sentence on energy compares with it."
    yield from outcome.doubts


def _of_leader(outcome: OfNetworks) -> Iterator[str]:
    """What the chosen network saves and loses beside the best one on validation trials."""
    if outcome.ahead is None:
        return
    leader, best = outcome.leader, outcome.best
    yield (
        f"{leader.name} is the best network on validation trials, with {percent(leader.accuracy)} on test windows; "
        f"{best.name}, the cheapest within its error ({100 * leader.way(outcome.trials).error:.1f} points), has "
        f"{_changed(leader.whole, best.whole, outcome)}."
    )


def _of_cheapest(outcome: Answer[Any, Any]) -> Iterator[str]:
    """Which is the cheapest within the error of the best, and what that saves and costs."""
    best, cheapest = outcome.best, outcome.cheapest
    within = f"({outcome.measure.points(outcome.error)} on {'validation' if outcome.is_validated else 'test'} trials)"
    if math.isnan(outcome.error) and not isinstance(best, Network):
        few = "one row" if best.rows == 1 else "too few splits"
        yield f"{best.name} has {few}, so that its error is not known."
    elif isinstance(best, Network) and math.isinf(best.way(outcome.trials).cost):
        yield f"What a decision of {best.name} costs is not counted, so none is said to be the cheapest."
    elif cheapest != best:
        saved = _cheaper(outcome) if isinstance(best, Network) else _cheaper_way(outcome)
        yield f"Within the error of {best.name} {within}, {cheapest.name} is the cheapest{saved}."
    elif isinstance(best, Network) or not math.isnan(best.cost):
        yield f"{best.name} is also the cheapest within its error {within}."


def _cheaper(outcome: OfNetworks) -> str:
    best, cheapest = outcome.best, outcome.cheapest
    is_known = best.whole.nJ is not None and cheapest.whole.nJ is not None
    on = " on whole windows" if best.exits or cheapest.exits else ""
    return f" in {'energy (an estimate)' if is_known else 'SOPs'}{on}: {_changed(best.whole, cheapest.whole, outcome)}"


def _cheaper_way(outcome: WayAnswer) -> str:
    best, cheapest, said = outcome.best, outcome.cheapest, outcome.measure
    against = said.spent(best.cost) if math.isnan(best.cost) else count(best.cost)
    less = f"{100 * (1 - cheapest.cost / best.cost):.0f} % less, " if best.cost > 0 else ""
    return f": {less}{said.spent(cheapest.cost)} against {against}, {_lost(best.accuracy, cheapest.accuracy, outcome)}"


def _energy(priced: Priced, prices: str) -> Iterator[str]:
    """The energy of a network with and without early exit, and of the baselines on signals that it is compared with."""
    network, fair = priced.network, priced.comparable
    whole, used = network.whole.nJ, network.used.nJ
    if whole is None or used is None or priced.cheapest is None:
        return
    early = f", {energy(used)} with early exit" if network.exits else ""
    said = (
        f"Energy of {network.name}, an estimate{prices and ' by '}{prices}: {energy(whole)} for a whole window{early}"
    )
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


def of_width(outcome: OfNetworks, narrow: OfNetworks, own: float | None) -> Iterator[str]:
    """What 8-bit weights change: more than a point of accuracy, or the verdict; nothing where they change neither.

    narrow: the answer with rounded baselines. own: the test accuracy of the best network in 8-bit integers, if known.
    """
    after = {one.name: one.accuracy for one in narrow.others}
    every = [] if own is None else [(outcome.best.name, outcome.best.whole.accuracy, own)]
    every += [(one.name, one.accuracy, after[one.name]) for one in outcome.named]
    lost = [f"{name} {percent(was)} to {percent(now)}" for name, was, now in every if was - now > POINT]
    more = [f"and that of {len(lost) - TOLD} others"] if len(lost) > TOLD else []
    said = [f"accuracy on test windows falls ({'; '.join([*lost[:TOLD], *more])})"] if lost else []
    if narrow.kind == "too few trials" and outcome.kind in ("better", "worse"):
        said.append("the difference in accuracy is no longer clear")
    elif narrow.kind != outcome.kind and {narrow.kind, outcome.kind} != {"tie", "too few trials"}:
        said.append(f"the verdict would be '{verdict(narrow)}'")
    if said:
        yield f"With 8-bit weights, for which baselines are chosen anew, {'; '.join(said)}."


def gaps(outcome: OfNetworks, cause: str) -> Iterator[str]:
    """A warning if the test accuracy of the best network or baseline is clearly below that on validation trials.

    Where the network is not clearly better than guessing on test trials, weaker evidence is enough (`referee.LEVEL` in
    place of `GAP`): something has failed, and this tells what. cause: the likely one, as the split has it.
    """
    level = referee.GAP if outcome.is_above_chance else referee.LEVEL
    network = outcome.best
    sides = [(f"the {outcome.called} network", network.validation, network.whole.accuracy)]
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


def where_lost(outcome: OfNetworks, of_encoder: Sequence[str] = ()) -> Iterator[str]:
    """If spiking costs accuracy: the loss of the encoding, of the network, and of what is saved, and remedies.

    The same windows are classified from the signals and from the afferents' spikes, by the classifiers chosen on
    validation trials, by the best network on these, and by the chosen one. A loss of one test trial or less is not
    reported. of_encoder: what else may help, by the keys that this encoder has.

    >>> from neurotact.report.answer import Trials, answer
    >>> network = Network("1&1", 20, 1, 0.6, Decision(0.5, 1000.0, 500.0, 80.0, None), None)
    >>> baselines = [Baseline("SVM on signals", 0.9, 0.9, 1.0), Baseline("SVM on spikes (counts)", 0.7, 0.51, 1.0)]
    >>> [words[:67] for words in where_lost(answer([network], baselines, 0.25, Trials(40, 40)))]
    ['the encoding loses 39.0 points (90.0 % by SVM on signals, 51.0 % by']
    """
    groups = [[one for one in outcome.others if one.is_of_spikes == of_spikes] for of_spikes in (False, True)]
    if outcome.verdict is None or outcome.verdict.kind != "worse" or not all(groups):
        return
    of_signals, of_spikes = (group[referee.best_of([one.way(outcome.trials) for one in group])] for group in groups)
    used, leader = outcome.best.accuracy, outcome.leader.accuracy
    encoding, network = of_signals.accuracy - of_spikes.accuracy, of_spikes.accuracy - leader
    windows = "at other windows (`settings={'window.length_ms': ..., 'window.align': 'onset'}`)"
    *first, last = windows, *of_encoder
    remedies = f"{', '.join(first)}{' and ' if first else ''}{last}"
    lost = {
        f"the encoding loses {100 * encoding:.1f} points ({percent(of_signals.accuracy)} by {of_signals.name}, "
        f"{percent(of_spikes.accuracy)} by {of_spikes.name}); look {remedies}": encoding,
        f"the network loses {100 * network:.1f} points ({percent(of_spikes.accuracy)} by {of_spikes.name}, "
        f"{percent(leader)} by the best network on validation trials); record more trials, or run the whole study if "
        "this is a quick one": network,
        f"the saving loses {100 * (leader - used):.1f} points ({percent(leader)} by {outcome.leader.name}, "
        f"{percent(used)} by {outcome.best.name}); use {outcome.leader.name}": leader - used,
    }
    yield from (words for words, loss in lost.items() if loss > 1 / outcome.trials.test)


def lost_in_encoding(outcome: OfNetworks) -> str:
    """How much more accurate a baseline on signals is than the same on spikes, if clearly more than `power.WEAK`.

    It is the best one, on validation trials, of those that have both inputs. The difference is clear by Fisher's exact
    test on all trials that were not trained on. Else empty.
    """
    of: dict[tuple[str, bool], list[Baseline]] = {}
    for one in outcome.others:
        of.setdefault((one.name.partition(" on ")[0], one.is_of_spikes), []).append(one)
    rivals = [one for (kind, spikes), its in of.items() if not spikes and (kind, True) in of for one in its]
    if not rivals:
        return ""
    sides, n = outcome.trials, sum(outcome.trials)
    signals = rivals[referee.best_of([one.way(sides) for one in rivals])]
    same = of[kind := signals.name.partition(" on ")[0], True]
    spikes = same[referee.best_of([one.way(sides) for one in same])]
    before, after = ((sides.validation * one.validation + sides.test * one.accuracy) / n for one in (signals, spikes))
    lost = signals.accuracy - spikes.accuracy
    if lost <= power.WEAK or not referee.is_gap(before, n, after, n, referee.LEVEL):
        return ""
    shares = f"{percent(signals.accuracy)} on signals, {percent(spikes.accuracy)} on spikes"
    return f"The encoding loses {100 * lost:.0f} points ({kind}: {shares})"


def of_starts(outcome: OfNetworks) -> str:
    """What the interval of the headline knows of other starts of the weights."""
    best = outcome.best
    if best.is_fitted:
        return f"{starts.FITTED[:1].upper()}{starts.FITTED[1:]}: the 95 % interval is that of other trials."
    apart = best.apart_early if best.exits else best.apart
    if apart is None:
        each = ", of each split" if best.seeds > best.starts else ""
        return f"The 95 % interval knows {starts.ONE.replace(':', f'{each}:', 1)}."
    return (
        "The 95 % interval is that of another start of the weights on other trials: accuracies of starts lie "
        f"{100 * apart.deviation:.1f} points apart (standard deviation)."
    )


def _early(network: Network, outcome: OfNetworks) -> Iterator[str]:
    """What early exit saves and loses on test trials, and whether it is used."""
    name = "it" if len(outcome.priced) == 1 else network.name
    whole, early = network.whole, network.early
    if early is None:
        return
    if not network.saves:
        yield f"Early exit saves nothing here: {name} decides at the end of the window, after {milliseconds(whole.ms)}."
        return
    bound = network.exit_bound
    known = "what it may lose is not known" if bound is None else patience.in_words(bound, network.tolerance)
    if not network.exits:
        yield f"Early exit{'' if name == 'it' else f' of {name}'} is not used: {known}."
        return
    yield (
        f"With early exit {name} decides after {milliseconds(early.ms)} of {milliseconds(whole.ms)} on average: "
        f"{_changed(whole, early, outcome)}; {known}."
    )


def _changed(before: Decision, after: Decision, outcome: OfNetworks) -> str:
    """The change of costs, then of the accuracy."""
    return f"{_saved(before, after)}, {_lost(before.accuracy, after.accuracy, outcome)}"


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
    spent = f"{count(100 * abs(less), 2)} % {'less' if less >= 0 else 'more'} energy"
    return f"{spent}, although {said}" if less >= 0 > change else f"{said} and {spent}"


def _lost(before: float, after: float, outcome: Answer[Any, Any]) -> str:
    """The change of the score, in points and in test trials: with few trials, one trial is many points."""
    said, n_test, lost = outcome.measure, outcome.trials.test, before - after
    if said.points(abs(lost)) == said.points(0.0):
        return f"at the same {said.what}, {said.of(after)}"
    trials = abs(lost) * n_test
    of = f" ({trials:.2g} of {n_test} test trials)" if n_test and trials < 3 else ""
    return f"and {said.what} {'falls' if lost > 0 else 'rises'} by {said.points(abs(lost))}{of} to {said.of(after)}"
