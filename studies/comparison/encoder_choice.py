"""Which encoder: what a study that sweeps encoders answers; validation chooses, test trials may speak against it."""

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import pandas as pd

from neurotact.baselines.opponents import LINEAR
from neurotact.encoders import specs as encoders
from neurotact.metrics.paired import Paired, compare_shares
from neurotact.metrics.referee import Way, best_of
from neurotact.metrics.savings import Savings, savings, worse_than_another
from neurotact.metrics.shares import wilson_interval
from neurotact.report import first_screen, periods
from neurotact.report.answer import Baseline, Network, Trials, interval_of
from neurotact.report.front import Front, baselines_of
from neurotact.report.page import Table
from neurotact.report.wording import count, energy, percent
from neurotact.studies import sweeps
from neurotact.studies.measures import RECONSTRUCTION
from neurotact.studies.study import StudySpec

RATE = "spikes_per_s"


class Choice(NamedTuple):
    """One encoder with one refractory period.

    encoder: as the study names it. rate_per_s: to which it was calibrated; None if that is the same for all. network:
    the best one of this period on validation trials. readout: logistic regression on its spike counts; None if it was
    not fitted. snr_dB: of the signal given back on test trials; None if unknown. guess: the accuracy of guessing.
    """

    encoder: str
    rate_per_s: float | None
    network: Network
    trials: Trials
    readout: Baseline | None
    snr_dB: float | None
    guess: float = 0.0

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
    def name(self) -> str:
        pair = self.network.pair
        period = "" if pair == periods.NONE else f" with t_ref {pair} ms"
        return f"{self.encoder}{period}{'' if self.rate_per_s is None else f' at {self.rate_per_s:g} spikes/s'}"


class Among(NamedTuple):
    """What a study that sweeps encoders answers: a sentence, its table for the page, and that for `encoders.csv`."""

    words: str
    table: Table | None
    every: pd.DataFrame


def among_encoders(
    study: StudySpec, fronts: Sequence[Front], results: pd.DataFrame, tables: Mapping[str, pd.DataFrame]
) -> Among | None:
    """The tool `among_encoders`: the answer of a study that sweeps encoders; None of another one. As of `choices`."""
    every = choices(study, fronts, results, tables)
    return Among(sentence(every), table(every), as_table(every)) if every else None


def choices(
    study: StudySpec, fronts: Sequence[Front], results: pd.DataFrame, tables: Mapping[str, pd.DataFrame]
) -> list[Choice]:
    """Every encoder and period of a study, the highest accuracy on validation trials first.

    fronts: the answer of each encoder (and rate). results: with the columns of `fronts`. tables: `baselines` and
    `reconstruction`, if they exist. Empty if the study does not sweep encoders.
    """
    names = [name for name in sweeps.values(study.sweep, "encoder") if isinstance(name, str)]
    named = {encoders.load(name).model: name for name in dict.fromkeys(names)}
    every = []
    for front in fronts if named else ():
        row = results.loc[front.cells[0]].to_dict()
        baselines = {one.name: one for one in baselines_of(study, tables, row)}
        rate_per_s = float(row[RATE]) if RATE in row else None
        for network in _of_each_pair(front):
            pair = "" if network.pair == periods.NONE else f"{network.pair} ms "
            readout = baselines.get(f"{LINEAR} on {pair}spikes (counts)")
            snr_dB = _snr_dB(tables.get(RECONSTRUCTION), study, row, network.pair)
            one = front.answer
            every.append(Choice(named[row["encoder"]], rate_per_s, network, one.trials, readout, snr_dB, one.guess))
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
    """One sentence: the encoder that costs least of those that keep the accuracy, or that none can be told to.

    Empty for fewer than two.
    """
    if len(among) < 2:
        return ""
    found = _savings(among)
    best = among[found.best]
    if not found.is_clear:
        return _unclear(among, found)
    assert found.cheapest is not None
    cheapest, every = among[found.cheapest], f"{len(among)} encoders and refractory periods"
    if len(found.level) == 1:
        above = max(among, key=lambda one: one.network.accuracy)
        is_above = above.network.accuracy > best.network.accuracy
        more = f"; test trials cannot tell it from {above.name}, {_reached(above)}" if is_above else ""
        return (
            f"{best.name} is the most accurate of {every} on validation trials, which tell it from all others: "
            f"{_reached(best)}{more}."
        )
    said = (
        f"Validation trials cannot tell {len(found.level)} of {every} apart; the cheapest within the error of the best "
        f"is {cheapest.name}: {_reached(cheapest)}"
    )
    most = max((among[at] for at in found.kept), key=lambda one: one.network.way(one.trials).validation)
    return f"{said}." if most is cheapest else f"{said}, {_saved(cheapest, most)} of {most.name}: {_reached(most)}."


def _unclear(among: Sequence[Choice], found: Savings) -> str:
    """Why no encoder is called the cheapest: test trials speak against each that validation would choose."""
    said = "Validation and test trials cannot tell which encoder is the cheapest at the accuracy of the best: "
    if found.cheapest is None:
        best = among[found.best]
        return (
            f"{said}{best.name}, the most accurate on validation trials, is {_reached(best)}; test trials show each "
            "one within its standard error to be clearly less accurate than another."
        )
    chosen, other = among[found.cheapest], among[found.contrary[0]]
    return (
        f"{said}validation prefers {chosen.name}, {_reached(chosen)}; on test trials {other.name} is no dearer and no "
        f"less accurate, {_reached(other)}."
    )


def _savings(among: Sequence[Choice]) -> Savings:
    """What the referee says: validation chooses, and test trials may show that a choice is worse than another."""
    in_sops = any(one.network.used.nJ is None for one in among)
    ways, tested = [one.way(in_sops=in_sops) for one in among], [one.network.accuracy for one in among]

    def compared(one: int, other: int) -> Paired:
        return compare_shares(tested[one], tested[other], among[one].trials.test)

    return savings(ways, tested, worse_than_another(ways, compared))


def _reached(one: Choice) -> str:
    """How often it is right, with the interval of its test trials, and what a decision costs."""
    used = one.network.used
    low, high = one.interval
    spent = f"{count(used.spikes)} spikes"
    spent += "" if used.nJ is None else f" and {energy(used.nJ)}"
    if low <= one.guess:
        spent += f", not clearly more often than by guessing ({percent(one.guess)})"
    share = percent(used.accuracy)
    return f"right in {share} of the test windows ({100 * low:.0f} to {100 * high:.0f} %), for {spent}"


def _saved(one: Choice, best: Choice) -> str:
    reached, before = one.network.used, best.network.used
    saved = f"{_share(reached.spikes, before.spikes)} of the spikes"
    if reached.nJ is not None and before.nJ:
        saved += f" and {_share(reached.nJ, before.nJ)} of the energy"
    return saved


def _share(after: float, before: float) -> str:
    """
    >>> _share(44.2, 307.0), _share(155.0, 154.0), _share(2.0, 300.0)
    ('14 %', '101 %', '0.67 %')
    """
    share = 100 * after / before if before > 0 else 100.0
    return f"{share:.0f} %" if share >= 1 else f"{share:.2g} %"


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
        rate = "" if one.rate_per_s is None else f" at {one.rate_per_s:g} spikes/s"
        rows.append([
            f"{one.encoder}{rate}{mark}", one.network.pair, count(used.spikes),
            first_screen.within(used.accuracy, one.interval), readout,
            "-" if one.snr_dB is None else f"{one.snr_dB:.1f}", "-" if used.nJ is None else energy(used.nJ),
        ])  # fmt: skip
    caption = (
        "Encoders and refractory periods, by accuracy on validation trials; ~: they cannot tell it from the best. "
        f"Accuracies on {among[0].trials.test} test trials with 95 % intervals; SNR: of the signal of test trials that "
        "a linear filter of the spikes gives back; energy is an estimate."
    )
    heads = ["encoder", "t_ref (ms)", "input spikes", "network", "linear readout", "SNR (dB)", "energy estimate"]
    order = [row for row in (found.best, found.cheapest) if row is not None]
    return Table(caption, heads, rows, 2, [*order, *range(len(rows))])


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
