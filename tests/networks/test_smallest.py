"""The training of a network without a hidden layer, and what uses it."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from levels import examples
from sklearn.linear_model import LogisticRegression

import neurotact as nt
from neurotact.errors import InputError
from neurotact.networks.definition import initial, recipe
from neurotact.networks.definition.recipe import Seen
from neurotact.networks.definition.rsnn import RSNN
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.networks.training import (
    ensemble,
    epoch_checkpoint,
    epochs,
    linear,
    ranges,
    sparsity,
)
from neurotact.networks.training.epochs import Examples


def timed(seed: int, n: int = 160, n_classes: int = 4, n_steps: int = 160) -> Examples:
    """Classes that differ only in when an afferent is busy: each in its own part of the window."""
    generator = torch.Generator().manual_seed(seed)
    labels = torch.arange(n) % n_classes
    busy = (torch.arange(n_steps) * n_classes // n_steps)[None, :] == labels[:, None]
    rates = torch.stack([torch.where(busy, 0.3, 0.05), torch.full(busy.shape, 0.1)], dim=2)
    return Examples((torch.rand(rates.shape, generator=generator) < rates).to(torch.uint8), labels)


def fitted(seen: Examples, held: Examples, **keys) -> RSNN:
    spec = recipe.chosen_for(RSNNSpec(recipe="default", hidden=0, **keys), seen.spikes, 1000.0)
    net = RSNN(seen.spikes.shape[2], int(seen.labels.max()) + 1, spec, 1000.0)
    linear.train(net, seen, held)
    return net


def accuracy(net: RSNN, side: Examples) -> float:
    return float((net.infer(side.spikes).labels == side.labels).double().mean())


def test_what_the_bins_say_is_learned_and_one_bin_does_not_say_it():
    seen, held, test = timed(0), timed(1), timed(2)
    assert accuracy(fitted(seen, held), test) > 0.95
    assert accuracy(fitted(seen, held, readout_stretches=1), test) < 0.6


@pytest.mark.parametrize("n_bins", [4, 10, 40])
def test_it_is_as_good_as_regression_on_bins(n_bins):
    """Beyond chance, of the few windows that either has right alone."""
    seen, held, test = timed(0), timed(1), timed(2, 400)
    net = fitted(seen, held)
    binned = [side.spikes.view(len(side.labels), n_bins, -1, 2).sum(dim=2).flatten(1).numpy() for side in (seen, test)]
    its = LogisticRegression(max_iter=1000).fit(binned[0], seen.labels).predict(binned[1]) == test.labels.numpy()
    ours = (net.infer(test.spikes).labels == test.labels).numpy()
    lost, gained = int((its & ~ours).sum()), int((ours & ~its).sum())
    assert lost - gained <= 2 * (lost + gained) ** 0.5


@given(st.integers(1, 9), st.integers(2, 4), st.integers(0, 99))
@examples(20)
def test_its_scores_are_those_of_the_regression_that_was_fitted(n_stretches, n_classes, seed):
    seen = timed(seed, 40, n_classes, 36)
    keys = {"readout_stretches": n_stretches, "readout_stretch_ms": 4.0} if n_stretches > 1 else {}
    training = {"temperature": 0.5}
    table = {"hidden": 0, "readout": "integrator", "training": training, **keys}
    net = RSNN(2, n_classes, RSNNSpec.model_validate(table), 1000.0, dtype=torch.float64)
    best = linear.train(net, seen, seen).best
    counts = linear._counts(net, seen)
    levels = linear._levels(n_stretches)
    spread = np.sqrt(counts.var(axis=0).mean() * len(levels))
    summed = np.einsum("nka,kl->nla", (counts - counts.mean(axis=0)) / spread, levels).reshape(40, -1)
    own = LogisticRegression(C=linear.INVERSE_PENALTIES[best.epoch - 1], max_iter=200, tol=1e-3)
    expected = own.fit(summed, seen.labels).predict_proba(summed)
    scores = net.infer(seen.spikes).readout.detach() * 0.5
    np.testing.assert_allclose(scores.softmax(dim=1).numpy(), expected, atol=1e-9)


def test_the_best_penalty_on_validation_windows_stays():
    seen, held = timed(0, 24), timed(1)
    spec = recipe.chosen_for(RSNNSpec(recipe="default", hidden=0), seen.spikes, 1000.0)
    net, told = RSNN(2, 4, spec, 1000.0), []
    done = linear.train(net, seen, held, progress=told.append)
    assert [*done.epochs] == told
    assert done.best.validation_accuracy == max(epoch.validation_accuracy for epoch in told)
    assert accuracy(net, held) == done.best.validation_accuracy
    assert len({epoch.validation_loss for epoch in told}) == len(linear.INVERSE_PENALTIES)


def test_weights_of_windows_count_and_a_class_without_windows_is_never_chosen():
    seen = timed(0)
    contradicted = Examples(torch.cat([seen.spikes] * 2), torch.cat([seen.labels, (seen.labels + 1) % 4]))
    weights = torch.cat([torch.full((160,), 1.99), torch.full((160,), 0.01)])
    net = RSNN(2, 5, fitted(seen, seen).spec, 1000.0)
    linear.train(net, contradicted._replace(weights=weights), seen)
    assert accuracy(net, seen) > 0.95
    assert (net.infer(seen.spikes).labels != 4).all()


def test_seeds_change_nothing_and_training_enters_by_the_usual_door():
    seen, held = timed(0), timed(1)

    def new(spec, seeds):
        weights, order = (torch.Generator().manual_seed(seed) for seed in seeds)
        return RSNN(2, 4, spec, 1000.0, generator=weights), order

    spec = recipe.chosen_for(RSNNSpec(recipe="default", hidden=0, effort="best"), seen.spikes, 1000.0)
    nets = [ensemble.train(new, spec, seeds, seen, held)[0] for seeds in ((0, 1), (2, 3))]
    assert all(torch.equal(a, b) for a, b in zip(nets[0].parameters(), nets[1].parameters(), strict=True))
    assert ranges.record_states(nets[0], seen.spikes) == (0.0, 0.0)


def test_a_classifier_without_a_hidden_layer_decides_early_and_costs_its_operations():
    seen, test = timed(0), timed(2)
    clf = nt.SpikingClassifier(hidden=0, sampling_rate_Hz=1000.0, random_state=0).fit(seen.spikes, seen.labels)
    assert clf.score(test.spikes, test.labels) > 0.9
    early = clf.decide(test.spikes, early_exit=True)
    assert (early["sops_readout"] == 4 * early["input_spikes"]).all()
    assert not early[["sops_input", "sops_recurrent", "hidden_spikes"]].any(axis=None)
    spent = clf.costs(test.spikes).iloc[0]
    assert (spent["macs"], spent["sops"]) == (0, clf.sops(test.spikes).total.mean())
    with pytest.raises(InputError, match=r"training.epochs: has no effect without a hidden layer"):
        nt.SpikingClassifier(hidden=0, epochs=9, sampling_rate_Hz=1000.0).fit(seen.spikes, seen.labels)


def test_the_recipe_chooses_only_what_a_fit_has():
    seen = Seen(900, 1000, 1000.0, 50.0)
    spec = RSNNSpec(recipe="default", hidden=0)
    assert [choice.key for choice in recipe.choices(seen, spec.model_dump(mode="json"))] == [
        "model", "step_ms", "readout", "readout_stretches", "readout_stretch_ms",
    ]  # fmt: skip
    assert recipe.resolve(spec, seen).readout_stretches == linear_stretches(1000)
    with pytest.raises(InputError, match="nothing to search"):
        recipe.space(spec, seen)


def linear_stretches(bins: int) -> int:
    """Of equal length, at most 32."""
    return max(n for n in range(1, 33) if -(-bins // -(-bins // n)) == n)


def either_alone(seed: int, n: int = 160) -> Examples:
    """Two classes: one of the two afferents is busy, or both or none, which no sum of their spikes can tell."""
    generator = torch.Generator().manual_seed(seed)
    busy = torch.stack([torch.arange(n) % 2, torch.arange(n) // 2 % 2], dim=1)
    rates = torch.where(busy.bool(), 0.6, 0.03)[:, None].expand(n, 40, 2)
    return Examples((torch.rand(rates.shape, generator=generator) < rates).to(torch.uint8), busy.sum(dim=1) % 2)


LADDER = {
    "model": "snn", "hidden": 8, "readout": "integrator", "direct": "auto", "input_deviation": 1.0,
    "training": {"epochs": 12, "batch": 20, "relative_learning_rate": 0.1, "keep": "both"},
}  # fmt: skip


def from_the_smallest(seen: Examples, held: Examples, table: dict | None = None, **options):
    def new(spec, seeds):
        weights, order = (torch.Generator().manual_seed(seed) for seed in seeds)
        net = RSNN(2, int(seen.labels.max()) + 1, spec, 1000.0, generator=weights)
        initial.start(net, seen.spikes, weights)
        return net, order

    return ensemble.train(new, RSNNSpec.model_validate({**LADDER, **(table or {})}), (0, 1), seen, held, **options)


@pytest.mark.parametrize("model", ["snn", "auto"])
def test_the_smallest_network_stays_where_it_has_all_and_a_layer_comes_where_it_gains(model):
    net, training = from_the_smallest(timed(0), timed(1), {"model": model})
    assert (net.spec.hidden, training.smallest_accuracy, training.layer_gain) == (0, 1.0, None)
    net, training = from_the_smallest(either_alone(0), either_alone(1), {"model": model})
    assert net.spec.hidden == 8
    assert training.layer_gain is not None
    assert training.layer_gain > 0.2
    is_all = training.best.validation_accuracy == 1
    assert (training.path_gain is None) == is_all
    assert net.spec.direct is not False or is_all or {epoch.member for epoch in training.epochs} >= {0, 1}


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("made", [timed, either_alone])
@pytest.mark.parametrize("epochs", [1, 30])
def test_the_default_network_is_never_below_its_own_linear_readout(made, seed, epochs):
    """Beyond chance, whether a layer has learned or not: the smallest stays unless a larger one clearly gains."""
    seen, held = made(seed, 120), made(seed + 10, 120)
    table = {"recipe": "default", "training": {"epochs": epochs, "patience": epochs}}
    spec = recipe.chosen_for(RSNNSpec.model_validate(table), seen.spikes, 1000.0)
    assert (spec.hidden, spec.direct) == (50, "auto")

    def new(spec, seeds):
        weights, order = (torch.Generator().manual_seed(seed) for seed in seeds)
        net = RSNN(2, int(seen.labels.max()) + 1, spec, 1000.0, generator=weights)
        initial.start(net, seen.spikes, weights)
        return net, order

    net, training = ensemble.train(new, spec, (0, 1), seen, held)
    readout = fitted(seen, held)
    ours, its = (net.infer(held.spikes).labels == held.labels, readout.infer(held.spikes).labels == held.labels)
    assert not ensemble.pays(ours, its)
    assert ours.double().mean() >= its.double().mean()
    assert training.best.validation_accuracy == accuracy(net, held)
    assert training.smallest_accuracy == accuracy(readout, held)
    assert (net.spec.hidden > 0) == bool(training.layer_gain is not None and ensemble.pays(its, ours))


def test_a_layer_that_gains_within_its_error_is_not_kept(monkeypatch):
    seen, held = either_alone(0), either_alone(1)
    monkeypatch.setattr(ensemble, "pays", lambda without, with_it: False)
    net, training = from_the_smallest(seen, held)
    assert net.spec.hidden == 0
    assert training.layer_gain is not None
    assert len(training.epochs) == len(linear.INVERSE_PENALTIES)


@pytest.mark.parametrize("path_pays", [False, True])
def test_a_training_from_the_smallest_goes_on_from_each_checkpoint(path_pays, monkeypatch, tmp_path):
    seen, held, kept = either_alone(0), either_alone(1), []
    held.labels[:4] = 1 - held.labels[:4]  # no network has all
    order = [True, path_pays]  # the layer pays, and then the path past it or not
    asked: list[int] = []

    def pays(without, with_it) -> bool:
        asked.append(0)
        return order[len(asked) - 1]

    monkeypatch.setattr(ensemble, "pays", pays)
    whole, training = from_the_smallest(seen, held, keep=kept.append)
    assert whole.spec.direct is path_pays
    assert None not in (training.smallest_accuracy, training.layer_gain, training.path_gain)
    net = epoch_checkpoint.Net(RSNNSpec.model_validate(LADDER), 2, 2)
    for place in (3, len(kept) - 2):
        epoch_checkpoint.save(kept[place], tmp_path / "last", "it")
        asked.clear()
        again, its = from_the_smallest(seen, held, start=epoch_checkpoint.load(tmp_path / "last", net, "it"))
        assert its == training
        assert all(torch.equal(a, b) for a, b in zip(whole.parameters(), again.parameters(), strict=True))


@pytest.mark.parametrize("n_classes", [2, 4])
@pytest.mark.parametrize("stretches", [1, 32])
def test_a_pruned_one_has_its_zeros_and_what_is_left_is_fitted_again(n_classes, stretches):
    seen, held = timed(0, n_classes=n_classes), timed(1, n_classes=n_classes)
    noise = (torch.rand(160, 160, 6, generator=torch.Generator().manual_seed(0)) < 0.1).to(torch.uint8)
    seen, held = (Examples(torch.cat([side.spikes, noise], dim=2), side.labels) for side in (seen, held))
    whole = fitted(seen, held, readout_stretches=stretches)
    keys = {"readout_stretches": stretches, "training": {"sparsity": 0.75}}
    spec = recipe.chosen_for(RSNNSpec(recipe="default", hidden=0, **keys), seen.spikes, 1000.0)
    net = RSNN(8, n_classes, spec, 1000.0)
    done = linear.train(net, seen, held)
    assert int((net.w_out == 0).sum()) == round(0.75 * 8 * n_classes)
    assert sum(net.synapses.values()) == net.w_out.numel() - round(0.75 * 8 * n_classes)
    sparsity.prune(whole, 0.75)
    assert done.best == done.epochs[-1]
    assert done.best.train_loss < epochs.judge(whole, seen.binned(whole))[0]
    assert len(done.epochs) == 1 + len(linear.INVERSE_PENALTIES)


def test_the_smallest_of_a_ladder_is_pruned_as_asked():
    net, _ = from_the_smallest(timed(0), timed(1), {"training": {**LADDER["training"], "sparsity": 0.5}})
    assert (net.spec.hidden, net.spec.training.sparsity, int((net.w_out == 0).sum())) == (0, 0.5, 4)
