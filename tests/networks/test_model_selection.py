"""Training with varied copies: they are trained on with their trial, and never tested."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

import neurotact as nt
from neurotact.data.augmentation import CANDIDATES, AugmentationSpec
from neurotact.data.recordings import Recordings
from neurotact.data.splits import SplitSpec
from neurotact.data.windows import WindowSpec
from neurotact.encoders import specs
from neurotact.encoders.encoding import encode_recordings
from neurotact.errors import InputError
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.networks.training import model_selection, tasks
from neurotact.networks.training.epochs import Checkpoint, Epoch, best_of
from neurotact.networks.training.tasks import Task
from neurotact.spec import resolve

SPEEDS = (1.0, 1.6, 2.5)


@pytest.fixture(scope="module")
def trains():
    """Slides over two gratings at three speeds, and their copies at others."""
    rng, rows, signals = np.random.default_rng(0), [], []
    for label, pitch in (("coarse", 4.0), ("fine", 12.0)):
        for speed in SPEEDS:
            for _ in range(8):
                phase, time_s = rng.uniform(0, 6), np.arange(600) / 1000
                signals.append(
                    5 * np.sin(2 * np.pi * pitch * speed * time_s + phase)[:, None] + rng.normal(0, 0.2, (600, 2))
                )
                rows.append({"label": label, "speed": speed})
    recordings = Recordings(signals, 1000.0, "mV", pd.DataFrame(rows))
    encoder = specs.resolve("sa1-ra1-lif", {"sa1.t_ref_ms": 5, "ra1.t_ref_ms": 5})
    return encode_recordings(recordings, encoder, augmentation=AugmentationSpec(copies=2))


def task(**keys):
    split = SplitSpec(test_where={"speed": 2.5})
    return Task(window=WindowSpec(length_ms=400, per_trial=1), split=split, **keys)


def test_copies_of_training_trials_alone_are_trained_on(trains):
    plain, varied = (tasks.sides_of(trains, task(augmentation=kind)) for kind in ("none", "time"))
    n = len(plain.train.labels)
    assert len(varied.train.labels) == 3 * n
    np.testing.assert_array_equal(varied.train.spikes[:n], plain.train.spikes)
    rows = trains.variations.rows(tasks.trials_of(trains, task()).train, "time")
    wanted, _ = tasks.examples_of(trains.variations.trains, rows, task())
    np.testing.assert_array_equal(varied.train.spikes[n:], wanted.spikes)
    assert (varied.train.labels[n:] == wanted.labels).all()
    for side in ("validation", "test"):
        np.testing.assert_array_equal(getattr(varied, side).spikes, getattr(plain, side).spikes)


def test_validation_varies_where_it_cannot_leave_out_a_condition(trains):
    plain = tasks.sides_of(trains, task(augmentation="time"))
    varied = tasks.sides_of(trains, task(augmentation="time", varied_validation=True))
    assert len(varied.validation.labels) == 3 * len(plain.validation.labels)
    assert len(varied.test.labels) == len(plain.test.labels)


@pytest.fixture(autouse=True)
def few_are_kept(monkeypatch):
    """These trials are few."""
    monkeypatch.setattr(tasks, "LEAST_KEPT", 1)


def test_too_few_trials_are_not_kept(trains, monkeypatch):
    monkeypatch.setattr(tasks, "LEAST_KEPT", 5)
    every, fewer = (tasks.trials_of(trains, task(seen=share)).train for share in (0.0, 0.25))
    np.testing.assert_array_equal(every, fewer)


def test_trials_that_are_kept_are_neither_trained_on_nor_copied(trains):
    every, fewer = task(augmentation="time"), task(augmentation="time", seen=0.25)
    kept = np.setdiff1d(tasks.trials_of(trains, every).train, tasks.trials_of(trains, fewer).train)
    assert len(kept) == 4
    side = tasks.seen_side(trains, fewer)
    assert side is not None
    assert sorted(trains.labels[kept].tolist()) == sorted(side.labels.tolist())
    assert len(tasks.sides_of(trains, fewer).train.labels) == 3 * len(tasks.trials_of(trains, fewer).train)
    assert tasks.seen_side(trains, every) is None


def test_a_file_of_spikes_carries_its_copies_to_training(tmp_path):
    from neurotact.data import hdf5

    rng = np.random.default_rng(1)
    signals = [rng.normal(0, 3, (200, 2)).cumsum(axis=0) for _ in range(18)]
    conditions = {"label": ["felt", "silk"] * 9, "speed": np.repeat([1, 2, 3], 6)}
    hdf5.save_recordings(Recordings(signals, 1000.0, "mV", pd.DataFrame(conditions)), tmp_path / "touches.h5")
    path, said = tmp_path / "spikes.h5", []
    window = nt.Window(length_ms=100, per_trial=1)
    how = {"settings": {"hidden": 5, "training.epochs": 1}, "window": window, "tell": said.append}
    nt.encode_file(tmp_path / "touches.h5", path, augmentation="time+gain", copies=2, tell=said.append)
    assert (
        said[1]
        == "beside 2 copies of each trial for training, played up to 2 times faster or slower, and scaled up to 2 times"
    )
    assert len(nt.load_spikes(path)) == 18
    nt.train(path, tmp_path / "with", "rsnn", split=nt.Split(test_where={"speed": 3}), **how)
    assert "training: also on the varied copies in the file (time+gain)" in said
    nt.train(path, tmp_path / "without", "rsnn", augmentation="none", split=nt.Split(test_where={"speed": 3}), **how)
    logs = [(tmp_path / name / "training.csv").read_text() for name in ("with", "without")]
    assert logs[0] != logs[1]
    found = nt.train(
        path, tmp_path / "each", "rsnn", augmentation="time+gain", split=nt.Split(leave_out_each="speed"), **how
    )
    assert len(found["splits"]) == 3
    with pytest.raises(InputError, match=r"holds no varied copies 'gain'; it has time\+gain"):
        nt.train(path, tmp_path / "other", "rsnn", augmentation="gain", **how)
    assert len(nt.infer(tmp_path / "with", path, test_only=True)) == 6


def test_spikes_without_copies_refuse_them(trains):
    from dataclasses import replace

    with pytest.raises(InputError, match="hold no varied copies"):
        tasks.sides_of(replace(trains, variations=None), task(augmentation="time"))


def test_auto_chooses_only_where_validation_can(trains):
    auto = AugmentationSpec()
    assert model_selection.candidates(auto, trains.conditions, task().split) == CANDIDATES
    alone = trains.conditions[trains.conditions["speed"] != 1.6].reset_index(drop=True)
    assert model_selection.candidates(auto, alone, task().split) == ("time+gain",)
    assert model_selection.candidates(AugmentationSpec(kind="start"), alone, task().split) == ("start",)


def test_each_kind_starts_from_the_same_weights_and_the_best_on_validation_wins(trains):
    spec = resolve(RSNNSpec, "rsnn", {"hidden": 12, "training.epochs": 1, "training.batch": 8})
    tried = list(model_selection.trainings(trains, spec, task(seen=0.2), (0, 1), CANDIDATES))
    assert [one.task.augmentation for one in tried] == list(CANDIDATES)
    assert [one.row()["n_train"] for one in tried] == [len(one.sides.train.labels) for one in tried]
    assert all(0 <= one.seen <= 1 and not one.task.varied_validation for one in tried)
    kept = tasks.seen_trials(trains, tried[0].task)
    for one in tried:  # one window of each trial
        right = model_selection.right_seen(one.fitted.network, trains, one.task)
        assert [*right] == kept.tolist()
        assert np.mean([*right.values()]) == pytest.approx(one.seen)
    assert model_selection.right_seen(tried[0].fitted.network, trains, task()) == {}
    best = model_selection.best_of(tried)
    assert best.validation == max(one.validation for one in tried)
    equal = [one for one in tried if one.validation == best.validation]
    losses = [one.fitted.training.best.validation_loss for one in equal]
    assert best.fitted.training.best.validation_loss == min(losses)
    assert isinstance(best.fitted.training.best, Epoch)


def learns(kinds, **keys):
    spec = resolve(RSNNSpec, "rsnn", {"hidden": 8, "training.epochs": 8, "training.batch": 16, "training.patience": 8})
    return spec, (task(seen=0.2), (0, 1), kinds)


def logs(tried):
    return [(one.task.augmentation, one.fitted.training.epochs, one.seen) for one in tried]


def test_a_training_that_goes_on_is_as_if_nothing_had_been_judged(trains):
    spec, how = learns(CANDIDATES)
    whole = {one.task.augmentation: one for one in model_selection.trainings(trains, spec, *how)}
    begun, out = model_selection.rule_out(trains, spec, *how)
    ((first, checkpoint),) = begun.items()
    assert isinstance(checkpoint, Checkpoint)
    assert len(checkpoint.epochs) == 2
    assert sorted([first, *(one.kind for one in out)]) == sorted(CANDIDATES[1:])
    left = ["none", first]
    again = model_selection.trainings(trains, spec, *how[:2], left, begun=begun)
    assert logs(again) == logs(whole[kind] for kind in left)


def test_copies_are_judged_by_the_epoch_that_their_training_would_keep(trains, monkeypatch):
    """A recipe chooses which: not by the rule of a network that has none."""
    monkeypatch.setattr(model_selection, "PART", 1.0)
    spec = resolve(RSNNSpec, "default", {"model": "snn", "direct": False, "training.epochs": 6, "hidden": 20})
    how = task(), (0, 1), CANDIDATES
    _, out = model_selection.rule_out(trains, spec, *how)
    whole = {one.task.augmentation: one.fitted for one in model_selection.trainings(trains, spec, *how)}
    assert out
    for one in out:
        training = whole[one.kind].training
        assert one.epochs == len(training.epochs)
        assert one.epoch == training.best == best_of(training.epochs, "both")


@pytest.mark.parametrize("clear", [(), ("time",), ("gain", "time")])
def test_after_a_part_the_kind_of_the_lowest_loss_goes_on_unless_it_is_clearly_below_the_best(
    trains, monkeypatch, clear
):
    spec, how = learns(CANDIDATES)
    monkeypatch.setattr(model_selection, "clearly_worse", lambda _, n: clear if n == 16 else pytest.fail("not 16"))
    begun, out = model_selection.rule_out(trains, spec, *how)
    (first,) = begun
    losses = {one.kind: one.epoch.validation_loss for one in out}
    assert first not in clear
    for one in out:
        name, epoch = one.first
        assert name == first
        assert one.kind in clear or epoch.validation_loss <= losses[one.kind]
        assert one.epochs == 2
        accuracy = one.epoch.validation_accuracy
        assert one.row() == {
            "augmentation": one.kind, "accuracy_validation": accuracy, "ruled_out": 2, "chosen": False, "last": False,
        }  # fmt: skip
        assert str(one).startswith(f"copies '{one.kind}' are ruled out after 2 epochs: {100 * accuracy:.0f} % of ")
        assert f"behind '{first}' with {100 * epoch.validation_accuracy:.0f} % and " in str(one)


@given(accuracies=st.lists(st.sampled_from([0.2, 0.9, 1.0]), min_size=1, max_size=4), data=st.data())
def test_of_equal_accuracies_the_loss_decides(accuracies, data):
    losses = data.draw(st.lists(st.floats(0, 9), min_size=len(accuracies), max_size=len(accuracies), unique=True))
    epochs = {str(k): Epoch(1, 0.0, 0.0, *own) for k, own in enumerate(zip(losses, accuracies, strict=True))}
    first = epochs[model_selection.first_of(epochs, 40)]
    assert first.validation_accuracy >= max(accuracies) - 0.15  # of 40 trials, 0.9 is not clearly below 1
    near = [own.validation_loss for own in epochs.values() if own.validation_accuracy >= max(accuracies) - 0.15]
    assert first.validation_loss == min(near)


def test_one_kind_alone_is_not_judged(trains):
    spec, how = learns(("none", "time"))
    assert model_selection.rule_out(trains, spec, *how) == ({}, [])


@given(n=st.integers(1, 500), right=st.lists(st.integers(0, 500), min_size=1, max_size=4))
def test_what_is_clearly_worse(n, right):
    accuracies = {str(k): min(one, n) / n for k, one in enumerate(right)}
    out = model_selection.clearly_worse(accuracies, n)
    best = max(accuracies.values())
    assert all(accuracies[name] < best for name in out)
    assert set(out) == set(model_selection.clearly_worse(dict(reversed(accuracies.items())), n))
    for name, one in accuracies.items():
        least = model_selection.CLEAR * (0.5 / (n + 2)) ** 0.5  # no share varies more than a half
        if (best - one) * n / (n + 2) > least:
            assert name in out
        if (best - one) * n < 2.5:  # two trials are never clear
            assert name not in out
