"""Cross-validated accuracy, of random folds and of groups that are tested by the others."""

import numpy as np

from neurotact.metrics.linear import cross_validated_accuracy

GROUPS = np.arange(40) // 2 % 2
LABELS = np.arange(40) % 2


def test_what_holds_within_a_group_alone_is_worth_nothing_at_another():
    """A feature for each pair of group and class: random folds have seen all pairs, but none of a left-out group."""
    of_pairs = np.eye(4)[2 * GROUPS + LABELS]
    assert cross_validated_accuracy(of_pairs, LABELS) == 1.0
    assert cross_validated_accuracy(of_pairs, LABELS, GROUPS) == 0.5
    of_classes = np.eye(2)[LABELS]
    assert cross_validated_accuracy(of_classes, LABELS, GROUPS) == 1.0


def test_one_group_is_divided_at_random_and_groups_of_one_class_each_tell_nothing():
    noise = np.random.default_rng(0).normal(size=(40, 3))
    assert cross_validated_accuracy(noise, LABELS, np.zeros(40)) == cross_validated_accuracy(noise, LABELS)
    assert cross_validated_accuracy(noise, LABELS, LABELS) == 0.0
