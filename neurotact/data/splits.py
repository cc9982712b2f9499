"""Stratified splits of trials into training, validation and test."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
import pandas as pd
from pydantic import Field, model_validator
from sklearn.model_selection import train_test_split

from neurotact.data.recordings import LABEL
from neurotact.errors import InputError
from neurotact.spec import Spec


class SplitSpec(Spec):
    """How trials are divided (70/15/15 in the texture paper)."""

    validation: float = Field(default=0.15, gt=0, lt=1)
    test: float = Field(default=0.15, gt=0, lt=1)
    seed: int = Field(default=0, ge=0)

    @model_validator(mode="after")
    def _leaves_training_trials(self) -> "SplitSpec":
        if self.validation + self.test >= 1:
            raise ValueError("validation + test must be below 1, so that trials are left for training")
        return self


class Split(NamedTuple):
    """Sorted indices of trials; together they are all trials, and none stands in two."""

    train: np.ndarray
    validation: np.ndarray
    test: np.ndarray


def split_trials(labels: np.ndarray, spec: SplitSpec) -> Split:
    """Divide trials at random within each class. Windows follow their trial, so none leaks across.

    labels: a value a trial, `(trial,)`; pass class and condition joined to balance conditions too.
    Raises InputError when a class has too few trials to stand on all three sides.

    >>> split = split_trials(np.repeat([0, 1], 20), SplitSpec())
    >>> [len(part) for part in split]
    [28, 6, 6]
    """
    labels = np.asarray(labels)
    values, counts = np.unique(labels, return_counts=True)
    rarest = counts.argmin()
    too_few = InputError(
        f"split: class '{values[rarest]}' has {counts[rarest]} trial(s), too few to train, validate and test on; give "
        f"at least 3 trials per class (about {np.ceil(1 / min(spec.validation, spec.test)):.0f} for the asked shares)"
    )
    if counts[rarest] < 3:
        raise too_few
    n_trials = len(labels)
    n_test, n_validation = (max(len(values), round(n_trials * share)) for share in (spec.test, spec.validation))
    if n_test + n_validation + len(values) > n_trials:
        raise InputError(
            f"split: {n_trials} trials of {len(values)} classes are too few for the asked shares; add trials"
        )
    try:
        rest, test = train_test_split(np.arange(n_trials), test_size=n_test, stratify=labels, random_state=spec.seed)
        train, validation = train_test_split(
            rest, test_size=n_validation, stratify=labels[rest], random_state=spec.seed + 1
        )
    except ValueError as error:  # the first split left a single trial of a class to the second
        raise too_few from error
    if any(len(np.unique(labels[side])) < len(values) for side in (train, validation, test)):
        raise too_few
    return Split(*(np.sort(part) for part in (train, validation, test)))


def split_conditions(conditions: pd.DataFrame, stratify: Iterable[str], spec: SplitSpec) -> Split:
    """Split trials, balanced over the class and the `stratify` columns."""
    strata = conditions[LABEL].astype(str)
    for column in stratify:
        if column not in conditions:
            raise InputError(
                f"dataset.stratify: there is no condition '{column}'; known: {', '.join(conditions.columns)}"
            )
        strata = strata + " " + conditions[column].astype(str)
    return split_trials(strata.to_numpy(dtype=str), spec)
