"""Interval and standard error of a share, against SciPy and by hand."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binomtest

from neurotact.metrics.shares import standard_error, wilson_interval

COUNTS = st.integers(1, 5000).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n)))


@given(COUNTS)
def test_the_interval_is_wilsons(k_of_n):
    k, n = k_of_n
    expected = binomtest(k, n).proportion_ci(0.95, method="wilson")
    assert wilson_interval(k / n, n) == pytest.approx((expected.low, expected.high), abs=1e-12)


def test_the_error_is_that_of_two_more_right_and_wrong_trials():
    # (0.9 * 96 + 2) / 100 = 0.884; sqrt(0.884 * 0.116 / 100) = 0.03202
    assert standard_error(0.9, 96) == pytest.approx(0.0320225, abs=1e-6)


@given(COUNTS)
def test_the_error_is_the_same_of_right_and_wrong_and_never_zero(k_of_n):
    k, n = k_of_n
    assert standard_error(k / n, n) > 0
    assert standard_error(k / n, n) == pytest.approx(standard_error(1 - k / n, n))
