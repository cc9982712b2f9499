"""Price lists: each price counts for its kind, a wrong one is refused, and a study takes a list by name or path."""

import math
from importlib.metadata import EntryPoint
from pathlib import Path

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
    monkeypatch.setattr(spec, "load", lambda *_: pytest.fail("a list was read again"))
    assert [price_list(name).name for name in names()] == names()


def test_a_package_with_a_name_of_ours_is_refused(monkeypatch):
    monkeypatch.setattr(plugins, "_package", lambda point: "their-prices")
    point = EntryPoint("memory-45nm", "their_prices:CHEAP", "neurotact.prices")
    monkeypatch.setattr(plugins, "_found", lambda group: {"memory-45nm": [point]})
    with pytest.raises(InputError, match="'memory-45nm' is provided by neurotact and their-prices; uninstall"):
        price_list("memory-45nm")
