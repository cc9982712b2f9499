"""The spread between starts of weights, and an interval that another start is within."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from neurotact.metrics.shares import wilson_interval
from neurotact.metrics.starts import Spread, interval, spread

SHARES = st.floats(0, 1)


@given(st.lists(st.lists(SHARES, min_size=1, max_size=5), max_size=5))
def test_the_spread_is_pooled_over_networks_and_knows_none_of_single_starts(groups):
    found, several = spread(groups), [group for group in groups if len(group) > 1]
    if not several:
        assert found is None
        return
    assert found is not None
    assert found.freedom == sum(map(len, several)) - len(several)
    squares = sum((len(group) - 1) * np.var(group, ddof=1) for group in several)
    assert found.deviation == pytest.approx(math.sqrt(squares / found.freedom), abs=1e-9)


def test_the_mean_of_a_group_is_no_spread():
    assert spread([[0.9, 0.9], [0.1, 0.1]]) == Spread(0.0, 2)


@given(SHARES, st.integers(1, 500), st.integers(1, 5), st.floats(0, 0.3), st.integers(1, 20))
def test_the_interval_of_starts_holds_that_of_trials_and_shrinks_with_what_is_known(share, n, starts, deviation, known):
    alone = wilson_interval(share, n)
    assert interval(share, n) == alone
    low, high = interval(share, n, starts, Spread(deviation, known))
    assert 0 <= low <= alone[0] + 1e-12
    assert alone[1] - 1e-12 <= high <= 1
    for better in (interval(share, n, starts + 1, Spread(deviation, known)),
                   interval(share, n, starts, Spread(deviation, known + 1))):  # fmt: skip
        assert low - 1e-12 <= better[0] <= better[1] <= high + 1e-12
    assert interval(share, n, starts, Spread(0.0, known)) == pytest.approx(alone)


@pytest.mark.parametrize(("n_networks", "n_starts"), [(1, 3), (3, 3), (6, 2)])
def test_another_start_on_other_trials_is_within_95_percent_of_the_intervals(n_networks, n_starts):
    rng, n_trials, deviation, inside, trials = np.random.default_rng(0), 200, 0.05, 0, 2000
    for _ in range(trials):
        truths = rng.normal(0.7, deviation, (n_networks, n_starts)).clip(0, 1)
        seen = rng.binomial(n_trials, truths) / n_trials
        low, high = interval(float(seen[0].mean()), n_trials, n_starts, spread(seen.tolist()))
        inside += low <= rng.normal(0.7, deviation) <= high
    assert inside / trials > 0.94
