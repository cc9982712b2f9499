"""A torch module of another package as a network: it trains, resumes, exits, is saved; its costs are not counted."""

import json
import math

import numpy as np
import pandas as pd
import pytest
import torch
from neurotact_parts.networks.search.journal import Trial, beside_given
from neurotact_parts.networks.search.search import _is_consistent
from neurotact_parts.studies.texture.shortened import cut_short, exit_curve
from test_plugins import package  # noqa: F401

import neurotact as nt
from neurotact import spec as spec_room
from neurotact.data import hdf5
from neurotact.data.spikes import from_rasters
from neurotact.errors import InputError
from neurotact.metrics import synops
from neurotact.metrics.fronts import pareto_front
from neurotact.networks.definition import module
from neurotact.networks.definition.recipe import has_key
from neurotact.networks.definition.space import SearchSpec
from neurotact.networks.definition.specs import RSNNSpec, void_keys
from neurotact.networks.exit.rule import ExitRule
from neurotact.networks.exit.truncated import simulate_windows
from neurotact.networks.training import epoch_checkpoint
from neurotact.networks.training.comparison import costs
from neurotact.networks.training.epochs import Examples, train
from neurotact.networks.training.run_folder import load_network as load
from neurotact.networks.training.run_folder import save_network as save
from neurotact.networks.use import ledger
from neurotact.networks.use.measuring import synops_of
from neurotact.report.answer import Decision, Network, Trials
from neurotact.report.wording import count

STRANGER = """
from torch import nn
from neurotact.networks.definition.parts import Counted, NetworkPart
from neurotact.spec import Spec

class Keys(Spec):
    units: int = 5
    dropout: float = 0.3

class Gru(nn.Module):
    def __init__(self, keys, sizes):
        super().__init__()
        self.gru = nn.GRU(sizes.n_inputs, keys.units, batch_first=True)
        self.drop, self.out = nn.Dropout(keys.dropout), nn.Linear(keys.units, sizes.n_classes)
    def forward(self, spikes):
        return self.out(self.drop(self.gru(spikes)[0])) / 10
GRU = NetworkPart("A GRU.", Keys, Gru)

class Counts(Gru):
    def counted(self, spikes):
        return Counted(self(spikes), None, {"input": 2 * spikes.sum(dim=2), "between": spikes.sum(dim=2)})
COUNTS = NetworkPart("A GRU that counts.", Keys, Counts)

class Seer(Gru):
    def forward(self, spikes):
        return super().forward(spikes.flip(1)).flip(1)
SEER = NetworkPart("It sees later spikes.", Keys, Seer)

class Last(Gru):
    def forward(self, spikes):
        return super().forward(spikes)[:, -1]
LAST = NetworkPart("It gives one score a window.", Keys, Last)
NO_MODULE = NetworkPart("", Keys, lambda keys, sizes: 3)
NO_WEIGHTS = NetworkPart("", Keys, lambda keys, sizes: nn.Identity())
NO_SPEC = NetworkPart("", dict, Gru)
class Taken(Spec):
    training: int = 0
TAKEN = NetworkPart("", Taken, Gru)
"""
NAMES = ("GRU", "COUNTS", "SEER", "LAST", "NO_MODULE", "NO_WEIGHTS", "NO_SPEC", "TAKEN")
TRAINING = {"epochs": 3, "batch": 4, "rate_penalty": 0.0}


@pytest.fixture(autouse=True)
def _strangers(package):  # noqa: F811
    package({"networks": "\n".join(f"{name.lower()} = my_skin:{name}" for name in NAMES)}, STRANGER)


def examples(seed: int = 0, n: int = 24) -> Examples:
    rng = np.random.default_rng(seed)
    labels = torch.from_numpy(rng.integers(0, 2, n))
    rates = torch.tensor([0.1, 0.5])[labels][:, None, None]
    return Examples((torch.from_numpy(rng.random((n, 30, 4))) < rates).to(torch.uint8), labels)


def made(model: str = "gru", **keys) -> module.ModuleNetwork:
    spec = RSNNSpec(**{"model": model, "training": TRAINING, **keys})
    return module.new(4, 2, spec, 1000.0, generator=torch.Generator().manual_seed(1))  # pyright: ignore


def test_a_stranger_trains_and_resumes_to_the_same_weights_whatever_torch_drew(tmp_path):
    kept, nets = [], []
    for number in range(2):
        torch.manual_seed(number)  # its initial weights and its drop-out come from the seeds of the training
        nets.append(made())
        start = None
        if number:
            path, net = tmp_path / "c", epoch_checkpoint.Net(nets[0].spec, 4, 2)
            epoch_checkpoint.save(kept[0], path, "mine")
            start = epoch_checkpoint.load(path, net, "mine")
        order = torch.Generator().manual_seed(0)
        done = train(nets[-1], examples(), examples(1), generator=order, start=start, keep=kept.append)
        assert [epoch.epoch for epoch in done.epochs] == [1, 2, 3]
    for name, tensor in nets[0].state_dict().items():
        assert torch.equal(tensor, nets[1].state_dict()[name])
    assert kept[0].weights.keys() == nets[0].state_dict().keys()
    before = torch.get_rng_state()
    nets[0].counts_in_training(examples().spikes, torch.Generator().manual_seed(0))
    assert torch.equal(before, torch.get_rng_state())


def test_a_checkpoint_of_a_stranger_with_another_tensor_is_refused(tmp_path):
    kept = []
    train(made(), examples(), examples(1), generator=torch.Generator().manual_seed(0), keep=kept.append)
    epoch_checkpoint.save(kept[0], tmp_path / "c", "mine")
    with pytest.raises(InputError, match=r"'weights\.module\.gru\.weight_ih_l0' is .* where .* is expected"):
        epoch_checkpoint.load(tmp_path / "c", epoch_checkpoint.Net(made(units=7).spec, 4, 2), "mine")


def test_a_stranger_exits_where_the_scores_so_far_say_so():
    network, spikes = made(), examples().spikes
    scores = network.module.eval()(spikes.float()).double().detach()
    whole = network.infer(spikes)
    torch.testing.assert_close(whole.readout, scores.sum(dim=1))
    early = network.infer(spikes, ExitRule(3))
    leading = scores.cumsum(dim=1).argmax(dim=2)
    for trial, steps in enumerate(early.steps.tolist()):
        runs = [k for k in range(3, 30) if len(set(leading[trial, k - 3 : k + 1].tolist())) == 1]
        assert steps == (runs[0] + 1 if runs else 30)
        assert early.labels[trial] == leading[trial, steps - 1]
        assert early.input_spikes[trial] == spikes[trial, :steps].sum()


def test_what_a_stranger_does_not_count_is_not_counted():
    network, sides = made(), examples()
    decided = network.infer(sides.spikes)
    assert decided.hidden_spikes.isnan().all()
    found = synops_of(decided, network)
    assert all(np.isnan(part).all() for part in found)
    assert repr(found) == "Synops(24 windows; not counted)"
    windows = simulate_windows(network, sides)
    rows = [*cut_short(network, windows, [10.0]), *exit_curve(network, windows, windows, [3])]
    assert all(math.isnan(row["sops_total"]) for row in rows)
    row = {"sops_total": None, "exit_sops_total": None, "window_steps": 30, "exit_steps": 9, "exit_accuracy": 1.0}
    assert costs(row, 1.0).endswith("9 ms, at 100.0 %; SOPs are not counted")
    assert count(math.nan) == "not counted"
    assert not ledger.is_counted(network.spec)
    with pytest.raises(InputError, match="network: the cost of 'gru' is not counted"):
        ledger.network_cost(network.spec, 4, 2, {}, steps=30, signal_ms=30.0)


def test_what_a_stranger_counts_is_summed_until_the_exit():
    network, spikes = made("counts"), examples().spikes
    for rule in (ExitRule(), ExitRule(3)):
        decided = network.infer(spikes, rule)
        found = synops_of(decided, network)
        assert found.input.tolist() == (2 * decided.input_spikes).tolist()
        assert found.total.tolist() == (3 * decided.input_spikes).tolist()
        assert found.readout.tolist() == [0] * len(spikes)
    table = synops.table_of(found, ["a"] * 24, ["a"] * 24, decided.steps.numpy(), decided.input_spikes.numpy(),
                            decided.hidden_spikes.numpy())  # fmt: skip
    assert table["sops_total"].tolist() == found.total.tolist()
    assert table["hidden_spikes"].isna().all()


def test_a_stranger_is_saved_without_pickle_and_read_back(tmp_path):
    network = made(units=6, step_ms=2.0)
    save(network, tmp_path / "run")
    again, _ = load(tmp_path / "run")
    assert sorted(path.name for path in (tmp_path / "run").iterdir()) == ["network.json", "weights.safetensors"]
    assert json.loads((tmp_path / "run" / "network.json").read_text())["spec"]["units"] == 6
    assert torch.equal(again.infer(examples().spikes).readout, network.infer(examples().spikes).readout)


def test_a_stranger_is_trained_and_used_from_a_file(tmp_path):
    side = examples(n=60)
    X, y = side.spikes.numpy(), np.array(["soft", "hard"])[side.labels]
    spec = tmp_path / "mine.toml"
    spec.write_text('model = "gru"\nrecipe = "default"\nunits = 6\n')
    model = nt.SpikingClassifier(network=spec, epochs=20, sampling_rate_Hz=1000.0, random_state=0).fit(X, y)
    assert model.network_.spec.own.units == 6
    assert model.network_.spec.training.schedule == "cosine"
    assert model.score(X, y) > 0.8
    assert model.decide(X)["sops_total"].isna().all()
    with pytest.warns(UserWarning, match="the cost of the network 'gru' is not counted"):
        assert "network" not in {*model.costs(X).get("name", [])}


@pytest.mark.parametrize(
    ("model", "said"),
    [
        ("seer", "gives scores that depend on later spikes"),
        ("last", r"gives \(8, 2\) where scores \(batch, time, class\) = \(8, 30, 2\) are expected"),
        ("no_module", "gives a int where a torch.nn.Module is expected"),
        ("no_weights", "gives a module without weights to train"),
        ("no_spec", "has keys that are not a Spec"),
        ("taken", "has a key 'training', which every network has"),
    ],
)
def test_a_network_that_cannot_be_used_is_named_with_its_package(model, said):
    with pytest.raises(InputError, match=f"networks: '{model}' of the package my-skin .* {said}"):
        made(model).begin(examples(n=8).spikes, torch.Generator())


def test_keys_without_an_effect_are_named():
    voids = void_keys(made().spec)
    assert "training.rate_penalty" not in voids  # it is 0
    heavy = {"training": {**TRAINING, "rate_penalty": 0.1}}
    assert {"training.readout_dropout", "training.rate_penalty"} <= void_keys(made(**heavy).spec).keys()
    assert "training.rate_penalty" not in void_keys(made("counts", **heavy).spec)


@pytest.mark.parametrize("hidden", [None, [4, 3]])
def test_a_stream_and_c_and_nir_and_chips_refuse_it_in_a_sentence(hidden):
    keys = {"hidden": hidden} if hidden else {"model": "gru"}
    spec = RSNNSpec.model_validate({**keys, "training": TRAINING})
    side = examples(n=40)
    X, y = side.spikes.numpy(), np.array(["soft", "hard"])[side.labels]
    model = nt.SpikingClassifier(network=spec, sampling_rate_Hz=1000.0, random_state=0).fit(X, y)
    what = "several layers, or a graph" if hidden else "network of another model"
    for executor in (nt.to_snntorch, nt.to_nir, lambda one: nt.check_chip(one, "loihi2")):
        if hidden and executor is nt.to_nir:
            continue  # which has nodes for them
        with pytest.raises(InputError, match=rf"^{what}: .*; train with model = 'rsnn' or 'snn'$"):
            executor(model)


def test_no_network_without_a_counted_cost_is_the_cheapest():
    decision = Decision(0.9, math.nan, 300.0, 20.0, None)
    network = Network("5&5", 0, 1, 0.9, decision, None, is_part=True)
    assert network.way(Trials(10, 10)).cost == math.inf
    assert network.name == "5&5 ms with the network"
    assert pareto_front(np.array([math.nan, 2.0]), np.array([0.99, 0.9])).tolist() == [False, True]


def test_a_search_takes_accuracy_alone_where_operations_are_not_counted():
    space = {"units": {"_type": "choice", "_value": [4]}}
    uncounted = Trial(0, {"units": 4}, [0.5], "finished", 0.5, None, 0.5)
    assert Trial(**json.loads(uncounted.line())) == uncounted
    assert _is_consistent(uncounted, SearchSpec(space=space))
    assert not _is_consistent(uncounted, SearchSpec(space=space, max_sops=10.0))
    assert "SOPs not counted" in beside_given([uncounted, Trial(1, {}, [0.7], "finished", 0.7, None, 0.7)])


def test_the_cost_of_layers_by_hand():
    # 4 afferents, 6 and 4 neurons, 2 classes; 10 steps, in each of which a neuron takes two MACs.
    spec = RSNNSpec(hidden=[6, 4])
    measured = {"sops_input": 30.0, "sops_readout": 20.0, "sops_total": 90.0, "sops_total_feedforward": 90.0}
    measured |= {"input_spikes": 5.0, "hidden_spikes": 20.0}
    spent = ledger.network_cost(spec, 4, 2, measured, steps=10, signal_ms=10.0)
    assert (spent.macs, spent.acs, spent.sops, spent.parameters) == (2 * 10 * 10, 90, 90, 4 * 6 + 6 * 4 + 4 * 2 + 2)
    assert spent.buffers_accesses == 2 * (5 + 10 + 10)
    row = {ledger.OWN_KEYS: made("counts", units=7).spec.own_keys, "hidden": 0}
    assert ledger.spec_of_row(RSNNSpec(), row).own.units == 7
    assert not ledger.is_row_counted(RSNNSpec(), row)


def test_initial_weights_come_from_the_seed_alone():
    torch.manual_seed(3)
    first = made().state_dict()
    torch.manual_seed(4)
    for name, tensor in made().state_dict().items():
        assert torch.equal(tensor, first[name])


def test_operations_are_cut_short_with_the_window():
    network, sides = made("counts"), examples()
    (row,) = cut_short(network, simulate_windows(network, sides), [10.0])
    assert row["sops_total"] == pytest.approx(3 * float(sides.spikes[:, :10].sum()) / len(sides.labels))


def test_a_run_says_null_and_a_search_that_weighs_operations_is_refused(tmp_path):
    side = examples(n=60)
    labels = pd.DataFrame({"label": np.array(["soft", "hard"])[side.labels]})
    trains = from_rasters(side.spikes.numpy(), 1000.0, ("a", "b", "c", "d"), labels)
    hdf5.save_spikes(trains, tmp_path / "spikes.h5")
    spec = tmp_path / "mine.toml"
    spec.write_text('model = "gru"\nrecipe = "default"\ntraining.epochs = 2\n')
    nt.train(tmp_path / "spikes.h5", tmp_path / "run", network=spec)
    row = json.loads((tmp_path / "run" / "result.json").read_text())["row"]
    assert (row["sops_total"], row["exit_sops_total"], row["input_spikes"] > 0) == (None, None, True)
    assert nt.infer(tmp_path / "run", tmp_path / "spikes.h5")["sops_total"].isna().all()
    with pytest.raises(InputError, match="none of 2 trials finished; trial 0: its SOPs are not counted"):
        nt.tune(
            tmp_path / "spikes.h5",
            tmp_path / "tuned",
            network=spec,
            search=nt.Search(trials=2, objective="accuracy-sops"),
        )
    assert not has_key(made().spec, "training.readout_dropout")


@pytest.mark.parametrize("what", ["default", "rsnn", "layered", RSNNSpec(hidden=7)])
def test_another_model_leaves_out_the_keys_that_it_does_not_have_and_says_so(what, caplog):
    """Those of the spec; one that is given with it is refused."""
    spec_room._say_left_out.cache_clear()
    changed = spec_room.resolve(RSNNSpec, what, {"model": "gru", "units": 4, "training.epochs": 2})
    assert (changed.model, changed.own.units, changed.training.epochs) == ("gru", 4, 2)
    said = "model = 'gru' has keys of its own: left out from the spec: hidden" in caplog.text.replace("recipe, ", "")
    assert said == (what != "default")  # which gives no number of neurons
    again = spec_room.resolve(RSNNSpec, changed, {"model": "gru", "units": 6})
    assert again.own.units == 6
    with pytest.raises(InputError, match="hidden: unknown key"):
        spec_room.resolve(RSNNSpec, what, {"model": "gru", "hidden": 4})
    assert spec_room.resolve(RSNNSpec, "default", {"model": "snn"}).recipe == "default"
