"""Families of classifiers on a small task: what they choose, what they cost, and that nothing leaks."""

import numpy as np
import pytest
from levels import thinned
from neurotact_parts.opponents import scikit_learn
from neurotact_parts.studies.comparison import families
from neurotact_parts.studies.comparison import spiking as spiking_family
from neurotact_parts.studies.comparison.tasks import level_spread_rate, split_groups
from neurotact_parts.studies.materials import rls
from neurotact_parts.studies.task_data import TaskData
from neurotact_parts.studies.texture import baselines as texture_baselines
from neurotact_parts.studies.touch_modality import recurrent

from neurotact.baselines import opponent
from neurotact.baselines.opponent import Sides, accuracy, best_of
from neurotact.data.splits import Split
from neurotact.metrics import flops
from neurotact.networks.definition.specs import RSNNSpec


def tapped(n=60, seed=0, steps=200):
    """Two textures on two taxels at 1 kHz: slow and fast sines of random phase."""
    rng = np.random.default_rng(seed)
    fast = np.arange(n) % 2
    time_s = np.arange(steps) / 1000
    angle = 2 * np.pi * (np.where(fast, 40.0, 10.0)[:, None] * time_s + rng.random((n, 1)))
    x = np.sin(angle)[..., None] * [1.0, 0.6] + 0.05 * rng.standard_normal((n, steps, 2))
    labels = np.where(fast, "fine", "coarse")
    return TaskData(level_spread_rate(x), x.astype(np.float32), 1000.0, "mV", labels, np.arange(n))


@pytest.fixture(scope="module")
def task():
    return tapped()


@pytest.fixture(scope="module")
def split(task):
    return split_groups(task.labels, task.groups, 0)


@pytest.mark.parametrize("name", ["ELM", "SLFN", "SVM", "RLS", "k-means", "kNN", "extra trees"])
def test_a_family_on_features_solves_an_easy_task_and_counts_its_layers(task, split, name):
    sides = families.feature_sides(task, split)
    best = best_of(families.opponent_of(name), sides, 0)
    assert accuracy(best, sides.test, sides.y_test) == 1.0
    assert flops.cost(*best.layers).energy_estimate_nJ > 0


@pytest.mark.parametrize("name", ["LSTM", "GRU"])
def test_a_recurrent_family_runs_and_counts_its_parameters(task, split, name, monkeypatch):
    monkeypatch.setattr(recurrent, "TRAINING", {"epochs": 2, "batch": 16, "learning_rate": 0.01})
    sides = families.sequence_sides(task, split)
    assert sides.train.shape[1:] == (50, 2)
    for candidate in families.opponent_of(name).candidates(sides, 0):
        assert flops.cost(*candidate.layers).parameters == candidate.fitted.n_parameters_


@pytest.mark.parametrize(("name", "n_steps"), [("GRU", 50), ("pooled GRU", 10), ("MiniRocket", 200)])
def test_a_family_on_sequences_has_steps_of_its_own(task, split, name, n_steps):
    assert families.sequence_sides(task, split, name).train.shape[1:] == (n_steps, 2)


@thinned("name", ["MiniRocket", "pooled GRU"])
def test_a_strong_family_solves_an_easy_task(task, split, name):
    sides = families.sequence_sides(task, split, name)
    best = best_of(families.opponent_of(name), sides, 0)
    assert accuracy(best, sides.test, sides.y_test) == 1.0


def test_standardisation_sees_training_examples_alone(task, split):
    for sides_of, field in ((families.feature_sides, "features"), (families.sequence_sides, "sequences")):
        changed = getattr(task, field).copy()
        changed[split.test] = 1e3
        before, after = sides_of(task, split), sides_of(task._replace(**{field: changed}), split)
        np.testing.assert_array_equal(before.train, after.train)
        np.testing.assert_array_equal(before.validation, after.validation)
        axes = tuple(range(before.train.ndim - 1))
        np.testing.assert_allclose(before.train.mean(axis=axes), 0, atol=1e-6)
        np.testing.assert_allclose(before.train.std(axis=axes), 1, atol=1e-6)


@pytest.mark.parametrize("name", ["ELM", "SVM", "RLS", "kNN", "k-means"])
def test_settings_do_not_depend_on_test_examples(task, split, name):
    sides = families.feature_sides(task, split)
    spoiled = sides._replace(test=sides.test * 0, y_test=sides.y_test[::-1])
    family = families.opponent_of(name)
    assert best_of(family, sides, 0).settings == best_of(family, spoiled, 0).settings


def test_of_equals_the_first_is_taken(task, split):
    sides = families.feature_sides(task, split)
    assert best_of(opponent.load("kNN"), sides, 0).settings == "k 1"


def test_random_labels_are_at_chance(task):
    rng = np.random.default_rng(0)
    scores = []
    for seed in range(10):
        shuffled = task._replace(
            features=rng.normal(size=(300, 4)),
            labels=rng.permutation(np.repeat(["a", "b"], 150)),
            groups=np.arange(300),
        )
        sides = families.feature_sides(shuffled, split_groups(shuffled.labels, shuffled.groups, seed))
        best = best_of(rls.OPPONENT, sides, seed)
        scores.append(accuracy(best, sides.test, sides.y_test))
    assert np.mean(scores) == pytest.approx(0.5, abs=4 * 0.5 / np.sqrt(10 * 45))


def test_costs_before_the_classifier(task, split):
    sides = families.sequence_sides(task, split)
    spent = flops.cost(*families.averaging(200, 50, 2), *families.slowing(50, sides))
    assert (spent.acs, spent.other_flops, spent.macs) == (400, 100, 100)
    assert families.averaging(50, 50, 2) == ()


@pytest.fixture
def short_training(monkeypatch):
    short = RSNNSpec.model_validate({"recipe": "default", "hidden": 12, "step_ms": 5.0, "training": {"epochs": 8}})
    monkeypatch.setattr(spiking_family, "TRIED", (short,))


@pytest.mark.usefixtures("short_training")
def test_the_spiking_family_decides_early_too(task, split):
    full, early = spiking_family.decide(task, split, 0)
    assert (full.name, early.name) == ("SNN", "SNN, early exit")
    assert full.cost.signal_ms == 200.0
    assert early.cost.signal_ms <= 200.0
    assert early.accuracy_validation >= full.accuracy_validation - spiking_family.EXIT_TOLERANCE - 1e-9
    # Two taxels, 200 steps: two MACs a step of both populations, one for standardisation.
    assert full.encoder.macs == (4 + 1) * 2 * 200
    assert full.encoder.parameters == 2 + 2 * 2
    assert full.network.macs == 2 * 12 * 40  # 40 steps of 5 ms; an integrator has no membranes
    assert full.network.acs == full.network.sops
    assert early.settings == f"{full.settings}; early exit not used: whole windows"  # few examples bound no loss
    assert early[2:] == full[2:]
    again = spiking_family.decide(task, split, 0)[0]
    assert again == full


def test_afferents_are_calibrated_on_training_examples_alone(task, split):
    changed = task.sequences.copy()
    changed[split.test] *= 50
    before = spiking_family.encode(task, split.train)
    after = spiking_family.encode(task._replace(sequences=changed), split.train)
    assert before.encoder == after.encoder


def test_one_machine_costs_the_same_in_every_study(monkeypatch):
    monkeypatch.setattr(scikit_learn, "SVM_CS", (10.0,))
    monkeypatch.setattr(scikit_learn, "SVM_GAMMAS", (1.0,))
    monkeypatch.setattr(texture_baselines, "SVM_C", (10.0,))
    monkeypatch.setattr(texture_baselines, "SVM_GAMMA", (1.0,))
    rng = np.random.default_rng(0)
    labels = np.arange(120) % 4
    features = rng.normal(size=(120, 3)) + labels[:, None]
    split = Split(np.arange(80), np.arange(80, 100), np.arange(100, 120))
    sides = Sides(*(features[side] for side in split), *(labels[side] for side in split))
    (candidate,) = opponent.load("SVM").candidates(sides, 0)
    *_, layers = texture_baselines.svm(features, labels, split, 0)
    assert flops.cost(*candidate.layers) == flops.cost(*layers)
