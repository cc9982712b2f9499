"""Recurrence is kept where it gains: two trainings, and what is left of the one that is not kept."""

import json

import numpy as np
import pandas as pd
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from neurotact_parts.networks.search import search
from neurotact_parts.networks.search.tuning import Proposal
from stopped_trainings import stopped_after

from neurotact import InputError, SpikingClassifier
from neurotact.data.hdf5 import save_spikes
from neurotact.data.spikes import from_rasters
from neurotact.data.splits import SplitSpec
from neurotact.data.windows import WindowSpec
from neurotact.networks.definition.rsnn import RSNN
from neurotact.networks.definition.space import SearchSpec
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.networks.training import (
    cautions,
    comparison,
    ensemble,
    epoch_checkpoint,
    epochs,
    resumable,
    tasks,
    trainer,
)
from neurotact.networks.training.ensemble import pays
from neurotact.networks.training.tasks import Task
from neurotact.networks.use import measuring
from neurotact.spec import build, override

N_EPOCHS = 3
TRAINED = {
    "model": "auto", "hidden": 5, "readout": "integrator", "forward_weight_scale": 4.0, "recurrent_weight_scale": 0.3,
    "training": {"epochs": N_EPOCHS, "patience": N_EPOCHS, "batch": 8, "learning_rate": 0.05},
}  # fmt: skip
TASK = Task(window=WindowSpec(length_ms=40.0, per_trial=1), split=SplitSpec(validation=0.25, test=0.25))
RIGHT = st.lists(st.tuples(st.booleans(), st.booleans()), min_size=1, max_size=40)


def trains():
    """Two classes that fire on different afferents, which is learned in part."""
    labels = np.arange(24) % 2
    rates = np.where(labels[:, None] == np.array([[0, 0, 1, 1]]), 0.4, 0.2)
    rasters = np.random.default_rng(0).random((24, 40, 4)) < rates[:, None]
    names = ("SA-I a", "SA-I b", "RA-I a", "RA-I b")
    return from_rasters(rasters, 1000.0, names, pd.DataFrame({"label": [("felt", "silk")[i] for i in labels]}))


def spec_of(**keys) -> RSNNSpec:
    return build(RSNNSpec, override(TRAINED, keys), source="a spec")


def same(one: RSNN, other: RSNN) -> bool:
    ours, theirs = one.state_dict(), other.state_dict()
    return ours.keys() == theirs.keys() and all(torch.equal(ours[name], theirs[name]) for name in ours)


@pytest.fixture(params=[True, False], ids=["it pays", "it does not"])
def kept(request, monkeypatch) -> str:
    """The model that is kept, whatever the networks have learned."""
    monkeypatch.setattr(ensemble, "pays", lambda without, with_it: request.param)
    return "rsnn" if request.param else "snn"


# --- the rule -----------------------------------------------------------------------------------------------------


@given(right=RIGHT, both=st.integers(0, 20))
def test_recurrence_pays_one_way_at_most_and_windows_that_both_decide_alike_do_not_count(right, both):
    without, with_it = torch.tensor(right).unbind(dim=1)
    assert not (pays(without, with_it) and pays(with_it, without))
    assert not pays(with_it | without, with_it)
    alike = torch.ones(both, dtype=torch.bool)
    assert pays(torch.cat([without, alike]), torch.cat([with_it, alike])) == pays(without, with_it)


@pytest.mark.parametrize(("gained", "lost", "it_pays"), [(1, 0, False), (2, 0, True), (6, 3, False), (7, 3, True)])
def test_recurrence_pays_beyond_one_standard_error(gained, lost, it_pays):
    without = torch.tensor([False] * gained + [True] * lost)
    assert pays(without, ~without) == it_pays


# --- training -----------------------------------------------------------------------------------------------------


def test_the_network_that_is_kept_is_that_of_its_own_training(kept):
    done, sides = trainer.fit(trains(), spec_of(), TASK, (3, 4))
    each = {model: trainer.fit(trains(), spec_of(model=model), TASK, (3, 4))[0] for model in ("snn", "rsnn")}
    assert done.network.spec == each[kept].network.spec.of_model(kept)
    assert same(done.network, each[kept].network)
    assert done.rule == each[kept].rule
    assert done.training.best == each[kept].training.best
    accuracies = (each[model].training.best.validation_accuracy for model in ("rsnn", "snn"))
    assert done.training.recurrence_gain == pytest.approx(np.subtract(*accuracies))
    log = done.training.table()
    numbers = {"snn": 0, "rsnn": 1} if kept == "rsnn" else {"snn": 1, "rsnn": 0}
    for model, number in numbers.items():
        own = log[log["member"] == number].drop(columns="member").reset_index(drop=True)
        pd.testing.assert_frame_equal(own, each[model].training.table())
    assert done.training.n_members == 1
    assert len(sides.train.labels) == 12


def test_a_network_without_recurrence_has_no_blocks_and_its_spec_can_be_trained_again(kept):
    asked = spec_of(hidden=6, recurrent_blocks=3, recurrent_delay_steps=1)
    done, sides = trainer.fit(trains(), asked, TASK, (3, 4))
    row = measuring.measure(done, sides, {})["row"]
    assert row.get("recurrent_blocks") == (3 if kept == "rsnn" else None)
    again = SpikingClassifier(network=done.network.spec, sampling_rate_Hz=1000.0, random_state=0)
    again.fit(sides.train.spikes.numpy(), sides.train.labels.numpy())
    assert again.network_.spec.model == kept


def test_the_rule_decides_on_validation_windows():
    done, sides = trainer.fit(trains(), spec_of(), TASK, (3, 4))
    right = []
    for model in ("snn", "rsnn"):
        network = trainer.fit(trains(), spec_of(model=model), TASK, (3, 4))[0].network
        right.append(network.infer(sides.validation.spikes).labels == sides.validation.labels)
    assert done.network.spec.recurrent == pays(*right)


def test_recurrence_is_not_tried_where_nothing_is_left_to_learn(monkeypatch):
    monkeypatch.setattr(epochs, "has_learned", lambda log, spec: len(log) == 2)
    done, _ = trainer.fit(trains(), spec_of(), TASK, (3, 4))
    assert done.network.spec.model == "snn"
    assert done.training.recurrence_gain is None
    assert done.training.table().columns.tolist() == list(epochs.Epoch._fields)[:-1]
    assert len(done.training.epochs) == 2


def test_further_members_are_of_the_model_that_is_kept(kept):
    done, _ = trainer.fit(trains(), spec_of(**{"training.members": 2}), TASK, (3, 4))
    whole, _ = trainer.fit(trains(), spec_of(**{"training.members": 2, "model": kept}), TASK, (3, 4))
    assert same(done.network, whole.network)
    assert done.network.spec == whole.network.spec.of_model(kept)
    assert done.training.best == whole.training.best
    assert done.training.n_members == 2
    assert {epoch.member for epoch in done.training.epochs} == {0, 1, 2}


@pytest.mark.parametrize("n_members", [1, 2])
def test_an_interrupted_training_goes_on_from_any_epoch(kept, n_members, tmp_path):
    checkpoints: list[epochs.Checkpoint] = []
    spec = spec_of(**{"training.members": n_members})
    done, _ = trainer.fit(trains(), spec, TASK, (3, 4), keep=checkpoints.append)
    assert len(checkpoints) == (1 + n_members) * N_EPOCHS
    net = epoch_checkpoint.Net(spec, 4, 2)
    for latest in checkpoints:
        epoch_checkpoint.save(latest, tmp_path / "c", "one")
        again = epoch_checkpoint.load(tmp_path / "c", net, "one")
        resumed, _ = trainer.fit(trains(), spec, TASK, (3, 4), start=again)
        assert resumed.training == done.training
        assert same(resumed.network, done.network)


@pytest.mark.parametrize("n_members", [1, 2, 3])
def test_a_training_with_recurrence_that_fails_leaves_the_network_without_it(n_members, monkeypatch, tmp_path):
    real = ensemble.one.train

    def fails(network, *arguments, keep=None, **options):
        def kept(latest):
            if network.spec.recurrent and latest.epochs[-1].epoch == 2:
                raise epochs.not_finite(2, network.spec.training)
            if keep is not None:
                keep(latest)

        return real(network, *arguments, keep=kept, **options)

    monkeypatch.setattr(ensemble.one, "train", fails)
    spec, checkpoints = spec_of(**{"training.members": n_members}), []
    with pytest.warns(UserWarning, match=r"not finite after epoch 2.*; the network without recurrence stays"):
        done, _ = trainer.fit(trains(), spec, TASK, (3, 4), keep=checkpoints.append)
    plain, _ = trainer.fit(trains(), spec.of_model("snn"), TASK, (3, 4))
    assert same(done.network, plain.network)
    assert done.training == plain.training
    assert done.training.recurrence_gain is None
    net = epoch_checkpoint.Net(spec, 4, 2)
    for latest in checkpoints:
        epoch_checkpoint.save(latest, tmp_path / "c", "one")
        with pytest.warns(UserWarning, match="the network without recurrence stays"):
            resumed, _ = trainer.fit(
                trains(), spec, TASK, (3, 4), start=epoch_checkpoint.load(tmp_path / "c", net, "one")
            )
        assert resumed.training == done.training
        assert same(resumed.network, done.network)


def test_a_checkpoint_of_more_trainings_than_there_are_is_refused(kept, tmp_path):
    checkpoints: list[epochs.Checkpoint] = []
    trainer.fit(trains(), spec_of(), TASK, (3, 4), keep=checkpoints.append)
    epoch_checkpoint.save(checkpoints[-1], tmp_path / "c", "one")
    with pytest.raises(InputError, match=f"where 1 to {N_EPOCHS} are possible"):
        epoch_checkpoint.load(tmp_path / "c", epoch_checkpoint.Net(spec_of(model=kept), 4, 2), "one")


def test_a_run_is_interrupted_in_its_second_training_and_leaves_what_a_whole_one_leaves(kept, tmp_path, monkeypatch):
    save_spikes(trains(), tmp_path / "spikes.h5")
    outcome = resumable.run(tmp_path / "spikes.h5", tmp_path / "whole", spec_of(), TASK)
    assert outcome is not None
    assert any(line.startswith(f"hidden neurons: with{'' if kept == 'rsnn' else 'out'} ") for line in outcome.lines())
    with stopped_after(N_EPOCHS + 1, monkeypatch):
        resumable.run(tmp_path / "spikes.h5", tmp_path / "cut", spec_of(), TASK)
    resumable.run(tmp_path / "spikes.h5", tmp_path / "cut", spec_of(), TASK, resume=True)
    whole, cut = ({p.name: p.read_bytes() for p in (tmp_path / name).iterdir()} for name in ("whole", "cut"))
    assert whole == cut
    assert json.loads(whole["network.json"])["spec"]["model"] == kept
    row = json.loads(whole["result.json"])["row"]
    assert row["epochs"] == 2 * N_EPOCHS
    assert (row["sops_recurrent"] > 0) == (kept == "rsnn")
    assert "members" not in row
    assert -1 <= row["recurrence_gain"] <= 1


def test_a_trial_of_a_search_decides_too(kept):
    space, found = {"hidden": {"_type": "choice", "_value": [5]}}, trains()
    problem = search.problem_of(found, SearchSpec(space=space, trials=1), spec_of(), TASK)
    trial = search.try_network(
        search.Job(problem, Proposal(0, {"hidden": 5}), None), found, tasks.sides_of(found, TASK, None)
    )
    assert len(trial.epochs) == 2 * N_EPOCHS
    best, _ = search.train_best(problem, found, trial)
    assert best.network.spec.model == kept
    assert best.training.best.validation_accuracy == trial.accuracy


def test_a_classifier_decides_on_the_windows_that_it_holds_out(kept):
    spikes = np.random.default_rng(1).random((40, 30, 3)) < 0.3
    clf = SpikingClassifier(network=spec_of(), sampling_rate_Hz=1000.0, random_state=0).fit(
        spikes.astype(np.uint8), np.arange(40) % 2
    )
    assert clf.network_.spec.model == kept
    assert clf.training_.recurrence_gain is not None


@pytest.mark.parametrize(("models", "first"), [(["auto", "snn"], "auto"), (["rsnn", "snn"], "rsnn")])
def test_a_search_begins_with_a_model_of_its_space(models, first):
    space = {"model": {"_type": "choice", "_value": models}}
    asked = search.asked(SearchSpec(space=space, trials=2), spec_of(), trains(), TASK)
    assert asked.first == {"model": first}


# --- what is said -------------------------------------------------------------------------------------------------


def test_a_network_whose_recurrence_is_open_cannot_be_built():
    with pytest.raises(InputError, match="model: 'auto' is decided in training"):
        RSNN(4, 2, hidden=3, model="auto", sampling_rate_Hz=1000.0)


def test_cautions_are_of_the_network_that_is_kept():
    log = pd.DataFrame({"epoch": [1, 2, 1, 2], "member": [0, 0, 1, 1], "train_loss": [0.1, 9.0, 2.0, 0.1]})
    spec = RSNNSpec().training
    assert list(cautions.training(log, spec)) == []
    (line,) = cautions.training(log.assign(member=[1, 1, 0, 0]), spec)
    assert line.startswith("training diverged")


def test_what_recurrence_gains_is_said_where_it_was_tried():
    assert comparison.recurrence({"sops_recurrent": 5.0}) == []
    (line,) = comparison.recurrence({"sops_recurrent": 5.0, "recurrence_gain": 0.085})
    assert (
        line == "hidden neurons: with recurrence; validation accuracy gains 8.5 points; to choose otherwise, set model"
    )


LAYER = {"sops_input": 9.0, "sops_recurrent": 0.0, "smallest_accuracy": 0.9, "layer_gain": 0.05}


@pytest.mark.parametrize(
    ("row", "said"),
    [
        ({**LAYER, "path_gain": 0.01}, "a hidden layer: 90.0 % of the validation windows are right without it; with it "
         "+5.0 points; with a path past it +1.0 points, within the standard error"),
        ({**LAYER, "path_gain": 0.03, "direct": 1}, "a hidden layer and a path past it: 90.0 % of the validation "
         "windows are right without it; with it +5.0 points; with the path +3.0 points more"),
        ({**LAYER, "layer_gain": -0.05, "sops_input": 0.0}, "no hidden layer: 90.0 % of the validation windows are "
         "right without one; with it -5.0 points"),
    ],
)  # fmt: skip
def test_what_was_tried_from_the_smallest_up_is_said(row, said):
    assert comparison.recurrence(row) == [f"{said}; to choose otherwise, set hidden"]
    assert len(comparison.recurrence({**row, "recurrence_gain": 0.0})) == 2


@pytest.mark.parametrize(
    ("gain", "change"), [(0.05, "+5.0 points, within the standard error"), (0.0, "+0.0 points"), (-0.1, "-10.0 points")]
)
def test_a_gain_that_is_not_clear_is_called_so(gain, change):
    (line,) = comparison.recurrence({"sops_recurrent": 0.0, "recurrence_gain": gain})
    said = f"hidden neurons: without recurrence; with it, validation accuracy changes by {change}"
    assert line == f"{said}; to choose otherwise, set model"
