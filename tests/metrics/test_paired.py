"""The paired comparison: McNemar's test where trials are right or wrong, and what no order of trials may change."""

from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from levels import thinned
from scipy.stats import binom, binomtest, norm

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


@given(st.integers(0, 400), st.integers(0, 400))
def test_p_is_exact_with_any_number_of_trials(better, worse):
    """Of 28 trials that one alone has right, 2 of 2^28 sign vectors are as extreme: p is 7.5e-9."""
    found = paired.compare(np.r_[1.0, np.ones(better), np.zeros(worse)], np.r_[1.0, np.zeros(better), np.ones(worse)])
    assert found.p == pytest.approx(binomtest(better, better + worse).pvalue if better + worse else 1.0, rel=1e-9)
    assert paired.sign_test(better, worse) == pytest.approx(found.p, rel=1e-9)


@given(st.lists(st.sampled_from([-1.0, -1 / 3, -0.3, 0.1, 1 / 3, 2 / 3, 0.6]), min_size=1, max_size=10))
def test_p_is_the_share_of_all_signs_that_give_a_sum_as_large(differences):
    signs = np.array([*product([-1.0, 1.0], repeat=len(differences))])
    expected = np.mean(np.abs(signs @ differences) > abs(sum(differences)) - 1e-9)
    values = np.array(differences)
    assert paired.compare(values, np.zeros(len(values))).p == pytest.approx(expected)


def test_unlike_differences_beyond_count_are_compared_with_random_signs_and_never_certain():
    values = np.random.default_rng(3).random(60) + 0.5
    found = paired.compare(values, np.zeros(60))
    assert found.p == 1 / 10_000
    assert paired.compare(values, np.zeros(60)) == found
    mixed = values * np.resize([1.0, 1.0, -1.0], 60)
    z = mixed.sum() / np.sqrt((mixed**2).sum())
    found = paired.compare(mixed, np.zeros(60))
    assert found.p == pytest.approx(2 * norm.sf(abs(z)), rel=0.2)
    assert paired.compare(np.zeros(60), mixed).p == found.p
    assert paired.compare(mixed[::-1].copy(), np.zeros(60)).p == found.p
    many = np.resize(values, 700) * np.resize([1.0, -1.0], 700)  # in several parts
    many[1:50:2] *= -1
    z = many.sum() / np.sqrt((many**2).sum())
    assert paired.compare(many, np.zeros(700)).p == pytest.approx(2 * norm.sf(abs(z)), rel=0.2)


@thinned("n", [9, 5, 6, 8, 12, 15, 20, 31, 45, 60, 96, 200])
def test_shares_of_equal_classifiers_differ_in_at_most_one_of_twenty(n):
    """Exact, over all numbers of right trials of both; any accuracy."""
    clear = np.array([[paired.compare_shares(i / n, j / n, n).is_clear for j in range(n + 1)] for i in range(n + 1)])
    for accuracy in np.linspace(0.01, 0.99, 50):
        chances = binom.pmf(range(n + 1), n, accuracy)
        assert chances @ clear @ chances <= 0.05


@given(st.integers(1, 200), st.data())
def test_shares_tell_no_more_than_the_trials_that_must_differ(n, data):
    right, other = (data.draw(st.integers(0, n)) for _ in range(2))
    found = paired.compare_shares(right / n, other / n, n)
    assert found.p >= paired.sign_test(abs(right - other), 0) * 0.999
    assert found == paired.compare_shares(other / n, right / n, n)._replace(difference=found.difference)
    assert (found.difference, found.n) == (pytest.approx((right - other) / n), n)


def test_shares_far_apart_are_clear():
    assert paired.compare_shares(0.9, 0.5, 40).is_clear
    assert paired.compare_shares(0.9, 0.5, 40).p == pytest.approx(0.000117, rel=0.01)  # z = (15.5 / 44) / 0.0914


@pytest.mark.parametrize(("n", "m"), [(3, 4), (0, 0)])
def test_other_trials_are_refused(n, m):
    with pytest.raises(InputError, match="give the same trials"):
        paired.compare(np.zeros(n), np.zeros(m))


@given(st.one_of(st.floats(0, 1), st.floats(0.0499, 0.0501), st.sampled_from([0.05, np.nextafter(0.05, 0)])))
def test_a_probability_is_written_on_the_side_of_the_level_on_which_it_is(p):
    told = float(paired.p_in_words(p).removeprefix("p < ").removeprefix("p = "))
    assert (told < paired.LEVEL) == (p < paired.LEVEL)
    assert (told == paired.LEVEL) == (p == paired.LEVEL)
