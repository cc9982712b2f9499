"""Under every price list: what is said of a ratio is what its numbers are."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from neurotact.metrics import prices
from neurotact.report import under_prices
from neurotact.report.answer import Baseline, Decision, Network, Trials, answer

NAMES = ("own", "b", "c")
energies = st.lists(st.floats(0.01, 1e4), min_size=3, max_size=3)


def outcome(ours, *rivals, accuracy=0.9, sizes=(), guess=0.25):
    """An answer of one network and rivals on signals, each with its energies under `NAMES`."""
    by_list = [tuple(zip(NAMES, one, strict=False)) for one in (ours, *rivals)]
    used = Decision(accuracy, 100.0, 50.0, 10.0, ours[0], by_list[0])
    others = [
        Baseline(f"r{index} on signals (means)", 0.9, 0.9, one[0][1], by_list=one, bytes=size)
        for index, (one, size) in enumerate(zip(by_list[1:], [*sizes, *[100.0] * len(rivals)], strict=False))
    ]
    return answer([Network("1&1", 50, 1, 0.9, used, None)], others, guess, Trials(200, 200), prices="own")


@given(energies, energies, energies)
def test_the_cheapest_of_each_list_is_compared(ours, first, second):
    found = under_prices.under_lists(outcome(ours, first, second))
    assert [one.prices for one in found] == [*NAMES]
    for index, one in enumerate(found):
        assert one.ratio == pytest.approx(ours[index] / min(first[index], second[index]))


@given(energies, energies)
def test_a_list_is_named_if_and_only_if_it_turns_or_changes_the_ratio(ours, rival):
    first, *others = (own / other for own, other in zip(ours, rival, strict=True))
    (said, *_) = [*under_prices.sentences(outcome(ours, rival)), ""]
    turned = said.partition("the ratio is over")[0] if "it takes" in said else ""
    for name, ratio in zip(NAMES[1:], others, strict=True):
        is_turned = (ratio < 1) != (first < 1)
        is_changed = not 1 / 3 <= ratio / first <= 3
        assert (f"{name} (" in turned) == is_turned
        assert (f"{name} (" in said) == (is_turned or is_changed)
    more, less = (f"{under_prices.times(one)} times" for one in (first, 1 / first))
    own = f"{less} less energy than" if first < 1 else f"{more} the energy of"
    assert said.startswith(f"By own the network takes {own} r0 on signals")
    assert ("it takes less" in said) == (bool(turned) and first >= 1)
    assert ("it takes more" in said) == (bool(turned) and first < 1)
    assert ("none of 2 other lists" in said) == ("b (" not in said and "c (" not in said)


def test_a_rival_that_holds_much_names_the_cheapest_that_fits():
    found = outcome((10.0, 10.0, 10.0), (1.0, 1.0, 1.0), (5.0, 5.0, 5.0), sizes=(4e6, 2e4))
    said = [*under_prices.sentences(found)][-1]
    assert said == (
        "r0 on signals (means) holds 3,900 kB; the cheapest that fits 64 kB is r1 on signals (means) at 5 nJ and 90.0 "
        "%: the network takes 2 times the energy of r1 on signals."
    )
    none = outcome((10.0,) * 3, (1.0,) * 3, sizes=(4e6,))
    assert [*under_prices.sentences(none)][-1].endswith("none that is not clearly less accurate fits 64 kB.")
    assert len([*under_prices.sentences(outcome((10.0,) * 3, (1.0,) * 3, sizes=(under_prices.SMALL,)))]) == 1


def test_the_list_alone_is_named_where_nothing_was_learned_or_the_own_list_does_not_count():
    own = outcome((1.0,) * 3, (2.0,) * 3)
    for silent in (outcome((1.0,) * 3, (2.0,) * 3, accuracy=0.25), outcome((1.0,) * 3), own._replace(prices="another")):
        assert [*under_prices.sentences(silent)] == [f"Energies are by the price list {silent.prices}."]


def test_the_table_has_a_row_for_each_list_and_says_what_is_not_counted():
    found = under_prices.table(outcome((8.0, 1.0, 3.0), (2.0, 4.0)))
    assert found is not None
    assert [row[0] for row in found.rows] == [*NAMES]
    assert [row[3] for row in found.rows] == ["4", "0.25", ""]
    assert found.rows[2][4] == "r0 on signals (means): not counted"
    assert under_prices.table(outcome((8.0,), (2.0,))) is None


def test_the_lists_are_all_that_are_installed_that_of_the_study_first():
    own = prices.price_list("loihi")
    assert [one.name for one in under_prices.lists(own)] == [
        "loihi",
        *(name for name in prices.names() if name != "loihi"),
    ]
