"""Disjoint folds of patterns: by order, as in the touch-modality paper's public code, or by person."""

from typing import NamedTuple

import numpy as np
from sklearn.model_selection import StratifiedKFold

from neurotact.errors import InputError


class Fold(NamedTuple):
    """Sorted indices of patterns; validation may be empty."""

    train: np.ndarray
    validation: np.ndarray
    test: np.ndarray


def folds_in_order(labels: np.ndarray, n_folds: int = 5) -> list[Fold]:
    """Stratified folds of consecutive patterns, unshuffled; without validation patterns.

    Raises InputError when a class has fewer patterns than there are folds.

    >>> [fold.test.tolist() for fold in folds_in_order(np.array(["a", "a", "b", "b"]), 2)]
    [[0, 2], [1, 3]]
    """
    _, counts = np.unique(labels, return_counts=True)
    if counts.min() < n_folds:
        raise InputError(
            f"folds: a class has {counts.min()} pattern(s), fewer than {n_folds} folds; give more patterns"
        )
    splits = StratifiedKFold(n_folds, shuffle=False).split(np.zeros(len(labels)), labels)
    return [Fold(train, np.array([], np.int64), test) for train, test in splits]


def folds_by_person(persons: np.ndarray, n_folds: int = 5, validation: float = 0.2, seed: int = 0) -> list[Fold]:
    """Folds in which each person is on one side: people are assigned to test folds at random, and a share
    `validation` of the others to validation.

    Raises InputError when there are too few people.

    >>> fold = folds_by_person(np.repeat(np.arange(10), 2))[0]
    >>> len(fold.train), len(fold.validation), len(fold.test)
    (12, 4, 4)
    """
    people = np.unique(persons)
    n_validation = max(1, round(validation * (len(people) - -(-len(people) // n_folds))))
    if len(people) < n_folds or len(people) - -(-len(people) // n_folds) - n_validation < 1:
        raise InputError(
            f"folds: {len(people)} people are too few for {n_folds} folds with validation; give at least {n_folds + 1}"
        )
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(0,)))
    folds = []
    for tested in np.array_split(rng.permutation(people), n_folds):
        others = rng.permutation(np.setdiff1d(people, tested))
        validated = others[:n_validation]
        sides = (others[n_validation:], validated, tested)
        folds.append(Fold(*(np.flatnonzero(np.isin(persons, side)) for side in sides)))
    return folds
