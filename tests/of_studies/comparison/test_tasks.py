"""Tasks as features and as sequences, and splits that keep groups whole."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from neurotact_parts.studies.comparison.tasks import (
    FRONT_ENDS,
    OWN,
    FabricsTask,
    GratingsTask,
    LevelSpreadRate,
    at_most,
    fabrics_task,
    gratings_task,
    level_spread_rate,
    slowed,
    source_of,
    split_groups,
)
from neurotact_parts.studies.task_data import TaskData
from neurotact_parts.studies.texture.simulator import GratingsSpec
from neurotact_parts.studies.touch_modality.datasets import TOUCH_SAMPLES

from neurotact.errors import InputError
from neurotact.metrics.flops import cost
from neurotact.metrics.signal_flops import Averaging, StandardisedSteps
from neurotact.spec import build


def made_task(n=60, steps=30, rate_Hz=1000.0, per_group=3):
    rng = np.random.default_rng(0)
    sequences = rng.normal(size=(n, steps, 2)).astype(np.float32)
    labels = np.repeat(["a", "b"], n // 2)
    return TaskData(level_spread_rate(sequences), sequences, rate_Hz, "mV", labels, np.arange(n) // per_group)


def test_gratings_task():
    spec = GratingsTask(simulation=GratingsSpec(trials=1, forces_N=(12.0,)))
    task = gratings_task(spec)
    assert task.sequences.shape == (16, 1000, 8)
    assert task.features.shape == (16, 24)
    np.testing.assert_allclose(task.features[:, :8], task.sequences.mean(axis=1), rtol=1e-5, atol=1e-5)
    assert len(set(task.labels.tolist())) == 8
    assert sorted(set(task.groups.tolist())) == list(range(16))
    assert source_of("gratings").front_end(spec, task).features[1].cost() == LevelSpreadRate(1000, 8).cost()


def test_a_window_that_no_trial_holds_is_refused():
    spec = GratingsTask(simulation=GratingsSpec(trials=1, forces_N=(12.0,), duration_s=0.5), length_ms=400)
    with pytest.raises(InputError, match="shorten the window"):
        gratings_task(spec)


@pytest.mark.slow
def test_fabrics_task(data_folder):
    task = fabrics_task(FabricsTask(path=str(data_folder / "fabricslide" / "fabric")))
    assert task.sequences.shape == (644, 71, 16)
    assert len(set(task.labels.tolist())) == 7


def test_own_tasks_and_protocols_have_sources():
    assert {"gratings", "fabrics"} == set(OWN)
    for name in FRONT_ENDS:
        assert source_of(name).front_end is FRONT_ENDS[name]
    assert source_of("compliance").data.__name__ == "ComplianceSpec"
    with pytest.raises(InputError, match="is not a task"):
        source_of("materials")


@given(rate_Hz=st.sampled_from([200.0, 1000.0, 2000.0, 3000.0, 2500.0]), steps=st.integers(6, 40))
def test_slowed_sequences_are_means_of_whole_samples(rate_Hz, steps):
    task = made_task(6, steps, rate_Hz)
    slow = slowed(task)
    factor = round(rate_Hz / slow.sampling_rate_Hz)
    assert slow.sampling_rate_Hz <= 1000.0
    assert factor == max(1, int(np.ceil(rate_Hz / 1000)))
    for step in range(slow.sequences.shape[1]):
        piece = task.sequences[:, step * factor : (step + 1) * factor].mean(axis=1)
        np.testing.assert_allclose(slow.sequences[:, step], piece, atol=1e-6)


def test_fewer_examples_keep_whole_groups():
    few = at_most(made_task(), 20)
    assert len(few.labels) == 18
    assert all((few.groups == group).sum() == 3 for group in np.unique(few.groups))
    np.testing.assert_array_equal(few.features, at_most(made_task(), 20).features)
    assert at_most(made_task(), 60).labels.size == 60


@given(seed=st.integers(0, 1000))
def test_groups_stay_on_one_side_and_every_example_has_one(seed):
    task = made_task()
    split = split_groups(task.labels, task.groups, seed)
    assert sorted(np.concatenate(split)) == list(range(60))
    sides = [set(task.groups[side].tolist()) for side in split]
    assert sum(map(len, sides)) == len(set.union(*sides)) == 20


@given(seed=st.integers(0, 1000))
def test_people_of_many_classes_stay_on_one_side(seed):
    labels, people = np.tile(["brush", "roll", "slide"], 20), np.repeat(np.arange(20), 3)
    split = split_groups(labels, people, seed)
    sides = [set(people[side].tolist()) for side in split]
    assert [len(side) for side in sides] == [14, 3, 3]
    assert len(set.union(*sides)) == 20


def test_a_class_that_is_missing_on_a_side_is_refused():
    labels = np.array([*["a"] * 19, "b"])
    with pytest.raises(InputError, match="leaves a class out"):
        split_groups(np.tile(labels, 1), np.array([*np.arange(19) // 2, 0]), 0)


def test_costs_of_reduction_by_hand():
    assert Averaging(100, 10, 3).cost().acs == 300
    assert Averaging(100, 10, 3).cost().multiplications == Averaging(100, 10, 3).cost().other_flops == 30
    assert StandardisedSteps(10, 3).cost().macs == 30
    assert StandardisedSteps(10, 3).cost().parameters == 6
    spent = LevelSpreadRate(100, 2).cost()
    assert (spent.macs, spent.acs, spent.other_flops) == (202, 600, 214)


SMALL = {
    "stiffness": {"simulation": {"placements": 2, "grasps": 2}},
    "touch_modality": {"simulation": {"people": 2}},
    "compliance": {"trials": 1},
}


def test_the_sequences_of_touches_are_smoothed_at_the_rate_of_the_skin_and_then_resampled():
    source = source_of("touch_modality")
    spec = build(source.data, SMALL["touch_modality"], source="here")
    task = source.make(spec)
    _, steps, channels = task.sequences.shape
    samples = TOUCH_SAMPLES * channels
    spent = cost(*source.front_end(spec, task).sequences)
    assert spent.multiplications == samples
    assert spent.macs == samples + steps * channels
    assert spent.acs == samples + steps * channels + steps  # without the first sample; differences; the place


@pytest.mark.parametrize("name", list(SMALL))
def test_a_protocol_makes_its_task_and_its_front_end_counts_it(name):
    source = source_of(name)
    spec = build(source.data, SMALL[name], source="here")
    task = source.make(spec)
    assert len(task.features) == len(task.sequences) == len(task.labels) == len(task.groups)
    features, sequences = (cost(*layers) for layers in source.front_end(spec, task))
    assert features.macs > 0
    assert features.energy_estimate_nJ >= sequences.energy_estimate_nJ > 0
