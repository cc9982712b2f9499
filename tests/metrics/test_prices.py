"""Price lists: each price counts for its kind, a wrong one is refused, and a study takes a list by name or path."""

import math
from importlib.metadata import EntryPoint
from pathlib import Path

import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from neurotact import plugins, spec
from neurotact.errors import InputError
from neurotact.metrics.flops import FLOPS, Cost
from neurotact.metrics.prices import ARITHMETIC_45NM, DEFAULT, PriceList, names, price_list
from neurotact.studies import loading, study

TINY = Path(__file__).parents[1] / "studies" / "tiny.toml"
KEYS = ("mac_pJ", "addition_pJ", "multiplication_pJ", "comparison_pJ", "division_pJ", "exponential_pJ")
PRICES = st.floats(0, 1e6)
CHIP = 'source = "a data sheet"\nmultiplication_pJ = 7.4\naddition_pJ = 1.8\n'


@given(st.tuples(*[PRICES] * 6), st.tuples(*[st.integers(0, 10**6)] * 6))
def test_the_energy_is_the_sum_of_prices_times_operations(prices, counts):
    one = PriceList(source="a test", **dict(zip(KEYS, prices, strict=True)))
    spent = Cost(**dict(zip(FLOPS, counts, strict=True)))
    expected = 1e-3 * sum(price * n for price, n in zip(prices, counts, strict=True))
    assert spent.energy_nJ(one) == spent.columns("energy_estimate_nJ", prices=one)["energy_estimate_nJ"]
    assert spent.energy_nJ(one) == pytest.approx(expected)
    assert spent.energy_nJ() == spent.energy_estimate_nJ == spent.energy_nJ(ARITHMETIC_45NM)


@pytest.mark.parametrize("key", KEYS)
@pytest.mark.parametrize("wrong", [-1e-9, math.nan, math.inf, 1e10])
def test_a_price_that_is_none_is_refused(key, wrong):
    prices = {"multiplication_pJ": 1.0, "addition_pJ": 1.0, key: wrong}
    with pytest.raises(InputError, match=rf"^{key}: must be "):
        PriceList(source="a test", **prices)


@pytest.mark.parametrize("key", ["source", "multiplication_pJ", "addition_pJ"])
def test_a_list_without_a_source_or_a_price_is_refused(tmp_path, key):
    (tmp_path / "chip.toml").write_text("\n".join(line for line in CHIP.splitlines() if not line.startswith(key)))
    with pytest.raises(InputError, match=rf"^{key}: is missing; add it \(.*chip\.toml\)$"):
        price_list(tmp_path / "chip.toml")


def test_a_study_takes_a_list_beside_it_and_keeps_it_whole(tmp_path):
    """The cells are the same by any list, and a saved study needs neither the file nor the package."""
    (tmp_path / "chip.toml").write_text(CHIP)
    mine = tmp_path / "mine.toml"
    mine.write_text('prices = "chip.toml"\n' + TINY.read_text())
    usual, dear, again = study.resolve(TINY), study.resolve(mine), study.resolve(mine, {"prices": "arithmetic-45nm"})
    assert (usual.prices, dear.prices.name, again.prices) == (price_list(DEFAULT), "chip", ARITHMETIC_45NM)
    assert usual.digest() == dear.digest()
    (tmp_path / "chip.toml").unlink()
    saved = tmp_path / "study.toml"
    saved.write_text(spec.to_toml(spec.saved(dear.model_dump(mode="json", exclude_none=True))))
    assert loading.read_back(saved).prices == dear.prices
    with pytest.raises(InputError, match="prices: there is none called 'arithmetic-46nm'; did you mean"):
        study.resolve(TINY, {"prices": "arithmetic-46nm"})


def test_the_lists_that_ship_are_read_once(monkeypatch):
    """A report prices every row by every list."""
    read = [price_list(name) for name in names()]
    monkeypatch.setattr(spec, "load", lambda *_: pytest.fail("a list was read again"))
    assert [price_list(name) for name in names()] == read
    assert [one.name for one in read] == names()


@pytest.mark.parametrize("name", names())
def test_a_list_like_another_has_its_keys_but_for_its_own(name, tmp_path):
    """Also a copy of a list that ships is whole, and a saved study needs no other list."""
    other, own = price_list(name), {"addition_pJ": 0.07, "event_driven": True}
    expected = other.model_copy(update={**own, "name": "unnamed"})
    assert PriceList(like=name, **own) == expected
    (shipped,) = [path for path in spec.shipped("prices") if path.stem == name]
    copied = tmp_path / "copied.toml"
    copied.write_text(spec.text(shipped))
    assert price_list(copied) == other.model_copy(update={"name": "copied"})
    copied.write_text(f'like = "{name}"\n' + spec.to_toml(own))
    assert price_list(copied) == expected.model_copy(update={"name": "copied"})
    assert "like" not in price_list(copied).model_dump(exclude_none=True)


@pytest.mark.parametrize(
    ("keys", "complaint"),
    [
        ({"like": "memory-45mm"}, "there is none called 'memory-45mm'; did you mean 'memory-45nm'"),
        ({"like": "./mine.toml"}, "like: must be the name of an installed price list; got ./mine.toml"),
        ({"like": "memory-45nm", "sent_operation_pJ": 1.0}, "sent_operation_pJ: needs a price of the others"),
        (
            {"like": "memory-45nm", "synaptic_operation_pJ": 1.0},
            "memory_pJ: synaptic_operation_pJ stands for its memory",
        ),
        (
            {"like": "loihi", "memory_pJ": [[0, 1.0], [9, 2.0]]},
            "memory_pJ: synaptic_operation_pJ stands for its memory",
        ),
        ({"like": "memory-45nm", "neuron_update_pJ": 1.0}, "memory_pJ: neuron_update_pJ stands for its memory, too"),
    ],
)
def test_what_no_list_can_be_like_is_refused(keys, complaint):
    with pytest.raises(InputError, match=complaint):
        PriceList(**keys)


COUNTS = st.floats(0, 1e6)


@given(st.tuples(*[PRICES] * 4), COUNTS, COUNTS, COUNTS, COUNTS)
def test_what_a_chip_charges_is_in_place_of_additions(prices, afferents, sent, updates, readout):
    of_any, of_sent, update, of_readout = prices
    one = PriceList(
        source="a test", multiplication_pJ=1.0, addition_pJ=1.0, synaptic_operation_pJ=of_any,
        sent_operation_pJ=of_sent, neuron_update_pJ=update, readout_update_pJ=of_readout,
    )  # fmt: skip
    sops = afferents + sent
    spent = Cost(acs=sops + 5, sops=sops, sops_sent=sent, neuron_updates=updates, readout_updates=readout)
    expected = 5 + afferents * of_any + sent * of_sent + updates * update + readout * of_readout
    assert 1e3 * spent.energy_nJ(one) == pytest.approx(expected)
    before = pd.DataFrame([{"acs": sops + 5.0, "sops": sops, "neuron_updates": updates}])  # rows of an earlier version
    known = one.model_copy(update={"sent_operation_pJ": None, "readout_update_pJ": None})
    assert known.energy_nJ(before.assign(sops_sent=math.nan, readout_updates=math.nan)).notna().all()


def test_a_package_with_a_name_of_ours_is_refused(monkeypatch):
    monkeypatch.setattr(plugins, "_package", lambda point: "their-prices")
    point = EntryPoint("memory-45nm", "their_prices:CHEAP", "neurotact.prices")
    monkeypatch.setattr(plugins, "_found", lambda group: {"memory-45nm": [point]})
    with pytest.raises(InputError, match="'memory-45nm' is provided by neurotact and their-prices; uninstall"):
        price_list("memory-45nm")
