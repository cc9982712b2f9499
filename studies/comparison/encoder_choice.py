"""Which encoder: what a study that sweeps encoders answers; validation chooses, test trials may speak against it."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import pandas as pd

from neurotact.baselines.opponents import LINEAR
from neurotact.metrics.paired import Paired, compare_shares
from neurotact.metrics.referee import Way, best_of, cheapest_of
from neurotact.metrics.savings import Savings, savings, worse_than_another
from neurotact.metrics.shares import wilson_interval
from neurotact.report import first_screen, periods
from neurotact.report.answer import Baseline, Network, Trials, interval_of, opponents_of
from neurotact.report.front import Front, as_json, baseline_as_json, baselines_of
from neurotact.report.page import Figure, Table
from neurotact.report.wording import count, energy, percent
from neurotact.studies.measures import RECONSTRUCTION
from neurotact.studies.study import StudySpec, encoder_names

RATE = "spikes_per_s"
WIDE = 8.0
"""Costs that differ by more than this factor stand on a logarithmic axis."""


class Choice(NamedTuple):
    """One encoder with one refractory period.

    encoder: as the study names it. rate_per_s: to which it was calibrated; None if that is the same for all. network:
    the best one of this period on validation trials. readout: logistic regression on its spike counts; None if it was
    not fitted. snr_dB: of the signal given back on test trials; None if unknown. guess: the accuracy of guessing.
    setting: of its answer. rival: the best classifier of the signals on validation trials; None if none was fitted.
    """

    encoder: str
    rate_per_s: float | None
    network: Network
    trials: Trials
    readout: Baseline | None
    snr_dB: float | None
    guess: float = 0.0
    setting: str = ""
    rival: Baseline | None = None

    def way(self, *, in_sops: bool = False) -> Way:
        """What the referee knows of it: the cost is that of the decision as it is used, which sentences name.

        in_sops: whether synaptic operations are its cost, since the energy of one that is compared is unknown.
        """
        used = self.network.used
        return self.network.way(self.trials, used._replace(nJ=None) if in_sops else used)

    @property
    def interval(self) -> tuple[float, float]:
        """The 95 % interval of the test accuracy of the network as it is used."""
        return interval_of(self.network, self.network.used, self.trials)

    @property
    def label(self) -> str:
        """Its name in a picture."""
        return self.name.replace(" with t_ref ", ", ")

    @property
    def name(self) -> str:
        pair = self.network.pair
        period = "" if pair == periods.NONE else f" with t_ref {pair} ms"
        return f"{self.encoder}{period}{'' if self.rate_per_s is None else f' at {self.rate_per_s:g} spikes/s'}"


class Among(NamedTuple):
    """What a study that sweeps encoders answers, side by side.

    words: the headline, in one sentence; details: the same with all numbers. table: for the page; every: for
    `encoders.csv`. drawn: the picture, as `front.as_json` of one encoder. cell: the row of results that stands for the
    named encoder. All but `every` are empty for fewer than two encoders and periods.
    """

    words: str
    details: Sequence[str]
    figures: Sequence[Figure]
    table: Table | None
    every: pd.DataFrame
    drawn: Mapping[str, Any]
    cell: int | None


def among_encoders(
    study: StudySpec, fronts: Sequence[Front], results: pd.DataFrame, tables: Mapping[str, pd.DataFrame]
) -> Among | None:
    """The tool `among_encoders`: the answer of a study that sweeps encoders; None of another one. As of `choices`."""
    every = choices(study, fronts, results, tables)
    if len(every) < 2:
        return Among("", (), (), None, as_table(every), {}, None) if every else None
    picture = drawn(every, fronts)
    shown = picture["networks"][picture["best"]]["cell"]
    told = sentence(every), details(every), figures(every, study.prices.name), table(every), as_table(every)
    return Among(*told, picture, shown)


def choices(
    study: StudySpec, fronts: Sequence[Front], results: pd.DataFrame, tables: Mapping[str, pd.DataFrame]
) -> list[Choice]:
    """Every encoder and period of a study, the highest accuracy on validation trials first.

    fronts: the answer of each encoder (and rate). results: with the columns of `fronts`. tables: `baselines` and
    `reconstruction`, if they exist. Empty if the study does not sweep encoders.
    """
    named, every = encoder_names(study), []
    for front in fronts if named else ():
        row = results.loc[front.cells[0]].to_dict()
        baselines = {one.name: one for one in baselines_of(study, tables, row)}
        rate_per_s = float(row[RATE]) if RATE in row else None
        for network in _of_each_pair(front):
            pair = "" if network.pair == periods.NONE else f"{network.pair} ms "
            readout = baselines.get(f"{LINEAR} on {pair}spikes (counts)")
            snr_dB = _snr_dB(tables.get(RECONSTRUCTION), study, row, network.pair)
            one = front.answer
            on_signals = [baseline for baseline in one.others if not baseline.is_of_spikes]
            rival, _ = opponents_of(on_signals, [baseline.way(one.trials) for baseline in on_signals])
            told = one.trials, readout, snr_dB, one.guess, front.setting, rival
            every.append(Choice(named[row["encoder"]], rate_per_s, network, *told))
    return sorted(every, key=lambda one: -one.network.way(one.trials).validation)


def _of_each_pair(front: Front) -> Iterator[Network]:
    for pair in dict.fromkeys(network.pair for network in front.answer.rows):
        own = [network for network in front.answer.rows if network.pair == pair]
        yield own[best_of([network.way(front.answer.trials, network.used) for network in own])]


def _snr_dB(table: pd.DataFrame | None, study: StudySpec, row: Mapping[str, object], pair: str) -> float | None:  # noqa: N802
    """The ratio of signal to error of one encoder, mean over splits; None if it was not measured."""
    if table is None:
        return None
    own = pd.Series([*periods.of_rows(table, study)], index=table.index) == pair
    for key in ("encoder", RATE):
        own &= table[key] == row[key] if key in table and key in row else True
    return float(table["snr_dB"][own].mean()) if own.any() else None


def sentence(among: Sequence[Choice]) -> str:
    """One sentence: the encoder to take, what it costs, and what that saves; or that none is clearly the cheapest.

    Empty for fewer than two.
    """
    if len(among) < 2:
        return ""
    found = _savings(among)
    if not found.is_clear:
        return _unclear(among, found)
    one = named(among, found)
    right = f"right in {percent(one.network.accuracy)} of the test windows{_by_guessing(one)}"
    if len(found.level) == 1:
        above = max(among, key=lambda other: other.network.accuracy)
        but = ""
        if above.network.accuracy > one.network.accuracy:
            but = f"; on test trials {above.name} has {percent(above.network.accuracy)}, which is not clearly more"
        return f"{one.name} is more accurate than all others on validation trials: {right}, for {_spent(one)}{but}."
    beside = _beside(among, found)
    if beside is None:
        only = "the only one within the error of the best that test trials do not speak against"
        return f"{one.name} is {only}: {right}, for {_spent(one)}."
    level = "at an accuracy that validation trials cannot tell from its own"
    return f"{one.name} {_saves(one, beside)} {beside.name}, {level}: {right}, for {_spent(one)}."


def named(among: Sequence[Choice], found: Savings) -> Choice:
    """The encoder that is shown: the cheapest that keeps the accuracy, or the most accurate on validation trials."""
    return among[found.best if found.cheapest is None or not found.is_clear else found.cheapest]


def _beside(among: Sequence[Choice], found: Savings) -> Choice | None:
    """What the cheapest is compared with: the most accurate that keeps the accuracy, or else the next cheapest."""
    others = [among[at] for at in found.kept if at != found.cheapest]
    most = max((among[at] for at in found.kept), key=_validation, default=None)
    return most if most in others else min(others, key=lambda one: one.way(in_sops=_in_sops(among)).cost, default=None)


def _names(among: Sequence[Choice]) -> list[str]:
    return list(dict.fromkeys(one.encoder for one in among))


def _validation(one: Choice) -> float:
    return one.network.way(one.trials).validation


def _in_sops(among: Sequence[Choice]) -> bool:
    return any(one.network.used.nJ is None for one in among)


def _saves(one: Choice, other: Choice) -> str:
    """What a decision of one costs beside another, whose name follows: in energy, or else in synaptic operations."""
    (mine, its), what = (one.network.used.nJ, other.network.used.nJ), "energy"
    if mine is None or its is None:
        (mine, its), what = (one.network.used.sops, other.network.used.sops), "SOPs"
    if round(100 * mine / its) in (99, 100, 101):
        return f"takes as {'much' if what == 'energy' else 'many'} {what} as"
    return f"saves {100 * (1 - mine / its):.0f} % of the {what} of"


def _spent(one: Choice) -> str:
    used = one.network.used
    return f"{count(used.sops)} SOPs a decision" if used.nJ is None else f"{energy(used.nJ)} a decision"


def _by_guessing(one: Choice) -> str:
    return f", not clearly more often than by guessing ({percent(one.guess)})" if one.interval[0] <= one.guess else ""


def details(among: Sequence[Choice]) -> list[str]:
    """What validation and test trials say of the encoders, with intervals and costs."""
    found, every = _savings(among), f"{len(among)} encoders and refractory periods"
    several = len(found.level) > 1
    said = [
        f"Validation trials cannot tell {len(found.level)} of {every} apart."
        if several
        else f"Validation trials tell {among[found.best].name} from all others of {every}."
    ]
    cheapest = None if found.cheapest is None else among[found.cheapest]
    told = (among[found.best], cheapest, _beside(among, found), *(among[at] for at in found.contrary[:1]))
    named = {one.name: one for one in told if one is not None}
    return [*said, *(f"{name}: {_reached(one)}." for name, one in named.items())]


def _unclear(among: Sequence[Choice], found: Savings) -> str:
    """Why no encoder is called the cheapest: test trials speak against each that validation would choose."""
    if found.cheapest is None:
        return (
            f"No encoder is clearly the cheapest: {among[found.best].name} is the most accurate on validation trials, "
            "but test trials show each one within its standard error to be clearly less accurate than another."
        )
    chosen, other = among[found.cheapest], among[found.contrary[0]]
    return (
        f"No encoder is clearly the cheapest: validation trials prefer {chosen.name} "
        f"({percent(chosen.network.accuracy)} of the test windows, {_spent(chosen)}), and {other.name} is no dearer "
        f"and no less accurate on test trials ({percent(other.network.accuracy)}, {_spent(other)})."
    )


def _savings(among: Sequence[Choice]) -> Savings:
    """What the referee says: validation chooses, and test trials may show that a choice is worse than another."""
    in_sops = _in_sops(among)
    ways, tested = [one.way(in_sops=in_sops) for one in among], [one.network.accuracy for one in among]

    def compared(one: int, other: int) -> Paired:
        return compare_shares(tested[one], tested[other], among[one].trials.test)

    return savings(ways, tested, worse_than_another(ways, compared))


def _reached(one: Choice) -> str:
    """How often it is right, with the interval of its test trials, and what a decision costs."""
    used = one.network.used
    low, high = one.interval
    spent = f"{count(used.spikes)} spikes"
    spent += f"{'' if used.nJ is None else f' and {energy(used.nJ)}'}{_by_guessing(one)}"
    share = percent(used.accuracy)
    return f"right in {share} of the test windows ({100 * low:.0f} to {100 * high:.0f} %), for {spent}"


def figures(among: Sequence[Choice], prices: str) -> list[Figure]:
    """Accuracy and energy of the encoder that is named, beside the best classifier of the signals."""
    found = _savings(among)
    one, other = named(among, found), _beside(among, found)
    used, rival = one.network.used, one.rival
    of = first_screen.interval_in_words(one.interval, one.trials.test)
    against = "" if rival is None else f"{rival.name}: {first_screen.with_interval(rival.accuracy, one.trials.test)}"
    shown = [Figure("test accuracy", percent(used.accuracy), f"{one.name}; {of}", against)]
    if used.nJ is not None:
        costs = [(each.name, nJ) for each, nJ in ((other, other and other.network.used.nJ), (rival, rival and rival.nJ))
                 if each is not None and nJ is not None]  # fmt: skip
        against = "; ".join(f"{name}: {energy(nJ)}" for name, nJ in costs)
        shown.append(Figure("energy per decision", energy(used.nJ), f"an estimate by {prices}", against))
    return shown


def drawn(among: Sequence[Choice], fronts: Sequence[Front]) -> dict[str, Any]:
    """The picture: every network, those named that are the best of an encoder on validation trials.

    of: the encoder of each answer, by its setting. cost, scale: of the axis at first.
    """
    found = _savings(among)
    shown, groups = named(among, found), [[one for one in among if one.encoder == name] for name in _names(among)]
    chosen = [own[cheapest_of([one.way(in_sops=_in_sops(among)) for one in own])] for own in groups]
    best = {one.encoder: one for one in (*chosen, shown)}
    networks, at = [], 0
    for front in fronts:
        for network, entry in zip(front.answer.rows, as_json(front)["networks"], strict=True):
            (one,) = (one for one in among if one.setting == front.setting and one.network.pair == network.pair)
            is_best = best[one.encoder] is one and one.network is network
            at = len(networks) if one is shown and is_best else at
            label = one.label if is_best else ""
            networks.append(entry | {"name": f"{one.encoder}, {entry['name']}", "series": one.encoder, "label": label})
    spent = [one.network.used.nJ for one in among]
    is_counted = all(nJ is not None for nJ in spent)
    costs = [nJ for nJ in spent if nJ] if is_counted else [one.network.used.sops for one in among]
    return {
        "networks": networks, "best": at, "cheapest": at, "used": networks[at]["used"], "guess": shown.guess,
        "beside": baseline_as_json(shown.rival), "of": {one.setting: one.encoder for one in among},
        "cost": "nJ" if is_counted else "sops", "scale": "log" if max(costs) > WIDE * min(costs) > 0 else "linear",
    }  # fmt: skip


def table(among: Sequence[Choice]) -> Table | None:
    """Accuracy, what is given back of the signal, and cost of each encoder; None for fewer than two."""
    if len(among) < 2:
        return None
    found = _savings(among)
    cheapest = found.cheapest if found.is_clear else None
    rows = []
    for index, one in enumerate(among):
        said = first_screen.mark(is_best=index == found.best, is_cheapest=index == cheapest)
        mark = said or (" ~" if index in found.level else "")
        used, n_test = one.network.used, one.trials.test
        readout = "-" if one.readout is None else first_screen.with_interval(one.readout.accuracy, n_test)
        rows.append([
            f"{one.label}{mark}", first_screen.within(used.accuracy, one.interval),
            "-" if used.nJ is None else energy(used.nJ), count(used.spikes), readout,
            "-" if one.snr_dB is None else f"{one.snr_dB:.1f}",
        ])  # fmt: skip
    caption = (
        "Encoders and refractory periods, by accuracy on validation trials; ~: they cannot tell it from the best. "
        f"Accuracies on {among[0].trials.test} test trials with 95 % intervals; SNR: of the signal of test trials that "
        "a linear filter of the spikes gives back; energy is an estimate."
    )
    heads = ["encoder, t_ref", "test accuracy", "energy estimate", "input spikes", "linear readout", "SNR (dB)"]
    beside = _beside(among, found)
    told = [among[found.best], named(among, found), *([] if beside is None else [beside])]
    others = {one.encoder: one for one in reversed(among) if one.encoder not in {other.encoder for other in told}}
    order = [among.index(one) for one in (*told, *(one for one in among if others.get(one.encoder) is one))]
    return Table(caption, heads, rows, 1, [*order, *range(len(rows))])


def as_table(among: Sequence[Choice]) -> pd.DataFrame:
    """`encoders.csv`: a row for each encoder and refractory period, in the order of the page's table.

    Columns: encoder, t_ref_ms (as the report writes it), spikes_per_s, if it is swept; accuracy on validation and test
    trials with the limits of its 95 % interval, the same of the linear readout; snr_dB; spikes and energy_estimate_nJ
    of a decision.
    """
    rows = []
    for one in among:
        used = one.network.used
        low, high = one.interval
        row = {"encoder": one.encoder, "t_ref_ms": one.network.pair}
        row |= {} if one.rate_per_s is None else {RATE: one.rate_per_s}
        row |= {"accuracy_validation": one.network.way(one.trials).validation, "accuracy_test": used.accuracy}
        row |= {"accuracy_low": low, "accuracy_high": high}
        if one.readout is not None:
            low, high = wilson_interval(one.readout.accuracy, one.trials.test)
            row |= {"readout_validation": one.readout.validation, "readout_test": one.readout.accuracy}
            row |= {"readout_low": low, "readout_high": high}
        rows.append({**row, "snr_dB": one.snr_dB, "spikes": used.spikes, "energy_estimate_nJ": used.nJ})
    return pd.DataFrame(rows)
