import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy import stats

from neurotact.errors import InputError
from neurotact.metrics.paired import sign_test
from neurotact.metrics.resampled import (
    DIFFERENCES,
    compare_over_splits,
    effective_trials,
    least_difference_over_splits,
    resampled_error,
    resampled_interval,
    resampled_p,
)
from neurotact.metrics.shares import standard_error, wilson_interval


def test_by_hand():
    # s = 0.1, J = 4, test/train = 1/4: s sqrt(1/4 + 1/4) = 0.0707; t of 3 degrees at 97.5 % is 3.182.
    found = resampled_interval([0.6, 0.8, 0.7 - np.sqrt(0.005), 0.7 + np.sqrt(0.005)], 40, 10)
    assert found.mean == pytest.approx(0.7)
    assert found.high - found.mean == pytest.approx(3.1824 * 0.1 * np.sqrt(0.5), rel=1e-4)
    assert found.mean - found.low == pytest.approx(found.high - found.mean)


def test_with_next_to_no_test_examples_it_is_the_t_interval():
    values = np.random.default_rng(0).random(10)
    found = resampled_interval(values, 10**12, 1)
    low, high = stats.t.interval(0.95, 9, values.mean(), stats.sem(values))
    assert found[1:] == pytest.approx((low, high))


def test_it_covers_the_truth_where_splits_share_their_examples():
    """A fixed guess is tested on random tenths of one sample: its true accuracy lies in most intervals."""
    rng = np.random.default_rng(1)
    covered = naive = 0
    for _ in range(300):
        right = rng.random(100) < 0.7
        values = [right[rng.permutation(100)[:30]].mean() for _ in range(10)]
        found = resampled_interval(values, 70, 30)
        covered += found.low <= 0.7 <= found.high
        low, high = stats.t.interval(0.95, 9, np.mean(values), max(stats.sem(values), 1e-9))
        naive += low <= 0.7 <= high
    assert covered / 300 > 0.9
    assert naive / 300 < 0.8


@given(st.lists(st.floats(0, 1), min_size=1, max_size=6))
def test_the_ends_are_what_a_mean_can_be_and_two_splits_have_none(shares):
    found = resampled_interval(shares, 70, 30)
    wide = resampled_interval(shares, 70, 30, within=(-np.inf, np.inf))
    assert found.mean == wide.mean == pytest.approx(np.mean(shares))
    if len(shares) < 3:
        assert np.isnan([found.low, found.high]).all()
    elif np.ptp(shares) < 1e-12:
        assert 0 <= found.low <= found.mean <= found.high <= 1
        assert found.high - found.low > 0.01
    else:
        assert (found.low, found.high) == (max(0.0, wide.low), min(1.0, wide.high))


@pytest.mark.parametrize("share", [0.0, 0.6, 1.0])
@pytest.mark.parametrize("n_splits", [3, 5, 10])
def test_equal_shares_are_no_certainty(share, n_splits):
    """The interval is not tighter than that of all test trials, as if no split shared one, nor by further windows."""
    found = resampled_interval([share] * n_splits, 70, 15)
    n_trials = round(15 / (1 / n_splits + 15 / 70))
    assert n_trials <= min(15 * n_splits, 70)
    assert found[1:] == pytest.approx(wilson_interval(share, n_trials))
    low, high = wilson_interval(share, 15 * n_splits)
    assert found.high - found.low >= high - low > 0.01
    assert resampled_interval([share] * n_splits, 140, 30, trials=15) == found
    nearly = [np.nextafter(share, 0.5), *[share] * (n_splits - 1)]
    assert resampled_interval(nearly, 70, 15)[1:] == pytest.approx(found[1:])


def test_a_difference_may_be_negative():
    found = resampled_interval([0.9, 0.0, -0.9], 70, 30, within=DIFFERENCES)
    assert (found.low, found.high) == (-1.0, 1.0)
    assert -1.0 < resampled_interval([-0.1, -0.2, -0.15], 70, 30, within=DIFFERENCES).low < -0.15


SPLITS = st.lists(st.integers(-30, 30).map(lambda n: n / 30), min_size=3, max_size=12)
SIZES = st.tuples(st.integers(10, 400), st.integers(1, 200))


@given(SPLITS, SIZES)
def test_p_is_below_the_level_exactly_where_the_interval_omits_zero(differences, sizes):
    p, found = resampled_p(differences, *sizes), resampled_interval(differences, *sizes, within=DIFFERENCES)
    assume(abs(p - 0.05) > 1e-9)
    assert (p < 0.05) == (found.low > 0 or found.high < 0)
    assert found.high > found.low
    assert resampled_p([-value for value in differences], *sizes) == pytest.approx(p)


@given(st.integers(-30, 30), st.integers(3, 12), SIZES, st.none() | st.integers(1, 50))
def test_equal_differences_are_no_certainty(n_more, n_splits, sizes, trials):
    """Then p is that of the sign test on the trials that differ, of as many as the splits are worth."""
    equal = [n_more / 30] * n_splits
    n = (trials or sizes[1]) / (1 / n_splits + sizes[1] / sizes[0])
    assert effective_trials(n_splits, *sizes, trials) == pytest.approx(n)
    n_apart = abs(n_more) / 30 * n
    p = resampled_p(equal, *sizes, trials)
    assert sign_test(math.ceil(n_apart), 0) <= p * 1.0001
    assert p <= sign_test(math.floor(n_apart), 0) * 1.0001
    found = resampled_interval(equal, *sizes, within=DIFFERENCES, trials=trials)
    assert found.mean - found.low >= min(1.0, 2 / n) * 0.9999 or found.low == -1.0


def test_one_trial_more_in_each_of_three_splits_tells_nothing():
    assert resampled_p([1 / 30] * 3, 139, 30) > 0.5
    assert resampled_p([0.0] * 3, 139, 30) == 1.0
    zero = resampled_interval([0.0] * 3, 139, 30, within=DIFFERENCES)
    assert zero.high == -zero.low == pytest.approx(1.96 * 2.05**0.5 / 54.6, rel=1e-2)


@given(SPLITS, SIZES, st.integers(0, 11), st.floats(-1e-6, 1e-6))
def test_almost_equal_differences_are_almost_as_equal_ones(differences, sizes, at, more):
    """A spread that is next to nothing tells next to nothing more: p and interval do not jump."""
    equal = [differences[0]] * len(differences)
    nearly = [*equal]
    nearly[at % len(equal)] += more
    assert resampled_p(nearly, *sizes) == pytest.approx(resampled_p(equal, *sizes), abs=1e-3)
    ends = (resampled_interval(some, *sizes, within=DIFFERENCES)[1:] for some in (equal, nearly))
    assert next(ends) == pytest.approx(next(ends), abs=1e-4)


@given(SPLITS, SIZES, st.none() | st.integers(1, 50))
def test_a_comparison_has_the_p_of_its_differences_and_the_trials_that_they_are_worth(differences, sizes, trials):
    found = compare_over_splits(differences, *sizes, trials)
    assert found.difference == pytest.approx(np.mean(differences))
    assert found.p == resampled_p(differences, *sizes, trials)
    assert found.n == round(effective_trials(len(differences), *sizes, trials))
    few, all_ = (compare_over_splits([0.2] * 4, 70, 15, trials) for trials in (5, None))
    assert few.p == resampled_p([0.2] * 4, 70, 15, 5) > all_.p


@given(st.lists(st.integers(0, 30).map(lambda n: n / 30), min_size=1, max_size=12), SIZES)
def test_an_error_is_that_of_the_interval_and_at_least_that_of_trials(shares, sizes):
    error = resampled_error(shares, *sizes)
    if len(shares) < 3:
        assert math.isnan(error)
        return
    of_spread = np.std(shares, ddof=1) * math.sqrt(1 / len(shares) + sizes[1] / sizes[0])
    n = max(1, round(effective_trials(len(shares), *sizes)))
    assert error == pytest.approx(max(of_spread, standard_error(float(np.mean(shares)), n)))


@pytest.mark.parametrize(("values", "sizes"), [([], (1, 1)), ([[0.5, 0.6]], (1, 1)), ([0.5, 0.6, 0.7], (0, 1))])
def test_what_cannot_be_is_refused(values, sizes):
    for test in (resampled_interval, resampled_p):
        with pytest.raises(InputError):
            test(values, *sizes)


def test_two_equal_differences_are_no_evidence():
    with pytest.raises(InputError, match="at least 3 splits"):
        resampled_p([0.1, 0.1], 70, 30)


@given(st.integers(3, 12), SIZES, st.integers(1, 20), st.none() | st.integers(1, 50))
def test_the_least_difference_over_splits_is_clear_where_all_are_equal_and_a_smaller_one_never(
    n_splits, sizes, opponents, trials
):
    least = least_difference_over_splits(n_splits, *sizes, opponents, trials)
    assert least < 1 or least == math.inf
    more = min(1.0, least * 1.001)
    assert (opponents * resampled_p([more] * n_splits, *sizes, trials) < 0.05) == (least < 1)
    assert opponents * resampled_p([min(1.0, least) * 0.999] * n_splits, *sizes, trials) > 0.05
    assert least_difference_over_splits(2, *sizes, opponents, trials) == math.inf
