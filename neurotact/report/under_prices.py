"""The energy of the answer under every price list: where its verdict turns.

A list decides what is dear: memory, width, a chip. So the ratio of a network to its rivals is given under each, and a
sentence says under which lists it falls below 1, or rises above it, or changes by more than `MUCH`.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import NamedTuple

from neurotact.metrics import prices
from neurotact.metrics.prices import PriceList, price_list
from neurotact.report.answer import Baseline, OfNetworks, Priced
from neurotact.report.page import Table
from neurotact.report.wording import count, energy, percent

MUCH = 3.0
"""A ratio that changes by more than this factor is said."""
SMALL = 64 * 1024
"""Bytes for parameters and state that a small microcontroller has."""


def lists(own: PriceList) -> list[PriceList]:
    """That of a study first, then every other that is installed."""
    return [own, *(one for one in map(price_list, prices.names()) if one.name != own.name)]


class Under(NamedTuple):
    """A price list: the energy of the network, as it is used, and of its rivals; None where it is not counted.

    rival: the cheapest on signals by this list, of those that are not clearly less accurate. best: the most accurate of
    all on validation trials.
    """

    prices: str
    nJ: float
    rival: Baseline | None
    best: Baseline | None

    @property
    def ratio(self) -> float:
        """How many times the energy of the cheapest rival the network takes; NaN where either is not known."""
        return self.against(self.rival)

    def against(self, other: Baseline | None) -> float:
        """How many times the energy of another classifier the network takes."""
        spent = math.nan if other is None else dict(other.by_list).get(self.prices, math.nan)
        return self.nJ / spent if spent > 0 else math.nan


def under_lists(outcome: OfNetworks) -> list[Under]:
    """The best network and its rivals under each list that counts it, that of the study first."""
    network, rivals = outcome.priced[0].network, outcome.priced[0].comparables
    return [Under(name, nJ, _cheapest(rivals, name), outcome.baseline) for name, nJ in network.used.by_list]


def _cheapest(rivals: Sequence[Baseline], name: str) -> Baseline | None:
    known = [(energies[name], one) for one in rivals if name in (energies := dict(one.by_list))]
    return min(known, key=lambda pair: pair[0], default=(0.0, None))[1]


def sentences(outcome: OfNetworks) -> Iterator[str]:
    """Under which lists the ratio of energies turns or changes, and the cheapest rival that fits a small memory.

    Where no ratio is known, the list by which energies are.
    """
    found = [one for one in under_lists(outcome) if not math.isnan(one.ratio)]
    if not outcome.is_above_chance or not found or found[0].prices != outcome.prices:
        if outcome.best.whole.nJ is not None:
            yield f"Energies are by the price list {outcome.prices}."
        return
    own = found[0]
    if found[1:]:
        by_name = {one.prices: one for one in found}
        yield turning(
            {name: one.ratio for name, one in by_name.items()},
            lambda name: _ratio(by_name[name].ratio, by_name[name].rival),
        )
    yield from _that_fits(outcome.priced[0], own)


def turning(ratios: Mapping[str, float], said: Callable[[str], str]) -> str:
    """By which lists a ratio of energies is on the other side of 1, or `MUCH` larger or smaller, than by the first.

    ratios: of a network and a rival by each list. said: the ratio by a list in words, with the rival.

    >>> turning({"own": 2.0, "b": 0.5}, lambda name: {"own": "twice that of trees", "b": "half that of trees"}[name])
    'By own the network takes twice that of trees; it takes less by b (half that of trees).'
    """
    (base, own), *others = ratios.items()
    turned = [name for name, ratio in others if (ratio < 1) != (own < 1)]
    changed = [name for name, ratio in others if name not in turned and not 1 / MUCH <= ratio / own <= MUCH]
    other = f"it takes {'less' if own >= 1 else 'more'} by"
    both = (other, turned), (f"the ratio is over {MUCH:g} times another by", changed)
    parts = [f"{words} {_listed([f'{name} ({said(name)})' for name in names])}" for words, names in both if names]
    none = f"none of {len(others)} other lists turns this or changes it by more than {MUCH:g} times"
    return f"By {base} the network takes {said(base)}; {'; '.join(parts) or none}."


def _listed(words: Sequence[str]) -> str:
    return " and ".join([", ".join(words[:-1]), words[-1]] if words[1:] else words)


def _ratio(ratio: float, rival: Baseline | None) -> str:
    """What a network takes beside a rival, in words."""
    assert rival is not None
    if ratio < 1:
        return f"{times(1 / ratio)} times less energy than {rival.short}"
    return f"{times(ratio)} times the energy of {rival.short}"


def times(ratio: float) -> str:
    """A ratio with two digits.

    >>> times(0.0714), times(31.4), times(1234.0)
    ('0.071', '31', '1,200')
    """
    return count(ratio, 2)


def _that_fits(priced: Priced, own: Under) -> Iterator[str]:
    """Of rivals that are not clearly less accurate, the cheapest with little memory, where the cheapest takes more."""
    rival = own.rival
    if rival is None or rival.bytes is None or rival.bytes <= SMALL:
        return
    small = _cheapest([one for one in priced.comparables if one.bytes is not None and one.bytes <= SMALL], own.prices)
    said = f"{rival.name} holds {count(rival.bytes / 1024, 2)} kB"
    if small is None:
        yield f"{said}; none that is not clearly less accurate fits {SMALL // 1024} kB."
    else:
        spent = dict(small.by_list)[own.prices]
        yield (
            f"{said}; the cheapest that fits {SMALL // 1024} kB is {small.name} at {energy(spent)} and "
            f"{percent(small.accuracy)}: the network takes {_ratio(own.against(small), small)}."
        )


def table(outcome: OfNetworks) -> Table | None:
    """The best network and its rivals under each list; None where it is counted under no other than its own."""
    found = under_lists(outcome)
    if len(found) < 2:
        return None
    rows = [[one.prices, energy(one.nJ), *_cells(one, one.rival), *_cells(one, one.best)] for one in found]
    heads = ["prices", outcome.best.name, "cheapest rival on signals", "times", "most accurate rival", "times"]
    caption = (
        "Energy of a decision under each price list, and how many times that of a rival the network takes. The "
        "cheapest rival is of those that are not clearly less accurate; validation chooses the most accurate."
    )
    return Table(caption, heads, rows, n_heads=1)


def _cells(one: Under, other: Baseline | None) -> list[str]:
    if other is None or math.isnan(one.against(other)):
        return ["" if other is None else f"{other.name}: not counted", ""]
    return [f"{other.name}: {energy(dict(other.by_list)[one.prices])}", times(one.against(other))]
