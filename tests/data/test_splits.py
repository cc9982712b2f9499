"""Splits: every trial on one side, every class on every side, the same for the same seed."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from neurotact.data.splits import SplitSpec, split_trials
from neurotact.data.windows import WindowSpec, cut
from neurotact.errors import InputError
from neurotact.spec import build

SPECS = st.builds(
    SplitSpec, validation=st.floats(0.05, 0.45), test=st.floats(0.05, 0.45), seed=st.integers(0, 2**31)
)  # fmt: skip
ANY_LABELS = st.lists(st.sampled_from(["felt", "silk", "jute", "lace 3 N"]), min_size=1, max_size=80).map(np.array)
BALANCED = st.builds(
    lambda n_classes, each, random: np.array(random.sample([*range(n_classes)] * each, n_classes * each)),
    st.integers(1, 6), st.integers(7, 40), st.randoms(use_true_random=False),
)  # fmt: skip


def attempt(labels, spec):
    """The split, or None and why there is none."""
    try:
        return split_trials(labels, spec), ""
    except InputError as error:
        return None, str(error)


@given(ANY_LABELS, SPECS)
def test_a_split_has_every_class_on_every_side_or_names_the_class_that_is_too_small(labels, spec):
    split, refusal = attempt(labels, spec)
    if split is None:
        assert "\n" not in refusal
        assert "too few" in refusal
        return
    for side in split:
        assert set(labels[side]) == set(labels)
        assert (np.diff(side) > 0).all()
    assert sorted(np.concatenate(split)) == list(range(len(labels)))


@given(BALANCED, SPECS)
def test_the_shares_hold_in_each_class_to_one_trial(labels, spec):
    split, _ = attempt(labels, spec)
    assume(split is not None)  # shares that leave too few trials for training are refused
    n_classes, each = len(set(labels)), np.bincount(labels)[0]
    for side, share in ((split.validation, spec.validation), (split.test, spec.test)):
        assert len(side) == max(n_classes, round(share * len(labels)))
        assert np.abs(np.bincount(labels[side]) - max(1.0, share * each)).max() <= 1.0 + 1e-9


@given(BALANCED, SPECS)
def test_the_same_seed_gives_the_same_split(labels, spec):
    assume(attempt(labels, spec)[0] is not None)  # shares that leave too few trials for training are refused
    for one, other in zip(split_trials(labels, spec), split_trials(labels, spec), strict=True):
        np.testing.assert_array_equal(one, other)


def test_another_seed_gives_another_split():
    labels = np.repeat([0, 1], 30)
    assert len({tuple(split_trials(labels, SplitSpec(seed=seed)).test) for seed in range(20)}) == 20


@given(BALANCED, SPECS, st.integers(1, 4))
def test_the_windows_of_a_trial_are_never_on_two_sides(labels, spec, n_windows):
    windows = cut(np.full(len(labels), n_windows * 10), 1000.0, WindowSpec(length_ms=10))
    sides = [set(np.flatnonzero(np.isin(windows.trial, side))) for side in split_trials(labels, spec)]
    assert sum(map(len, sides)) == len(set.union(*sides)) == len(windows)
    trials = [set(windows.trial[list(side)]) for side in sides]
    assert sum(map(len, trials)) == len(set.union(*trials)) == len(labels)


@pytest.mark.parametrize("counts", [(2, 20), (1, 1), (1, 0), (3, 300), (2, 2)])
def test_a_class_with_too_few_trials_is_named(counts):
    labels = np.repeat(["felt", "silk"], counts)
    with pytest.raises(InputError, match=rf"split: class 'felt' has {counts[0]} trial\(s\), too few"):
        split_trials(labels, SplitSpec())


def test_three_trials_a_class_are_enough():
    assert [len(side) for side in split_trials(np.repeat([0, 1], 3), SplitSpec())] == [2, 2, 2]


def test_more_shares_than_trials_are_refused():
    with pytest.raises(InputError, match="too few for the asked shares"):
        split_trials(np.repeat([0, 1], 3), SplitSpec(validation=0.49, test=0.49))


@pytest.mark.parametrize(
    "table", [{"validation": 0}, {"test": 1}, {"test": -0.1}, {"seed": -1}, {"validation": 0.5, "test": 0.5}]
)
def test_shares_that_leave_nothing_are_no_spec(table):
    with pytest.raises(InputError, match=r"study\.toml"):
        build(SplitSpec, table, "study.toml")
