"""Folds: every pattern is tested once, classes are balanced in order, nobody stands on two sides."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from neurotact_parts.studies.touch_modality.folds import folds_by_person, folds_in_order
from sklearn.model_selection import StratifiedKFold

from neurotact.errors import InputError


def is_a_partition(folds, n_patterns):
    tested = np.sort(np.concatenate([fold.test for fold in folds]))
    np.testing.assert_array_equal(tested, np.arange(n_patterns))
    for fold in folds:
        sides = np.concatenate(fold)
        np.testing.assert_array_equal(np.sort(sides), np.arange(n_patterns))


@given(counts=st.lists(st.integers(5, 30), min_size=2, max_size=4))
def test_folds_in_order_are_those_of_the_public_code(counts):
    labels = np.repeat(np.arange(len(counts)), counts)
    folds = folds_in_order(labels)
    is_a_partition(folds, len(labels))
    theirs = StratifiedKFold(n_splits=5, shuffle=False, random_state=None).split(np.zeros((len(labels), 1)), labels)
    for fold, (train, test) in zip(folds, theirs, strict=True):
        np.testing.assert_array_equal(fold.train, train)
        np.testing.assert_array_equal(fold.test, test)
        assert len(fold.validation) == 0


@given(counts=st.lists(st.integers(1, 12), min_size=6, max_size=30), seed=st.integers(0, 5))
def test_nobody_stands_on_two_sides(counts, seed):
    persons = np.repeat(np.arange(len(counts)) * 7, counts)
    folds = folds_by_person(persons, seed=seed)
    is_a_partition(folds, len(persons))
    for fold in folds:
        sides = [set(persons[side].tolist()) for side in fold]
        assert all(sides)
        assert sum(map(len, sides)) == len(set.union(*sides))
    again = folds_by_person(persons, seed=seed)
    assert all((a == b).all() for one, two in zip(folds, again, strict=True) for a, b in zip(one, two, strict=True))


def test_seventy_people_give_fourteen_to_each_fold():
    folds = folds_by_person(np.arange(70))
    assert [tuple(map(len, fold)) for fold in folds] == [(45, 11, 14)] * 5


def test_too_few_are_refused():
    with pytest.raises(InputError, match=r"has 4 pattern\(s\), fewer than 5 folds"):
        folds_in_order(np.repeat([0, 1], 4))
    with pytest.raises(InputError, match="4 people are too few for 5 folds"):
        folds_by_person(np.arange(4))


def test_a_seed_deals_the_people_anew_and_gives_the_same_folds_again():
    dealt = [[fold.test.tolist() for fold in folds_by_person(np.arange(20), seed=seed)] for seed in (0, 1, 0)]
    assert dealt[0] == dealt[2]
    assert dealt[0] != dealt[1]
