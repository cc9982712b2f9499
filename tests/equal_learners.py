"""Learners that are equally good in the population: whatever is said of them is chance, and hardly ever a difference.

Each learner has features of its own, equally informative, and takes the class of the nearest mean. Splits draw from one
set, so that they share trials. What prints a verdict is held to it: in at most 5 % of such studies is there one.
"""

from collections.abc import Callable, Iterator
from typing import Literal, NamedTuple

import numpy as np
import pandas as pd
from scipy.stats import binom

from neurotact.studies.way import View

Kind = Literal["random", "folds", "groups"]
CLASSES, OWN = 5, 4
VIEW = View(
    ("chain", "protocol"),
    {"accuracy_test": "accuracy (%)", "energy_estimate_nJ": "energy (nJ)"},
    "energy_estimate_nJ",
    "accuracy_test",
    apart=("protocol",),
    spiking=("chain", ("RSNN",)),
    splits=("split",),
)


class Split(NamedTuple):
    """The trials on the sides of a split, and which of all trials each learner has right, `(learner, trial)`."""

    train: np.ndarray
    validation: np.ndarray
    test: np.ndarray
    right: np.ndarray

    def shares(self, side: np.ndarray) -> np.ndarray:
        """The accuracy of each learner, `(learner,)`."""
        return self.right[:, side].mean(axis=1)


def study(
    rng: np.random.Generator, n: int, learners: int, splits: int, kind: Kind = "random", apart: float = 2.2,
    best: float = 0.0,
) -> list[Split]:  # fmt: skip
    """Learners trained on every split of a set of `n` trials.

    kind: 70/15/15 at random; folds that test each trial once; or so many groups, which shift the features of each
    learner by chance, left out in turn. apart: the distance of the classes. best: of how much more the first learner's.
    """
    y, group = np.arange(n) % CLASSES, rng.integers(splits, size=n)
    x = rng.normal(size=(n, learners, OWN))
    if kind == "groups":
        x += 0.5 * rng.normal(size=(splits, learners, OWN))[group]
    distance = apart + best * (np.arange(learners) == 0)
    x[:, :, 0] += np.outer(y % 3, distance)
    x[:, :, 1] += np.outer(y // 3, distance)
    found = []
    for train, validation, test in _sides(rng, n, splits, kind, group):
        members = np.equal.outer(y[train], np.arange(CLASSES))
        means = np.tensordot(members / members.sum(axis=0), x[train], (0, 0))  # (class, learner, feature)
        nearest = ((x[:, None] - means[None]) ** 2).sum(axis=3).argmin(axis=1)
        found.append(Split(train, validation, test, y == nearest.T))
    return found


def _sides(
    rng: np.random.Generator, n: int, splits: int, kind: Kind, group: np.ndarray
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    order, n_held = rng.permutation(n), round(0.15 * n)
    for at in range(splits):
        if kind == "random":
            order = rng.permutation(n)
            test, rest = order[:n_held], order[n_held:]
        else:
            mine = group[order] == at if kind == "groups" else np.arange(n) % splits == at
            test, rest = order[mine], order[~mine]
        yield rest[n_held:], rest[:n_held], test


def rows(found: list[Split]) -> pd.DataFrame:
    """Rows as a protocol leaves them; the first learner spikes."""
    return pd.DataFrame([
        {"chain": "RSNN" if learner == 0 else f"c{learner}", "protocol": "by trial", "split": number,
         "accuracy_test": tested, "accuracy_validation": held, "energy_estimate_nJ": 10.0,
         "n_train": len(one.train), "n_test": len(one.test), "n_validation": len(one.validation)}
        for number, one in enumerate(found)
        for learner, (tested, held) in enumerate(zip(one.shares(one.test), one.shares(one.validation), strict=True))
    ])  # fmt: skip


def claims(verdict: Callable[[np.random.Generator], str], studies: int, seed: int = 8) -> int:
    """In how many of so many studies a verdict says better or worse."""
    rng = np.random.default_rng(seed)
    return sum(verdict(rng) in ("better", "worse") for _ in range(studies))


def most(studies: int) -> int:
    """The most claims that a test at 5 % makes in so many studies, but for one of a thousand such counts."""
    return int(binom.ppf(0.999, studies, 0.05))
