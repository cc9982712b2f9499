"""Numbers in a report are what they stand for, to the digits that are shown, and have no exponent."""

import math

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from neurotact.report.wording import count, energy, milliseconds

IN_NJ = {"pJ": 1e-3, "nJ": 1.0, "µJ": 1e3, "mJ": 1e6, "J": 1e9}


@given(st.floats(-6, 13))
@example(math.log10(999.7))
def test_an_energy_of_any_size_has_its_unit_and_no_exponent(exponent):
    number, unit = energy(10**exponent).split()
    assert "e" not in number
    value = float(number.replace(",", ""))
    assert value * IN_NJ[unit] == pytest.approx(10**exponent, rel=0.0051)
    assert value < 1000 or unit == "J"
    assert value >= (0.001 if unit == "pJ" else 0.00995 if unit == "nJ" else 0.9995)


@given(st.floats(-5, 15), st.integers(1, 6))
def test_a_number_has_so_many_digits_and_no_exponent(exponent, digits):
    said = count(10**exponent, digits)
    assert "e" not in said.lower()
    assert float(said.replace(",", "")) == float(f"{10**exponent:.{digits}g}")
    assert float(milliseconds(10**exponent).removesuffix(" ms").replace(",", "")) == pytest.approx(
        10**exponent, rel=0.0051
    )


def test_what_is_not_known_is_not_counted_and_nothing_is_nothing():
    assert (energy(math.nan), count(math.nan), energy(0.0)) == ("not counted", "not counted", "0 nJ")
