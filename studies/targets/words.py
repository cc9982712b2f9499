"""What a study with a target says: large figures, one sentence of verdict, and what stands behind it."""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from neurotact_parts.studies.targets.ways import EVENTS, Compared, Way

from neurotact.figures.columns import quantity
from neurotact.metrics.paired import compare_by_trial
from neurotact.report import periods
from neurotact.report.page import Figure, Table
from neurotact.report.wording import chance_of, count, energy, milliseconds, p_of

MOST_ROWS = 12
"""Of the first table, rivals that are best on validation trials."""


class Screen(NamedTuple):
    """The first screen of a data set, as a page shows it and `answer.json` holds it."""

    setting: str
    verdict: str
    period: str
    next: tuple[str, Sequence[str]]
    figures: Sequence[Figure]
    evidence: str
    details: Sequence[str]
    tables: Sequence[Table]
    numbers: Mapping[str, Any]
    told: str = ""

    def in_words(self) -> dict[str, Any]:
        """The screen for programs: in words, and the numbers by plain names."""
        return {
            "dataset": self.setting,
            "headline": self.verdict,
            "short": self.verdict.removesuffix("."),
            "period": self.period,
            "figures": [figure._asdict() for figure in self.figures],
            "details": [self.evidence, *self.details],
            **self.numbers,
        }


def screen(
    setting: str,
    compared: Compared,
    target: Sequence[str],
    prices: str,
    folder: str,
    then: tuple[str, Sequence[str]] = ("", ()),
) -> Screen:
    """The first screen; folder: of the chosen network's median training. then: what to do next, and its commands."""
    told = _Events(compared) if [*target] == [EVENTS] else _Numbers(compared, target)
    chosen = compared.chosen
    return Screen(
        setting,
        f"{told.verdict()}.",
        _period(compared),
        then,
        [*told.figures(), _of_energy(compared, prices, told.each), *told.last()],
        f"Chosen on validation trials, as the cheapest within one standard error of the best: {chosen.name}.",
        [*_details(compared, folder)],
        [_table(compared, told)],
        {**_as_json(compared), "target": [*target], "chosen": chosen.name, "chosen_folder": folder},
    )


def _period(compared: Compared) -> str:
    """The refractory period that validation prefers, and what a longer one saves and loses; empty without another."""
    if compared.of_period is None:
        return ""
    longer, shorter = compared.of_period
    saved = [*_change(longer.sops, shorter.sops, "fewer", "SOPs"), *_change(longer.nJ, shorter.nJ, "less", "energy")]
    takes = f"takes {' and '.join(saved)}, and " if saved else ""
    found = compare_by_trial(shorter.tested, longer.tested)
    clear = "a clear difference" if found.is_clear else "no clear difference"
    which = "it" if longer is compared.chosen else periods.in_ms(longer.pair)
    return (
        f"Validation prefers a refractory period of {periods.in_ms(compared.chosen.pair)}: beside "
        f"{periods.in_ms(shorter.pair)}, both with {longer.kind.removeprefix('network, ')}, {which} {takes}has a score "
        f"of {longer.score:.3f} against {shorter.score:.3f}, {clear} on {found.n} test trials."
    )


def _change(after: float, before: float, less: str, what: str) -> Iterator[str]:
    """How much more or less is taken, where both are counted.

    >>> [*_change(50.0, 100.0, "less", "energy"), *_change(51.0, 50.0, "fewer", "SOPs"), *_change(math.nan, 1, "", "")]
    ['50 % less energy', '2 % more SOPs']
    """
    if after >= 0 and before > 0:
        yield f"{100 * abs(1 - after / before):.0f} % {less if after <= before else 'more'} {what}"


def _as_json(compared: Compared) -> dict[str, Any]:
    """The numbers of an answer, by plain names."""

    def plain(one: Way) -> dict[str, Any]:
        low, high = one.interval
        costs = {"energy_nJ": one.nJ, "sops": one.sops, "input_spikes": one.spikes}
        values = {"score": one.score, "score_low": low, "score_high": high, **one.found, **costs}
        return {"name": one.name, **{key: None if math.isnan(value) else float(value) for key, value in values.items()}}

    verdict, early = compared.verdict, compared.chosen.early
    bound = None if early is None or math.isnan(early.bound) else early.bound
    return {
        "kind": compared.kind,
        "network": plain(compared.chosen),
        "rival": None if compared.beside is None else plain(compared.beside),
        "rivals": [one.name for one in compared.others],
        "p": None if verdict is None else verdict.p,
        "test_trials": len(compared.chosen.tested),
        **({} if early is None else {"early_exit": {"used": early.is_used, "bound": bound, **plain(early.way)}}),
    }


def _details(compared: Compared, folder: str) -> Iterator[str]:
    best, chosen = compared.best, compared.chosen
    if best is not chosen:
        yield f"The best network on validation trials is {best.name}, with a score of {best.score:.3f} on test trials."
    yield f"The chosen network is in {folder}."
    if (early := chosen.early) is not None:
        yield f"Early exit is {'used' if early.is_used else 'not used'}: {early.in_words}."
    if compared.verdict is not None:
        n = compared.verdict.opponents
        yield (
            f"The verdict compares it with {n} rival{'' if n == 1 else 's'} that validation cannot tell apart, by the "
            f"scores of {compared.verdict.n} test trials ({p_of(compared.verdict)})."
        )


def _of_energy(compared: Compared, prices: str, each: str) -> Figure:
    chosen, fair = compared.chosen, compared.comparable
    spent = "not counted" if math.isnan(chosen.nJ) else energy(chosen.nJ)
    of = f"an estimate by {prices}; {count(chosen.spikes)} input spikes, {count(chosen.sops)} SOPs"
    against = ""
    if fair is not None:
        ratio = _ratio(compared, "")
        against = f"{ratio or fair.name} ({energy(fair.nJ)}, score {fair.score:.3f})"
    return Figure(f"energy {each}", spent, of, against)


def _ratio(compared: Compared, what: str) -> str:
    """How many times as much energy spiking takes as the cheapest fair rival on signals; empty if about as much."""
    chosen, fair = compared.chosen, compared.comparable
    if fair is None or not chosen.nJ > 0 or max(ratio := chosen.nJ / fair.nJ, 1 / ratio) < 1.2:
        return ""
    times, than = ("as much", "as") if ratio > 1 else ("less", "than")
    return f"{count(max(ratio, 1 / ratio), 2)} times {times}{what} {than} {fair.name}"


def _tie(compared: Compared, of: str = "") -> str:
    """That there is no clear difference in scores, and what else differs: delays, and energy."""
    said, later = [], compared.later
    if later is not None and later.is_clear:
        said = [
            f"is {abs(later.difference):.0f} ms {'later' if later.difference > 0 else 'sooner'} (p = {later.p:.1g})"
        ]
    if ratio := _ratio(compared, " energy"):
        said.append(f"takes {ratio} (an estimate)")
    return f"No clear difference{of}" + (f"; spiking {' and '.join(said)}" if said else "")


def _table(compared: Compared, told: "_Numbers | _Events") -> Table:
    """The chosen network, the best one, and the rivals that are best on validation trials."""
    ordered = sorted(compared.others, key=lambda one: -one.way.validation)[:MOST_ROWS]
    named = [one for one in (compared.beside, compared.comparable) if one is not None]
    early = compared.chosen.early
    own = [compared.chosen, *([early.way] if early and early.is_used else []), compared.best]
    ways = list({one.name: one for one in (*own, *named, *ordered)}.values())
    rows = [
        [
            f"{one.name}{': chosen' if one is compared.chosen else ''}",
            *told.cells(one),
            "{:.3f} ({:.3f} to {:.3f})".format(one.score, *one.interval),
            "not counted" if math.isnan(one.nJ) else energy(one.nJ),
        ]
        for one in ways
    ]
    heads = ["decided by", *told.heads, "score (95 % interval)", f"energy estimate {told.each}"]
    n = len(compared.chosen.tested)
    return Table(f"Networks and rivals on {n} test trials; {told.meaning}.", heads, rows, 1, [*range(len(rows))])


def _chance(compared: Compared) -> str:
    assert compared.verdict is not None
    return chance_of(compared.verdict)


class _Numbers:
    """The words of numbers."""

    each = "per answer"
    meaning = "the score is 1 less the squared error in units of the training trials' deviation"

    def __init__(self, compared: Compared, target: Sequence[str]) -> None:
        self.compared, self.target = compared, target
        self.heads = [f"error of {name}" for name in target]

    def cells(self, one: Way) -> list[str]:
        """The errors of a way, as a table has them."""
        return [self.error(one, name) for name in self.target]

    def error(self, one: Way, name: str) -> str:
        """The root-mean-square error in its unit."""
        return f"{one.found[f'rmse_{name}']:.3g} {quantity(name)[1]}".strip()

    def span(self, name: str) -> str:
        """The interval of the error of the chosen network."""
        low, high = (self.compared.chosen.found[f"rmse_{name}_{end}"] for end in ("low", "high"))
        return f"{low:.3g} to {high:.3g}"

    def figures(self) -> Iterator[Figure]:
        """How exactly."""
        chosen, rival, n = self.compared.chosen, self.compared.beside, len(self.compared.chosen.tested)
        for name in self.target:
            r2, mean = chosen.found[f"r2_{name}"], chosen.found[f"mae_{name}"]
            of = f"root mean square, 95 % interval {self.span(name)}; mean absolute {mean:.3g}; R² {r2:.3f}"
            against = "" if rival is None else f"{rival.name}: {self.error(rival, name)}"
            yield Figure(f"error of {name}", self.error(chosen, name), of, against)
        low, high = chosen.interval
        verdict = self.compared.verdict
        against = "" if rival is None or verdict is None else f"{rival.name}: {rival.score:.3f}, {p_of(verdict)}"
        of = f"1 is perfect, 0 the mean of training; 95 % interval {low:.3f} to {high:.3f}, {n} test trials"
        yield Figure("score", f"{chosen.score:.3f}", of, against)

    def last(self) -> Iterator[Figure]:
        """How soon."""
        chosen, early = self.compared.chosen, self.compared.chosen.early
        against = "the others wait as long" if self.compared.others else ""
        takes, of = milliseconds(chosen.found["ms"]), "the whole window"
        if early is not None and early.is_used:
            errors, spent = ", ".join(self.cells(early.way)), energy(early.way.nJ)
            of = f"with early exit: error {errors}, energy {spent}, score {early.way.score:.3f}; {takes} without"
            against = against and f"the others wait {takes}"
            takes = milliseconds(early.way.found["ms"])
        yield Figure("time to answer", takes, of, against)

    def verdict(self) -> str:
        """One sentence."""
        compared, chosen, rival = self.compared, self.compared.chosen, self.compared.beside
        if compared.kind == "nothing learned":
            low, high = chosen.interval
            return (
                f"Nothing was learned that holds on test trials: the score is {chosen.score:.3f} (95 % interval "
                f"{low:.3f} to {high:.3f}), and the mean of the training trials has 0"
            )
        own = " and ".join(f"{self.error(chosen, name)} of {quantity(name)[0]} (95 % interval {self.span(name)})"
                           for name in self.target)  # fmt: skip
        if rival is None:
            return f"The chosen network errs by {own}; no rival was fitted"
        its = " and ".join(self.error(rival, name) for name in self.target)
        lead = {"better": "Spiking is more exact", "worse": "Spiking costs exactness", "tie": _tie(compared)}
        said = f"{lead[compared.kind]}: the chosen network errs by {own}, {rival.name} by {its}"
        return f"{said} ({_chance(compared)})"


class _Events:
    """The words of events."""

    each = "per second"
    heads = ("events found", "delay", "false alarms an hour")
    meaning = "the score is the share of hits among events and false alarms, the mean over recordings"

    def __init__(self, compared: Compared) -> None:
        self.compared = compared

    def cells(self, one: Way) -> list[str]:
        """Events of a way, as a table has them."""
        return [_hits(one), _delay(one), f"{one.found['false_alarms_per_h']:.3g}"]

    def figures(self) -> Iterator[Figure]:
        """How many are found, how soon, and how often wrong."""
        rival, found = self.compared.beside, self.compared.chosen.found
        n = len(self.compared.chosen.tested)
        before = "" if rival is None else f"{rival.name}: "
        shares = [100 * found[f"hit_share{end}"] for end in ("", "_low", "_high")]
        of = "{:.0f} %, 95 % interval {:.0f} to {:.0f} %; {} test recordings".format(*shares, n)
        yield Figure("events found", _hits(self.compared.chosen), of, before and f"{before}{_hits(rival)}")
        of = f"mean over hits, 95 % interval {found['delay_ms_low']:.0f} to {found['delay_ms_high']:.0f} ms"
        yield Figure("delay", _delay(self.compared.chosen), of, before and f"{before}{_delay(rival)}")
        of = (
            f"{found['false_alarms']:.0f} in {found['tested_s']:.0f} s, 95 % interval "
            f"{found['false_alarms_per_h_low']:.3g} to {found['false_alarms_per_h_high']:.3g} an hour"
        )
        alarms, its = (_alarms(one).replace(" false alarms", "") for one in (self.compared.chosen, rival))
        yield Figure("false alarms", alarms, of, before and f"{before}{its}")

    def last(self) -> Iterator[Figure]:
        """Nothing more."""
        return iter(())

    def verdict(self) -> str:
        """One sentence."""
        compared, chosen, rival = self.compared, self.compared.chosen, self.compared.beside
        own = f"the chosen network finds {_hits(chosen)} events after {_delay(chosen)} with {_alarms(chosen)}"
        if compared.kind == "nothing learned":
            return f"Nothing was learned that holds on test recordings: {own}"
        if rival is None:
            return f"{own[:1].upper()}{own[1:]}; no rival was fitted"
        tie = _tie(compared, " in what is found")
        lead = {"better": "Spiking detects better", "worse": "Spiking detects worse", "tie": tie}
        said = f"{lead[compared.kind]}: {own}, {rival.name} {_hits(rival)} after {_delay(rival)} with {_alarms(rival)}"
        return f"{said} ({_chance(compared).replace('trials', 'recordings')})"


def _hits(one: Way | None) -> str:
    return "" if one is None else f"{one.found['hits']:.0f} of {one.found['events_test']:.0f}"


def _delay(one: Way | None) -> str:
    return "" if one is None else "no hit" if math.isnan(one.found["delay_ms"]) else f"{one.found['delay_ms']:.0f} ms"


def _alarms(one: Way | None) -> str:
    return "" if one is None else f"{one.found['false_alarms_per_h']:.3g} false alarms an hour"
