"""A trained network: what it is judged by, counted by hand, and what it says of trials that it has seen.

The networks here are wired by hand: afferent i reaches hidden neuron i alone, and that class i alone. Currents last one
step and every weight is far above threshold, so that an input at step t is a hidden spike at t + 2 and a readout spike
at t + 4 (eq4: current, membrane, spike), unless the neuron has just spiked and forgets what comes in.
"""

import json
import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import torch

from neurotact.data import hdf5
from neurotact.data.spikes import SpikeTrains, from_rasters
from neurotact.data.splits import Split
from neurotact.errors import InputError
from neurotact.metrics.synops import summary
from neurotact.networks.definition.rsnn import RSNN
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.networks.exit.patience import ExitChoice
from neurotact.networks.exit.rule import ExitRule
from neurotact.networks.training import epochs, run_folder, tasks, trainer
from neurotact.networks.training.epochs import Epoch, Examples, Training
from neurotact.networks.training.tasks import Task
from neurotact.networks.training.trainer import Trained
from neurotact.networks.use import inference, measuring

N_STEPS = 30
NAMES = ("SA-I taxel1", "RA-I taxel1")
ENCODER = {"model": "lif", "sa1": {"gain": 3.2, "t_ref_ms": 1.0}, "ra1": {"gain": 16.0, "t_ref_ms": 1.0}}
SPEC = RSNNSpec(hidden=2, tau_syn_ms=0.01)
EPOCHS = (Epoch(1, 0.7, 0.5, 0.6, 0.9), Epoch(2, 0.6, 0.6, 0.65, 0.95), Epoch(3, 0.5, 0.7, 0.8, 0.4))
RULE = ExitRule(3, from_first_spike=True)
POPULATIONS = {"SA-I": np.array([True, False]), "RA-I": np.array([False, True])}


def wired(backend="reference", spec=SPEC) -> RSNN:
    network = RSNN(2, 2, spec, 1000.0, backend=backend, generator=torch.Generator().manual_seed(0))
    with torch.no_grad():
        network.w_in.copy_(50 * torch.eye(2))
        network.w_out.copy_(50 * torch.eye(2))
        if network.w_rec is not None:
            network.w_rec.zero_()
    return network


def window(first=(), second=()) -> np.ndarray:
    """Spikes of both afferents at the given steps, `(time, afferent)`."""
    raster = np.zeros((N_STEPS, 2), np.uint8)
    raster[list(first), 0] = raster[list(second), 1] = 1
    return raster


STEADY = window(first=range(0, N_STEPS, 2))
"""Class 0 throughout: 15 input spikes, 14 hidden ones (steps 2, 4 ... 28), 13 of the readout (4, 6 ... 28)."""
SWITCHING = window(first=(0, 2), second=(6, 8, 10))
"""Class 0 leads from step 4 on, class 1 from step 14 on: its third readout spike beats the two of class 0."""
SILENT = window()


def examples(*pairs) -> Examples:
    rasters, labels = zip(*pairs, strict=True)
    return Examples(torch.from_numpy(np.stack(rasters)), torch.tensor(labels))


def alike(examples: Examples) -> tasks.Sides:
    """The same windows for training, validation and test."""
    return tasks.Sides(examples, examples, examples)


def trains_of(*pairs, **changes) -> SpikeTrains:
    rasters, labels = zip(*pairs, strict=True)
    table = pd.DataFrame({"label": [("felt", "silk")[label] for label in labels], "force_N": range(len(labels))})
    digests = tuple(f"{n:016x}" for n in range(len(labels)))
    return replace(from_rasters(np.stack(rasters), 1000.0, NAMES, table, ENCODER, trial_digests=digests), **changes)


def untrained(*_, **__):
    return Training(EPOCHS, EPOCHS[0])


def fitted(rule=RULE, best=0) -> Trained:
    return Trained(wired(), Training(EPOCHS, EPOCHS[best]), rule)


# --- what a network is judged by, counted by hand ------------------------------------------------------


@pytest.mark.parametrize("backend", ["reference", "auto"])
def test_the_wired_network_does_what_this_file_says(backend):
    with torch.no_grad():
        rasters = wired(backend).simulate(torch.from_numpy(np.stack([STEADY, SWITCHING, SILENT])))
    hidden, readout = (np.argwhere(spikes.numpy() > 0).tolist() for spikes in rasters)
    assert hidden == [[0, t, 0] for t in range(2, 30, 2)] + [
        [1, t, n] for t, n in ((2, 0), (4, 0), (8, 1), (10, 1), (12, 1))
    ]
    assert readout == [[0, t, 0] for t in range(4, 30, 2)] + [
        [1, t, n] for t, n in ((4, 0), (6, 0), (10, 1), (12, 1), (14, 1))
    ]


def test_test_windows_are_measured_as_by_hand():
    """Two windows: the steady one, right, and a silent one, wrong.

    Full window: 15 input spikes reach 2 neurons, 14 hidden spikes 2 hidden ones and 2 of the readout: 30 + 28 + 28.
    Early exit: the readout first spikes at step 4, class 0 has stood 4 steps at step 7, so that 8 steps are simulated,
    with 4 input spikes (0, 2, 4, 6) and 3 hidden ones (2, 4, 6): 8 + 6 + 6. The silent window costs nothing.
    """
    found = measuring.measure(fitted(), alike(examples((STEADY, 0), (SILENT, 1))), POPULATIONS)
    row = found["row"]
    assert (row["accuracy_test"], row["exit_accuracy"]) == (0.5, 0.5)
    assert [row[f"sops_{n}"] for n in ("input", "recurrent", "readout", "total", "total_feedforward")] == [
        15, 14, 14, 43, 29,
    ]  # fmt: skip
    assert [row[f"exit_sops_{n}"] for n in ("input", "recurrent", "readout", "total", "total_feedforward")] == [
        4, 3, 3, 10, 7,
    ]  # fmt: skip
    assert (row["exit_steps"], row["exit_steps_sd"], row["window_steps"]) == (19, 11, 30)
    assert (row["spikes_sa"], row["spikes_ra"], row["exit_patience"]) == (7.5, 0, 3)
    assert found["confusion"] == [[1, 0], [1, 0]]
    assert (found["right"], found["exit_right"]) == ([True, False], [True, False])


def test_early_exit_has_its_own_accuracies_on_validation_and_test_windows():
    """On the switching window class 0 leads from step 4 to 13: with a patience of 3 it exits there, and is right."""
    sides = tasks.Sides(*(examples((window_, 0)) for window_ in (STEADY, SILENT, SWITCHING)))
    found = measuring.measure(fitted(), sides, POPULATIONS)
    assert (found["right"], found["exit_right"]) == ([False], [True])
    assert (found["row"]["accuracy_test"], found["row"]["exit_accuracy"]) == (0.0, 1.0)
    assert found["row"]["exit_accuracy_validation"] == 1.0  # a silent window is of the first class


def test_the_oracle_pays_for_the_steps_that_it_simulates(monkeypatch):
    """From the first step on class 0 leads: it exits after 4 steps, 2 input spikes and 1 hidden one, 4 + 2 + 2.

    The silent window is never right: the full window, at no cost.
    """
    monkeypatch.setattr(measuring, "ORACLE_PATIENCE", 3)
    row = measuring.measure(fitted(), alike(examples((STEADY, 0), (SILENT, 1))), POPULATIONS)["row"]
    assert (row["oracle_steps"], row["oracle_accuracy"], row["oracle_sops_total"]) == (17, 0.5, 4)


def test_a_feed_forward_network_has_no_recurrent_operations():
    alone = fitted()._replace(network=wired(spec=SPEC.model_copy(update={"model": "snn"})))
    row = measuring.measure(alone, alike(examples((STEADY, 0))), POPULATIONS)["row"]
    assert (row["sops_recurrent"], row["exit_sops_recurrent"]) == (0, 0)
    assert row["sops_total"] == row["sops_total_feedforward"] == 58
    assert row["exit_sops_total"] == row["exit_sops_total_feedforward"] == 14
    assert row["oracle_sops_total"] == 58
    assert measuring.mean_sops(alone.network, examples((STEADY, 0), (SILENT, 1))) == 29


@pytest.mark.parametrize("best", range(3))
def test_validation_accuracy_is_that_of_the_epoch_whose_weights_were_kept(best):
    row = measuring.measure(fitted(best=best), alike(examples((STEADY, 0))), POPULATIONS)["row"]
    assert row["accuracy_validation"] == EPOCHS[best].validation_accuracy
    assert row["epochs"] == 3


VALIDATION = ((STEADY, 0), (STEADY, 0), (STEADY, 0), (SWITCHING, 1))


@pytest.mark.parametrize(("tolerance", "patience"), [(0.0, 10), (0.24, 10), (0.25, 1), (0.99, 1)])
def test_the_exit_rule_loses_no_more_than_it_may(tolerance, patience):
    """Class 0 leads the switching window for 10 steps, so that a patience below 10 gets it wrong: 3 of 4 windows."""
    assert trainer.exit_of(wired(), examples(*VALIDATION), tolerance).rule == ExitRule(patience, from_first_spike=True)


def test_a_rule_is_chosen_on_all_validation_windows_however_many():
    many = examples(*[(STEADY, 0)] * 1500, (SWITCHING, 1))
    assert trainer.exit_of(wired(), many, 0.0).rule.patience == 10
    assert trainer.exit_of(wired(), many, 0.001).rule.patience == 1


def test_training_windows_judge_a_steady_rule_too():
    """One validation window, which allows a patience of 1, beside training windows that do not."""
    training = examples(*[(STEADY, 0)] * 400, *[(SWITCHING, 1)] * 100)
    assert trainer.exit_of(wired(), examples((STEADY, 0)), 0.01).rule.patience == 1
    assert trainer.exit_of(wired(), examples((STEADY, 0)), 0.01, training).rule.patience == 10
    assert trainer.exit_of(wired(), examples(*VALIDATION), 0.01, examples((STEADY, 0))).rule.patience == 10


@pytest.mark.parametrize(("choice", "patience"), [("least", 1), ("steady", 10)])
def test_a_fit_chooses_as_the_task_says(monkeypatch, choice, patience):
    trains = trains_of(*VALIDATION, (STEADY, 0), (STEADY, 1), (STEADY, 0))
    monkeypatch.setattr(epochs, "train", untrained)
    monkeypatch.setattr(trainer, "new_network", lambda *_, **__: (wired(), torch.Generator()))
    task = Task(window={"length_ms": N_STEPS}, exit_choice=choice)
    split = Split(np.arange(4), np.array([4]), np.array([5, 6]))
    assert trainer.fit(trains, SPEC, task, (0, 1), split=split)[0].rule.patience == patience


@pytest.mark.parametrize(("tolerance", "patience"), [(0.01, 10), (0.25, 1)])
def test_a_fit_takes_the_tasks_tolerance_and_its_validation_trials(monkeypatch, tolerance, patience):
    """Training and test trials would have allowed a patience of 1 whatever the tolerance."""
    trains = trains_of((STEADY, 0), (STEADY, 1), *VALIDATION, (STEADY, 0), (STEADY, 0))
    seen = []

    def watched(network, training, validation, **_):
        seen.extend([training.labels.tolist(), validation.labels.tolist()])
        return untrained()

    monkeypatch.setattr(epochs, "train", watched)
    monkeypatch.setattr(trainer, "new_network", lambda *_, **__: (wired(), torch.Generator()))
    split = Split(np.array([0, 1]), np.array([2, 3, 4, 5]), np.array([6, 7]))
    task = Task(window={"length_ms": N_STEPS}, exit_tolerance=tolerance)
    found, sides = trainer.fit(trains, SPEC, task, (0, 1), split=split)
    assert found.rule.patience == patience
    assert seen == [[0, 1], [0, 0, 0, 1]]
    assert sides.test.labels.tolist() == [0, 0]


def test_a_recipe_looks_at_the_training_windows_alone():
    trains = spikes_of_many()
    task = Task(window={"length_ms": 20.0, "start_ms": 5.0, "hop_ms": 7.0}, training_windows=3)
    examples = tasks.sides_of(trains, task).train.spikes
    found = tasks.seen(trains, task)
    assert found[:3] == (*examples.shape[:2], trains.sampling_rate_Hz)
    assert found.spikes == pytest.approx(float(examples.double().sum(dim=1).mean()))


def spikes_of_many():
    rasters = np.random.default_rng(0).random((24, 60, 3)) < np.linspace(0.05, 0.5, 24)[:, None, None]
    names = ("SA-I a", "SA-I b", "RA-I a")
    return from_rasters(rasters, 1000.0, names, pd.DataFrame({"label": ["a", "b"] * 12}))


def test_the_first_seed_draws_the_weights_and_the_second_the_order():
    trains = trains_of((STEADY, 0), (SILENT, 1))
    training = torch.zeros(2, 10, 2, dtype=torch.uint8)
    network, order = trainer.new_network(trains, SPEC, (3, 4), training)
    other_order, order_of_5 = trainer.new_network(trains, SPEC, (3, 5), training)
    other_weights, _ = trainer.new_network(trains, SPEC, (4, 4), training)
    alone = RSNN(2, 2, SPEC, 1000.0, generator=torch.Generator().manual_seed(3))
    assert torch.equal(network.w_in, alone.w_in)
    assert torch.equal(network.w_out, other_order.w_out)
    assert not torch.equal(network.w_in, other_weights.w_in)
    drawn, drawn_with_5, expected = (
        torch.randperm(50, generator=g) for g in (order, order_of_5, torch.Generator().manual_seed(4))
    )
    assert torch.equal(drawn, expected)
    assert not torch.equal(drawn, drawn_with_5)


# --- what cannot be learned ----------------------------------------------------------------------------


def test_training_trials_of_one_class_are_refused():
    trains = trains_of((STEADY, 0), (STEADY, 0), (SILENT, 1), (SILENT, 1))
    split = Split(np.array([0, 1]), np.array([2]), np.array([3]))
    with pytest.raises(InputError, match=r"the training trials hold too few classes \(felt\); give at least two"):
        trainer.fit(trains, SPEC, Task(window={"length_ms": N_STEPS}), (0, 1), split=split)


def test_the_classes_of_all_trials_are_gathered_once_and_not_for_each_trial(monkeypatch):
    asked = []
    classes = SpikeTrains.classes.fget
    monkeypatch.setattr(SpikeTrains, "classes", property(lambda trains: asked.append(0) or classes(trains)))
    trains = trains_of(*((STEADY, n % 2) for n in range(12)))
    asked.clear()
    tasks.trials_of(trains, Task(window={"length_ms": N_STEPS}))
    assert len(asked) == 1


def test_training_windows_without_a_spike_are_said():
    trains = trains_of((SILENT, 0), (SILENT, 1), (STEADY, 0), (STEADY, 1))
    split = Split(np.array([0, 1]), np.array([2]), np.array([3]))
    spec = SPEC.model_copy(update={"training": SPEC.training.model_copy(update={"epochs": 1})})
    with pytest.warns(UserWarning, match="none of the 2 training windows holds a spike.*raise the encoder's gains"):
        trainer.fit(trains, spec, Task(window={"length_ms": N_STEPS}), (0, 1), split=split)


# --- what a saved network says of trials and encoders ----------------------------------------------------

N_TRIALS = 20
TASK = Task(window={"length_ms": 15.0})
"""Two windows per trial."""


@pytest.fixture
def made(tmp_path):
    """Spike trains of 20 different trials, the network that was saved with them, and its split."""
    rng = np.random.default_rng(3)
    trains = trains_of(*[((rng.random((N_STEPS, 2)) < 0.3).astype(np.uint8), n % 2) for n in range(N_TRIALS)])
    path = tmp_path / "spikes.h5"
    hdf5.save_spikes(trains, path)
    run_folder.save(fitted(), tmp_path / "run", trains, path, TASK)
    return trains, run_folder.restore(tmp_path / "run"), tasks.trials_of(trains, TASK)


def infer(restored, trains, **options) -> pd.DataFrame:
    return inference.infer(restored, trains, **{"early_exit": False, **options})


def test_every_window_of_the_spikes_that_it_was_trained_on_has_the_side_of_its_trial(made):
    trains, restored, split = made
    table = infer(restored, trains)
    assert table.columns[:3].tolist() == ["trial", "side", "label"]
    for side, trials in zip(("training", "validation", "test"), split, strict=True):
        assert sorted(set(table[table.side == side].trial)) == trials.tolist()
    means = summary(table)
    assert means[means.label == "all"][["side", "windows"]].values.tolist() == [
        ["training", 28], ["validation", 6], ["test", 6],
    ]  # fmt: skip


def test_trials_are_known_in_any_order_and_in_another_file(made):
    trains, restored, split = made
    order = np.random.default_rng(0).permutation(N_TRIALS)
    sides = infer(restored, trains.select(order)).groupby("trial").side.first()
    assert np.flatnonzero(sides == "test").tolist() == sorted(np.flatnonzero(np.isin(order, split.test)).tolist())
    unseen = replace(trains, trial_digests=tuple(f"{n:016x}" for n in range(100, 100 + N_TRIALS)))
    assert set(infer(restored, unseen).side) == {"unseen"}


def test_trials_outside_the_tasks_subset_are_unseen(made, tmp_path):
    trains, _, _ = made
    task = TASK.model_copy(update={"subset": {"force_N": list(range(10))}})
    run_folder.save(fitted(), tmp_path / "part", trains, tmp_path / "spikes.h5", task)
    table = infer(run_folder.restore(tmp_path / "part"), trains)
    assert set(table[table.trial >= 10].side) == {"unseen"}
    assert "unseen" not in set(table[table.trial < 10].side)


def test_the_split_that_a_fit_was_given_is_the_one_that_is_saved(made, tmp_path):
    trains, _, _ = made
    split = Split(np.arange(4), np.arange(4, 8), np.arange(8, 12))
    run_folder.save(fitted(), tmp_path / "own", trains, tmp_path / "spikes.h5", TASK, split)
    table = infer(run_folder.restore(tmp_path / "own"), trains)
    sides = table.groupby("trial").side.first().tolist()
    assert sides == ["training"] * 4 + ["validation"] * 4 + ["test"] * 4 + ["unseen"] * 8


@pytest.mark.parametrize("early_exit", [False, True])
def test_test_windows_alone_are_those_of_the_test_trials(made, early_exit):
    trains, restored, split = made
    every, alone = (infer(restored, trains, early_exit=early_exit, test_only=t) for t in (False, True))
    assert set(alone.trial) == {*split.test.tolist()}
    pd.testing.assert_frame_equal(alone, every[every.side == "test"].reset_index(drop=True))
    with pytest.raises(InputError, match="hold none of the network's test trials"):
        infer(restored, trains.select(split.train), test_only=True)


@pytest.mark.parametrize("n", [298, 299])
def test_inference_exits_early_where_the_loss_is_bounded_and_says_where_not(tmp_path, capsys, n):
    trains = trains_of(*[(STEADY, 0), (SILENT, 1)] * 10)
    done = fitted()
    done = done._replace(held=ExitChoice(done.rule, dict.fromkeys(range(n), 0.0), 0.01))
    run_folder.save(done, tmp_path / "two", trains, tmp_path / "two.h5", Task(window={"length_ms": N_STEPS}))
    restored = run_folder.restore(tmp_path / "two")
    assert (restored.held, restored.rule) == (done.held, done.rule)
    is_used = n == 299
    assert (infer(restored, trains, early_exit=True)["steps"].min() < N_STEPS) == is_used
    told = "early exit is not used, whole windows decide: it may lose up to"
    assert (told in capsys.readouterr().err) == (not is_used)
    infer(restored, trains, early_exit=False)
    assert not capsys.readouterr().err
    row = measuring.measure(done, alike(tasks.examples_of(trains, np.arange(4), restored.task)[0]),
                            trains.populations)  # fmt: skip
    assert (row["row"]["exit_loss_bound"], row["exit_losses"]) == (done.held.bound, done.held.losses)
    assert row["row"]["exit_patience"] == done.rule.patience  # what it would save is measured in any case


def test_early_exit_pays_for_the_steps_that_were_simulated(tmp_path):
    """As counted in `test_test_windows_are_measured_as_by_hand`, on the way through the files."""
    trains = trains_of(*[(STEADY, 0), (SILENT, 1)] * 10)
    run_folder.save(fitted(), tmp_path / "two", trains, tmp_path / "two.h5", Task(window={"length_ms": N_STEPS}))
    restored = run_folder.restore(tmp_path / "two")
    full, early = (infer(restored, trains, early_exit=e).iloc[0] for e in (False, True))
    kept = ["steps", "input_spikes", "hidden_spikes", "sops_total"]
    assert full[kept].tolist() == [30, 15, 14, 86]
    assert early[kept].tolist() == [8, 4, 3, 20]


def test_spikes_of_another_encoder_are_refused_unless_they_are_meant(made):
    trains, restored, _ = made
    slower = {**ENCODER, "sa1": {"gain": 3.2, "t_ref_ms": 5.0}}
    other = replace(trains, encoder=slower)
    told = r"sa1\.t_ref_ms is 5\.0 but was 1\.0 in training"
    with pytest.raises(InputError, match=f"spikes: {told}; encode .* or pass `allow_other_encoder=True`"):
        infer(restored, other)
    with pytest.warns(UserWarning, match=told):
        table = infer(restored, other, allow_other_encoder=True)
    pd.testing.assert_frame_equal(table, infer(restored, trains))


def test_spikes_of_other_afferents_are_refused(made):
    trains, restored, _ = made
    with pytest.raises(InputError, match="afferent 1 is RA-I taxel1 but was SA-I taxel1 in training"):
        infer(restored, replace(trains, afferents=NAMES[::-1]))
    wide = replace(trains, afferents=(*NAMES, "RA-I taxel2"))
    with pytest.raises(InputError, match="come from 3 afferents but the network was trained on 2"):
        infer(restored, wide, allow_other_encoder=True)


@pytest.mark.parametrize("below", ["seed-0-fold-{}", "cells/digest{}"])
def test_a_folder_of_trainings_says_what_it_is_and_names_one(tmp_path, below):
    """As of folds, and of a study."""
    trains, place = trains_of(*[(STEADY, 0), (SILENT, 1)] * 10), tmp_path / "run"
    task = Task(window={"length_ms": N_STEPS})
    for fold in (1, 0):
        run_folder.save(fitted(), place / below.format(fold), trains, tmp_path / "two.h5", task)
        several = "2 trainings in folders of their own" if fold == 0 else "a training in its own folder"
        said = f"{place}: is no network, but holds {several}; name one, such as {place / below.format(fold)}"
        with pytest.raises(InputError, match=re.escape(said)):
            run_folder.restore(place)
    (place / "answer.json").write_text('{"answers": [{"folder": "cells/chosen"}]}')
    with pytest.raises(InputError, match=re.escape(f"; name that of its answer, {place / 'cells' / 'chosen'}")):
        run_folder.restore(place)
    run_folder.save(fitted(), place, trains, tmp_path / "two.h5", task)
    assert run_folder.restore(place).task == task
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match=r"empty/network\.json"):
        run_folder.restore(tmp_path / "empty")


# --- networks of earlier versions ------------------------------------------------------------------------


@pytest.mark.parametrize("key", ["trials", "afferents", "encoder"])
def test_a_network_without_its_trials_is_refused(made, tmp_path, key):
    path = tmp_path / "run" / "network.json"
    table = json.loads(path.read_text())
    del table["extra"][key]
    path.write_text(json.dumps(table))
    with pytest.raises(InputError, match=f"'{key}' is missing; make the network with neurotact train"):
        run_folder.restore(tmp_path / "run")


@pytest.mark.parametrize(
    "trials", [3, [], {}, {"training": {"spikes": []}}, {"training": 1, "validation": 1, "test": 1}]
)
def test_a_damaged_note_of_trials_is_named(made, tmp_path, trials):
    path = tmp_path / "run" / "network.json"
    table = json.loads(path.read_text())
    table["extra"]["trials"] = trials
    path.write_text(json.dumps(table))
    with pytest.raises(InputError, match=r"trials.*network\.json"):
        run_folder.restore(tmp_path / "run")


def test_a_network_of_an_earlier_version_is_read_unless_it_exits_by_a_margin(tmp_path):
    trains = trains_of(*[(STEADY, 0), (SILENT, 1)] * 10)
    run_folder.save(fitted(), tmp_path, trains, tmp_path / "two.h5", TASK)
    path = tmp_path / "network.json"
    table = json.loads(path.read_text())
    table["extra"]["task"]["exit_by"], table["extra"]["exit_margin"] = "stability", None
    path.write_text(json.dumps(table))
    assert run_folder.restore(tmp_path).rule == RULE
    for place, key, value in (("extra", "exit_margin", 2.0), ("task", "exit_by", "margin")):
        changed = json.loads(json.dumps(table))
        (changed["extra"] if place == "extra" else changed["extra"]["task"])[key] = value
        path.write_text(json.dumps(changed))
        with pytest.raises(InputError, match=f"{key}: unknown key"):
            run_folder.restore(tmp_path)
