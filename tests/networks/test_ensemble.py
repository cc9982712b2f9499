"""Networks that are joined: what they send and score, what they cost, and how they are trained."""

import json
from dataclasses import replace
from typing import get_args

import numpy as np
import pandas as pd
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from levels import examples
from made_chains import READOUTS
from neurotact_parts.exporters.c import fine_tuning
from neurotact_parts.exporters.c.formats import Steps
from neurotact_parts.networks.search import search
from neurotact_parts.networks.search.tuning import MedianStop, Proposal
from stopped_trainings import stopped_after

import neurotact as nt
from neurotact import backend as backends
from neurotact.data.hdf5 import save_spikes
from neurotact.data.spikes import from_rasters
from neurotact.errors import InputError
from neurotact.networks.definition import recipe, seeds
from neurotact.networks.definition.rsnn import RSNN
from neurotact.networks.definition.space import SearchSpec
from neurotact.networks.definition.specs import MOST_HIDDEN, RSNNSpec
from neurotact.networks.exit.rule import ExitRule
from neurotact.networks.training import epoch_checkpoint, epochs, resumable, run_folder, tasks, trainer
from neurotact.networks.training.ensemble import joined
from neurotact.networks.training.epochs import Checkpoint, Examples
from neurotact.networks.training.sparsity import prune
from neurotact.networks.use.ledger import network_cost
from neurotact.networks.use.measuring import synops_of
from neurotact.neurons import Membrane, Reset
from neurotact.spec import build, override

native_only = pytest.mark.skipif(backends.native is None, reason="no kernels")
each_backend = pytest.mark.parametrize("backend", ["reference", pytest.param("native", marks=native_only)])
N_IN, N_CLASSES, N_EPOCHS = 4, 3, 3
TRAINED = {
    "hidden": 5, "readout": "integrator",
    "training": {"members": 3, "epochs": N_EPOCHS, "batch": 8, "learning_rate": 0.05, "input_dropout": 0.1},
}  # fmt: skip
TASK = tasks.Task(window={"length_ms": 40.0})


def network(seed: int, backend: backends.Backend = "reference", **keys) -> RSNN:
    keys = {"hidden": 5, "forward_weight_scale": 4.0, "readout": "integrator", **keys}
    net = RSNN(
        N_IN, N_CLASSES, sampling_rate_Hz=1000.0, backend=backend, generator=torch.Generator().manual_seed(seed), **keys
    )
    with torch.no_grad():
        for parameter in (net.bias, net.w_stretch):
            if parameter is not None:
                parameter.normal_(generator=torch.Generator().manual_seed(seed))
    return net


def spikes(seed: int = 0, n_trials: int = 5, n_steps: int = 40) -> torch.Tensor:
    return (torch.rand(n_trials, n_steps, N_IN, generator=torch.Generator().manual_seed(seed)) < 0.3).to(torch.uint8)


drawn_keys = st.fixed_dictionaries(
    {
        "membrane": st.sampled_from(get_args(Membrane)),
        "reset": st.sampled_from(get_args(Reset)),
        "model": st.sampled_from(["rsnn", "snn"]),
        "step_ms": st.sampled_from([None, 2.0, 3.0]),
        "readout": st.sampled_from(["integrator", "leaky", "stretches"]),
        "threshold_adaptation": st.sampled_from([0.0, 0.3]),
        "delay": st.integers(0, 1),
    }
)


def options_of(drawn: dict) -> dict:
    options = {key: value for key, value in drawn.items() if key not in ("readout", "delay")}
    options |= READOUTS[drawn["readout"]]
    if "readout_stretch_ms" in options and drawn["step_ms"]:
        options["readout_stretch_ms"] = 4 * drawn["step_ms"]
    if drawn["model"] == "rsnn":
        options |= {"recurrent_delay_steps": drawn["delay"], "recurrent_weight_scale": 0.5}
    return options


@each_backend
@given(seed=st.integers(0, 999), n=st.integers(2, 4), drawn=drawn_keys)
@examples(60)
def test_a_joined_network_sends_the_spikes_of_its_members_and_scores_their_mean(backend, seed, n, drawn):
    members = [network(seed + k, backend, **options_of(drawn)) for k in range(n)]
    whole, window = joined(members), spikes(seed)
    assert whole.backend == backend
    sent = [each.simulate(window, ordered=backend == "reference").hidden for each in [whole, *members]]
    assert torch.equal(sent[0], torch.cat(sent[1:], dim=2))
    ours, *theirs = [each.infer(window) for each in [whole, *members]]
    mean = torch.stack([each.readout for each in theirs]).mean(dim=0)
    torch.testing.assert_close(ours.readout, mean, rtol=1e-5, atol=1e-5)
    assert torch.equal(ours.hidden_spikes, sum(each.hidden_spikes for each in theirs))
    costs = [synops_of(found, net) for found, net in zip([ours, *theirs], [whole, *members], strict=True)]
    for name in costs[0]._fields:
        assert getattr(costs[0], name).tolist() == sum(getattr(cost, name) for cost in costs[1:]).tolist(), name


@given(seed=st.integers(0, 99), drawn=drawn_keys, patience=st.integers(1, 9))
@examples(20)
def test_a_joined_network_exits_where_the_mean_of_its_members_would(seed, drawn, patience):
    members = [network(seed + k, **options_of(drawn)) for k in range(4)]  # a fourth of a float32 is exact
    whole, window = joined(members), spikes(seed)
    found = whole.infer(window, ExitRule(patience))
    for trial, steps in enumerate(found.steps.tolist()):
        cut = window[trial : trial + 1, :steps]
        mean = torch.stack([each.infer(cut).readout for each in members]).mean(dim=0)
        torch.testing.assert_close(found.readout[trial : trial + 1], mean, rtol=1e-5, atol=1e-5)
    never = whole.infer(window, ExitRule(10_000))
    assert torch.equal(never.labels, whole.infer(window).labels)


@pytest.mark.parametrize("model", ["rsnn", "snn"])
def test_only_synapses_that_exist_are_counted(model):
    members = [network(k, model=model) for k in range(3)]
    whole, window = joined(members), spikes()
    received, sent = window.sum(dim=(0, 1)), whole.simulate(window).hidden.sum(dim=(0, 1))
    by_hand = received.double() @ (whole.w_in != 0).sum(dim=1).double()
    by_hand += sum(sent.double() @ (w != 0).sum(dim=1).double() for w in whole.weights[1:])
    assert synops_of(whole.infer(window), whole).total.sum() == by_hand.item()
    sops = {f"sops_{name}": 10 for name in ("input", "recurrent", "readout")}
    cost, *each = [network_cost(net.spec, N_IN, N_CLASSES, sops, steps=40, signal_ms=40) for net in [whole, *members]]
    parameters = 15 * N_IN + 15 * N_CLASSES + N_CLASSES + (3 * 5 * 5 if model == "rsnn" else 0)
    assert (cost.parameters, cost.macs) == (parameters, sum(one.macs for one in each))
    n_weights = 15 * (N_IN + N_CLASSES) + (75 if model == "rsnn" else 0)
    assert f"{n_weights} weights" in repr(whole)


def test_one_network_is_itself_and_other_networks_are_not_joined():
    one = network(0)
    assert joined([one]) is one
    for other, why in (
        (network(1, hidden=6), "different specs"),
        (RSNN(N_IN + 1, N_CLASSES, one.spec, 1000.0), "differ in their afferents"),
    ):
        with pytest.raises(InputError, match=why):
            joined([one, other])
    for keys in ({"readout": "count"}, {"readout": "max"}, {"readout": "integrator", "learn": ["beta"]}):
        nets = [RSNN(N_IN, N_CLASSES, hidden=4, sampling_rate_Hz=1000.0, **keys) for _ in range(2)]
        with pytest.raises(InputError, match="join only with readout = 'integrator' and without learn"):
            joined(nets)
        with pytest.raises(InputError, match="join into one only with readout = 'integrator' and without learn"):
            build(RSNNSpec, {**keys, "training": {"members": 2}}, source="a spec")


def test_a_layer_that_would_be_too_large_or_unequal_is_refused():
    with pytest.raises(InputError, match=f"join into one of {MOST_HIDDEN + 2}, and {MOST_HIDDEN} is the most"):
        build(RSNNSpec, {**TRAINED, "hidden": MOST_HIDDEN // 2 + 1, "training": {"members": 2}}, source="a spec")
    with pytest.raises(InputError, match="not divisible into 4 equal blocks"):
        build(RSNNSpec, {"hidden": 6, "recurrent_blocks": 4}, source="a spec")
    with pytest.raises(InputError, match="recurrent_blocks: has no effect with model = 'snn'"):
        RSNN(2, 2, hidden=6, model="snn", recurrent_blocks=2, sampling_rate_Hz=1000.0)


# --- training ---


def trains():
    """Two classes that fire on different afferents."""
    labels = np.arange(24) % 2
    rates = np.where(labels[:, None] == np.array([[0, 0, 1, 1]]), 0.3, 0.1)
    rasters = np.random.default_rng(0).random((24, 40, N_IN)) < rates[:, None]
    names = ("SA-I a", "SA-I b", "RA-I a", "RA-I b")
    return from_rasters(rasters, 1000.0, names, pd.DataFrame({"label": [("felt", "silk")[i] for i in labels]}))


def spec_of(**keys) -> RSNNSpec:
    return build(RSNNSpec, override(TRAINED, keys), source="a spec")


@pytest.fixture(scope="module")
def fitted() -> tuple[trainer.Trained, tasks.Sides, list[Checkpoint]]:
    kept: list[Checkpoint] = []
    done, sides = trainer.fit(trains(), spec_of(), TASK, (3, 4), keep=kept.append)
    return done, sides, kept


def test_each_member_is_a_training_of_its_own(fitted):
    done, sides, _ = fitted
    given = [seeds.of_member((3, 4), number) for number in (1, 2, 3)]
    assert given[0] == (3, 4)
    alone_trained = [trainer.fit(trains(), spec_of(**{"training.members": 1}), TASK, each)[0] for each in given]
    whole = joined([each.network for each in alone_trained])
    for ours, theirs in zip(done.network.state_dict().values(), whole.state_dict().values(), strict=True):
        assert torch.equal(ours, theirs)
    assert done.network.spec == whole.spec
    found = done.network.spec
    assert (found.hidden, found.recurrent_blocks, found.training.members) == (15, 3, 1)
    log = done.training.table()
    assert log.columns.tolist() == list(epochs.Epoch._fields)
    for number, each in enumerate(alone_trained, 1):
        own = log[log["member"] == number].drop(columns="member").reset_index(drop=True)
        pd.testing.assert_frame_equal(own, each.training.table())
    found = done.network.infer(sides.validation.spikes).labels
    right = float((found == sides.validation.labels).double().mean())
    assert done.training.best.validation_accuracy == pytest.approx(right)
    assert done.training.best.member == epochs.JOINED
    assert "3 networks joined" in repr(done.training)


def test_an_interrupted_training_goes_on_from_any_epoch_of_any_member(fitted, tmp_path):
    done, _, kept = fitted
    net = epoch_checkpoint.Net(spec_of(), N_IN, 2)
    assert len(kept) == 3 * N_EPOCHS
    assert [len(each.finished) for each in kept] == [0] * N_EPOCHS + [1] * N_EPOCHS + [2] * N_EPOCHS
    for latest in kept:
        epoch_checkpoint.save(latest, tmp_path / "c", "one")
        again = epoch_checkpoint.load(tmp_path / "c", net, "one")
        assert again.epochs == latest.epochs
        resumed, _ = trainer.fit(trains(), spec_of(), TASK, (3, 4), start=again)
        assert resumed.training == done.training
        for ours, theirs in zip(resumed.network.parameters(), done.network.parameters(), strict=True):
            assert torch.equal(ours, theirs)


def test_a_checkpoint_whose_members_are_not_numbered_is_refused(fitted, tmp_path):
    _, _, kept = fitted
    net = epoch_checkpoint.Net(spec_of(), N_IN, 2)
    latest = kept[2 * N_EPOCHS - 1]
    for wrong in (latest.epochs[1:], tuple(each._replace(member=2) for each in latest.epochs)):
        epoch_checkpoint.save(replace(latest, epochs=wrong), tmp_path / "c", "one")
        with pytest.raises(InputError, match="does not number the epochs"):
            epoch_checkpoint.load(tmp_path / "c", net, "one")
    few = net._replace(spec=spec_of(**{"training.members": 1}))
    epoch_checkpoint.save(latest, tmp_path / "c", "one")
    with pytest.raises(InputError, match="where 1 to 3 are possible"):
        epoch_checkpoint.load(tmp_path / "c", few, "one")


def test_a_run_is_interrupted_in_its_second_member_and_leaves_what_a_whole_one_leaves(tmp_path, monkeypatch):
    save_spikes(trains(), tmp_path / "spikes.h5")
    told: list[str] = []
    resumable.run(tmp_path / "spikes.h5", tmp_path / "whole", spec_of(), TASK, tell=told.append)
    assert told == [*recipe.described(spec_of(), SEEN)] != []
    with stopped_after(N_EPOCHS + 1, monkeypatch):
        resumable.run(tmp_path / "spikes.h5", tmp_path / "cut", spec_of(), TASK)
    resumable.run(tmp_path / "spikes.h5", tmp_path / "cut", spec_of(), TASK, resume=True)
    whole, cut = ({p.name: p.read_bytes() for p in (tmp_path / name).iterdir()} for name in ("whole", "cut"))
    assert whole == cut
    extra = json.loads(whole["network.json"])["extra"]
    assert extra["joined"] == {"networks": 3, "hidden": 5}
    assert json.loads(whole["network.json"])["spec"]["hidden"] == 15
    row = json.loads(whole["result.json"])["row"]
    assert (row["members"], row["recurrent_blocks"], row["epochs"]) == (3, 3, 3 * N_EPOCHS)
    assert run_folder.restore(tmp_path / "whole").network.spec.recurrent_blocks == 3


@pytest.mark.parametrize("stopped", [False, True])
def test_a_trial_of_a_search_trains_and_counts_all_members(stopped, monkeypatch):
    space = {"hidden": {"_type": "choice", "_value": [5]}}
    found = trains()
    problem = search.problem_of(found, SearchSpec(space=space, trials=1), spec_of(), TASK)
    median = MedianStop(start_epoch=1)
    monkeypatch.setattr(MedianStop, "stops", lambda *_: stopped)
    sides = tasks.sides_of(found, TASK)
    trial = search.try_network(search.Job(problem, Proposal(0, {"hidden": 5}), median), found, sides)
    assert len(trial.epochs) == (1 if stopped else 3 * N_EPOCHS)
    assert trial.sops >= 15 * float(sides.validation.spikes.sum(dim=(1, 2)).double().mean())
    if not stopped:
        best, _ = search.train_best(problem, found, trial)
        assert best.network.spec.hidden == 15
        assert best.training.best.validation_accuracy == trial.accuracy


def test_one_training_of_one_network_refuses_members():
    net = RSNN(N_IN, 2, spec_of(), 1000.0, backend="reference")
    side = Examples(spikes(n_trials=4), torch.arange(4) % 2)
    with pytest.raises(InputError, match=r"training\.members: this trains one network"):
        epochs.train(net, side, side, generator=torch.Generator())


@each_backend
def test_blocks_stay_apart_in_training_and_pruning_takes_a_share_of_what_exists(backend):
    spec = spec_of(**{"training.members": 1, "hidden": 6, "recurrent_blocks": 3, "recurrent_weight_scale": 1.0})
    net = RSNN(N_IN, 2, spec, 1000.0, backend=backend, generator=torch.Generator().manual_seed(0))
    within, before = net.within_blocks(), net.w_rec.detach().clone()
    assert int(within.sum()) == int(before.count_nonzero()) == 12
    side = Examples(spikes(n_trials=16), torch.arange(16) % 2)
    epochs.train(net, side, side, generator=torch.Generator().manual_seed(1))
    assert not net.w_rec[~within].any()
    assert not torch.equal(net.w_rec, before)
    prune(net, 0.5)
    assert int(net.w_rec.count_nonzero()) == 6


def test_fine_tuning_leaves_the_blocks_of_a_joined_network_apart():
    whole = joined([network(k, recurrent_weight_scale=0.5) for k in range(3)])
    side = Examples(spikes(n_trials=16), torch.arange(16) % 2)
    grids = fine_tuning.grids_of(whole, Steps(0.05, 0.05, 0.05), weight_bits=6)
    before = whole.w_rec.detach().clone()
    fine_tuning.train_rounded(whole, side, side, grids, generator=torch.Generator().manual_seed(0), epochs=3)
    assert not whole.w_rec[~whole.within_blocks()].any()
    assert not torch.equal(whole.w_rec, before)


def test_rates_of_blocks_are_those_of_the_synapses_that_exist():
    keys = {"training.members": 1, "training.relative_learning_rate": 0.1, "recurrent_blocks": 5}
    net = RSNN(N_IN, 2, spec_of(**keys), 1000.0, generator=torch.Generator().manual_seed(0))
    of_blocks = net.w_rec.detach()[net.within_blocks()].square().mean().sqrt()
    assert epochs.rates_of(net)["w_rec"] == pytest.approx(0.1 * float(of_blocks))


# --- effort ---

SEEN = recipe.Seen(900, 1000, 1000.0, 50.0)


def test_effort_sets_steps_and_members_and_given_keys_stay():
    quick, usual, best = (
        recipe.resolve(RSNNSpec(recipe="default", hidden=50, effort=effort), SEEN)
        for effort in ("quick", "default", "best")
    )
    assert usual == recipe.resolve(RSNNSpec(recipe="default", hidden=50), SEEN)
    assert (usual.training.members, best.training.members) == (1, 3)
    assert 3 * quick.training.epochs == pytest.approx(usual.training.epochs, abs=2)
    same = {"training": usual.training}
    assert quick.model_copy(update=same) == best.model_copy(update=same) == usual
    assert recipe.resolve(spec_of(recipe="default"), SEEN).training.members == 3


def test_effort_is_of_the_recipe_alone():
    for keys in ({"effort": "best"}, {"effort": "default"}):
        with pytest.raises(InputError, match="effort has no effect without a recipe"):
            build(RSNNSpec, keys, source="a spec")
    for effort, key in (("quick", "epochs"), ("best", "members")):
        table = {"recipe": "default", "effort": effort, "training": {key: 1}}
        with pytest.raises(InputError, match=rf"effort = '{effort}' has no effect beside training\.{key}"):
            build(RSNNSpec, table, source="a spec")
    with pytest.raises(InputError, match="join into one only with readout = 'integrator'"):
        build(RSNNSpec, {"recipe": "default", "effort": "best", "readout": "count"}, source="a spec")


def test_what_an_effort_costs_is_told():
    best = [*recipe.described(RSNNSpec(recipe="default", hidden=50, effort="best"), SEEN)]
    assert best[-1] == (
        "3 networks of 50 neurons are joined into one of 150: up to 3 times the training time, and 3 times the SOPs "
        "and energy"
    )
    assert any(line.startswith("training.members = 3 (") and "effort = 'best'" in line for line in best)
    quick = [*recipe.described(RSNNSpec(recipe="default", effort="quick"), SEEN)]
    assert any(line.startswith("training.epochs = ") and "effort = 'quick'" in line for line in quick)


def test_a_classifier_takes_an_effort():
    found, keys = trains(), {"effort": "best", "training.epochs": 2}
    windows = nt.windows(found, nt.Window(length_ms=40))
    classifier = nt.SpikingClassifier(hidden=4, settings=keys, random_state=0).fit(windows.X, windows.y)
    assert classifier.network_.spec.hidden == 12
    assert classifier.training_.n_members == 3
    assert classifier.sops(windows.X).input.tolist() == (12 * np.asarray(windows.X).sum(axis=(1, 2))).tolist()
    with pytest.raises(InputError, match="effort has no effect without a recipe"):
        nt.SpikingClassifier(network="rsnn", settings={"effort": "best"}, sampling_rate_Hz=1000.0).fit(
            np.asarray(windows.X), windows.y
        )
