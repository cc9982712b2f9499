"""The paired comparison: McNemar's test where trials are right or wrong, and what no order of trials may change."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binomtest

from neurotact.errors import InputError
from neurotact.metrics import paired

shares = st.lists(st.tuples(*[st.sampled_from([0.0, 0.25, 0.5, 1.0])] * 2), min_size=1, max_size=12)


@given(st.integers(0, 6), st.integers(0, 6), st.integers(0, 20))
def test_of_right_and_wrong_trials_it_is_mcnemars_exact_test(only_one, only_other, both):
    if only_one + only_other + both == 0:
        return
    right = np.r_[np.ones(only_one), np.zeros(only_other), np.ones(both)]
    other = np.r_[np.zeros(only_one), np.ones(only_other), np.ones(both)]
    found = paired.compare(right, other)
    apart = only_one + only_other
    assert found.p == pytest.approx(binomtest(only_one, apart).pvalue if apart else 1.0)
    assert found.difference == pytest.approx((only_one - only_other) / len(right))
    assert found.n == len(right)


@given(shares, st.randoms(use_true_random=False))
def test_neither_the_order_of_trials_nor_that_of_classifiers_changes_p(rows, shuffled):
    right, other = np.array(rows).T
    found, turned = paired.compare(right, other), paired.compare(other, right)
    assert turned.p == pytest.approx(found.p)
    assert turned.difference == pytest.approx(-found.difference)
    shuffled.shuffle(rows)
    assert paired.compare(*np.array(rows).T).p == pytest.approx(found.p)
    assert 0 < found.p <= 1


def test_with_many_trials_random_signs_come_near_the_exact_test_and_repeat():
    right, other = np.r_[np.ones(60), np.zeros(35)], np.r_[np.zeros(60), np.ones(35)]
    found = paired.compare(right, other)
    assert found.p == pytest.approx(binomtest(60, 95).pvalue, rel=0.35)
    assert found.is_clear
    assert paired.compare(right, other) == found


@pytest.mark.parametrize(("n", "m"), [(3, 4), (0, 0)])
def test_other_trials_are_refused(n, m):
    with pytest.raises(InputError, match="give the same trials"):
        paired.compare(np.zeros(n), np.zeros(m))
