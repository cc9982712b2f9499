import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from neurotact_parts.studies.compliance.centroid_kmeans import ClassCentroidKMeans
from sklearn.cluster import KMeans
from sklearn.utils import check_random_state
from sklearn.utils.estimator_checks import parametrize_with_checks

from neurotact.errors import InputError

OBJECTS = np.array(["can", "egg", "lemon", "sponge"])


def explorations(seed=0, spread=0.3, n_examples=80):
    rng = np.random.default_rng(seed)
    indices = np.arange(n_examples) % len(OBJECTS)
    return rng.uniform(0, 4, (len(OBJECTS), 2))[indices] + spread * rng.normal(size=(n_examples, 2)), OBJECTS[indices]


@parametrize_with_checks([ClassCentroidKMeans(), ClassCentroidKMeans(init="class-mean")])
def test_scikit_learns_checks(estimator, check):
    check(estimator)


@given(st.integers(0, 1000), st.sampled_from(["k-means++", "class-mean"]))
def test_one_centroid_a_class_and_lloyds_fixed_point(seed, init):
    X, y = explorations(seed)
    fitted = ClassCentroidKMeans(init, repetitions=3, random_state=seed).fit(X, y)
    assert fitted.centroids_.shape == (4, 2)
    nearest = ((X[:, None] - fitted.centroids_) ** 2).sum(axis=2).argmin(axis=1)
    for c, centroid in enumerate(fitted.centroids_):
        np.testing.assert_allclose(centroid, X[nearest == c].mean(axis=0), atol=1e-8)
    assert fitted.predict(X).tolist() == OBJECTS[nearest].tolist()
    np.testing.assert_allclose(fitted.inertia_, ((X - fitted.centroids_[nearest]) ** 2).sum())


@given(st.integers(0, 300))
def test_no_other_assignment_of_classes_is_right_more_often(seed):
    from itertools import permutations

    X, y = explorations(seed, spread=1.5, n_examples=40)
    fitted = ClassCentroidKMeans(repetitions=1, random_state=seed).fit(X, y)
    nearest = ((X[:, None] - fitted.centroids_) ** 2).sum(axis=2).argmin(axis=1)
    best = max((OBJECTS[list(order)][nearest] == y).sum() for order in permutations(range(4)))
    assert (fitted.predict(X) == y).sum() == best


def test_starts_at_the_class_means():
    X, y = explorations(spread=0.01)
    fitted = ClassCentroidKMeans("class-mean", max_iter=1).fit(X, y)
    np.testing.assert_allclose(fitted.centroids_, [X[y == name].mean(axis=0) for name in OBJECTS])


def test_inertia_chooses_among_the_repetitions():
    X, y = explorations(3, spread=0.8)
    rng = check_random_state(7)
    inertias = [KMeans(4, n_init=1, random_state=rng).fit(X).inertia_ for _ in range(12)]
    fitted = ClassCentroidKMeans(repetitions=12, random_state=7).fit(X, y)
    assert fitted.inertia_ == min(inertias)
    assert len(set(np.round(inertias, 6))) > 1


def test_a_validation_set_chooses_the_repetition_that_is_right_most_often_there():
    X, y = explorations(3, spread=0.8)
    new, truth = explorations(3, spread=0.8, n_examples=160)
    every = [ClassCentroidKMeans(repetitions=n, random_state=7).fit(X, y, (new, truth)) for n in range(1, 25)]
    scores = [fitted.score(new, truth) for fitted in every]
    assert scores == sorted(scores)
    assert scores[-1] > scores[0]
    assert scores[-1] >= ClassCentroidKMeans(repetitions=24, random_state=7).fit(X, y).score(new, truth)


def test_validation_labels_alone_decide_so_a_training_set_cannot_see_them():
    X, y = explorations(3, spread=0.8)
    shuffled = np.random.default_rng(0).permutation(y)
    fitted = ClassCentroidKMeans(repetitions=5, random_state=1).fit(X, y)
    assert fitted.inertia_ <= ClassCentroidKMeans(repetitions=5, random_state=1).fit(X, y, (X, shuffled)).inertia_


def test_fewer_distinct_vectors_than_classes_still_give_a_classifier():
    X = np.repeat([[0.0], [1.0]], 6, axis=0)
    y = np.array(["can"] * 6 + ["egg"] * 3 + ["lemon"] * 3)
    fitted = ClassCentroidKMeans(random_state=0).fit(X, y)
    assert fitted.score(X, y) == 0.75


def test_refusals():
    X, y = explorations()
    with pytest.raises(InputError, match="y: holds one class"):
        ClassCentroidKMeans().fit(X, np.zeros(len(X), int))
    with pytest.raises(InputError, match=r"did you mean 'k-means\+\+'"):
        ClassCentroidKMeans(init="kmeans++").fit(X, y)  # pyright: ignore[reportArgumentType]
    with pytest.raises(InputError, match="repetitions: must be a whole number >= 1"):
        ClassCentroidKMeans(repetitions=0).fit(X, y)
    with pytest.raises(InputError, match="class 'potato' was not among the training examples"):
        ClassCentroidKMeans().fit(X, y, (X, np.full(len(X), "potato")))
