"""Magnitude pruning takes the smallest weights, which stay 0 in training, at once or gradually."""

from itertools import pairwise

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from levels import examples
from made_chains import READOUTS
from neurotact_parts.exporters.c import fine_tuning
from neurotact_parts.exporters.c.formats import Steps

from neurotact.errors import InputError
from neurotact.networks.definition import module
from neurotact.networks.definition.rsnn import RSNN
from neurotact.networks.definition.specs import RSNNSpec, TrainingSpec
from neurotact.networks.training import ensemble, epochs, sparsity
from neurotact.networks.training.epochs import Epoch, Examples, best_in, is_over, train
from neurotact.networks.training.sparsity import Ramp, prune, pruned_stay_pruned

models = st.sampled_from(["rsnn", "snn"])
readouts = st.sampled_from(["count", "integrator"])


def network(model="rsnn", readout="count", seed=0, **training) -> RSNN:
    spec = RSNNSpec(
        model=model, readout=readout, hidden=9, forward_weight_scale=3.0, training=TrainingSpec(epochs=4, **training)
    )
    return RSNN(5, 3, spec, 1000.0, backend="reference", generator=torch.Generator().manual_seed(seed))


def windows(n_windows=6, n_steps=25, seed=0) -> torch.Tensor:
    return (torch.rand(n_windows, n_steps, 5, generator=torch.Generator().manual_seed(seed)) < 0.3).to(torch.uint8)


@given(st.floats(0, 1), models, st.integers(0, 5))
def test_the_smallest_weights_go_and_the_others_stay(share, model, seed):
    net = network(model, seed=seed)
    before = [weights.detach().clone() for weights in net.weights]
    prune(net, share)
    for was, now in zip(before, net.weights, strict=True):
        gone = now == 0
        assert int(gone.sum()) == min(round(share * was.numel()), was.numel() - (share < 1))
        assert torch.equal(now[~gone], was[~gone])
        if gone.any() and not gone.all():
            assert was[gone].abs().max() <= was[~gone].abs().min()


@pytest.mark.parametrize("share", [-0.1, 1.1, float("nan")])
def test_an_impossible_share_is_refused(share):
    with pytest.raises(InputError, match="share: is a share of the weights"):
        prune(network(), share)


def test_pruned_weights_stay_pruned_in_training_and_the_others_learn():
    examples = Examples(windows(12), torch.arange(12) % 3)
    for held in (True, False):
        net = network(readout="integrator", batch=4, learning_rate=0.05)
        prune(net, 0.5)
        gone = [weights == 0 for weights in net.weights]
        before = [weights.detach().clone() for weights in net.weights]
        generator = torch.Generator().manual_seed(1)
        if held:
            with pruned_stay_pruned(net):
                train(net, examples, examples, generator=generator)
        else:
            train(net, examples, examples, generator=generator)
        stayed = [bool((weights[zero] == 0).all()) for weights, zero in zip(net.weights, gone, strict=True)]
        assert all(stayed) == held
        assert all(not torch.equal(was, now) for was, now in zip(before, net.weights, strict=True))


def test_weights_learn_again_afterwards():
    net = network(readout="integrator", learning_rate=0.05)
    prune(net, 0.5)
    with pruned_stay_pruned(net):
        pass
    zeros = net.w_out == 0
    net(windows()).readout.sum().backward()
    assert net.w_out.grad is not None
    assert bool((net.w_out.grad[zeros] != 0).any())


# Sparsity in training.

KINDS = {
    "rsnn": {},
    "snn": {"model": "snn"},
    "blocks": {"recurrent_blocks": 3},
    "stretches": READOUTS["stretches"],
    "integrator": {"readout": "integrator"},
}
kinds = st.sampled_from(sorted(KINDS))
TOUCHES = Examples(windows(12), torch.arange(12) % 3)


def sparse(kind: str, n_epochs: int, share: float, **training) -> RSNN:
    keys = {"epochs": n_epochs, "batch": 4, "learning_rate": 0.05, "sparsity": share, **training}
    spec = RSNNSpec(**{"hidden": 9, "forward_weight_scale": 3.0, **KINDS[kind], "training": TrainingSpec(**keys)})
    return RSNN(5, 3, spec, 1000.0, generator=torch.Generator().manual_seed(0))


def zeros(net: RSNN) -> dict[str, torch.Tensor]:
    """The synapses that exist and have no weight."""
    parts = {"w_in": net.w_in == 0, "w_out": (net.readout_weights == 0).reshape(-1, 9, 3).all(dim=0)}
    return parts if net.w_rec is None else {**parts, "w_rec": (net.w_rec == 0) & net.within_blocks()}


def shares(net: RSNN) -> dict[str, int]:
    return {name: int(gone.sum()) for name, gone in zeros(net).items()}


def expected(net: RSNN, share: float) -> dict[str, int]:
    sizes = {"w_in": 45, "w_out": 27} | ({} if net.w_rec is None else {"w_rec": 9 * net.spec.fan_among})
    return {name: round(share * n) for name, n in sizes.items()}


@given(kinds, st.integers(1, 7), st.sampled_from([0.3, 0.75, 0.9]), st.sampled_from(["Adam", "SGD", "RMSprop"]))
@examples(10)
def test_a_training_ends_with_its_share_of_zeros_which_grows_and_never_comes_back(kind, n_epochs, share, optimiser):
    net, seen = sparse(kind, n_epochs, share, patience=1, optimiser=optimiser), []
    before = [weights.detach().clone() for weights in net.weights]

    def look(_):
        seen.append(zeros(net))

    done = train(net, TOUCHES, TOUCHES, generator=torch.Generator().manual_seed(1), progress=look)
    assert shares(net) == expected(net, share)
    for earlier, later in pairwise(seen):
        assert all(bool(later[name][gone].all()) for name, gone in earlier.items())
    ramp = Ramp.of(net.spec.training)
    for number, gone in enumerate(seen, 1):
        assert {name: int(part.sum()) for name, part in gone.items()} == expected(net, ramp.after(number))
    assert len(seen) >= ramp.end
    assert done.best.epoch >= ramp.end
    assert all(not torch.equal(was, now) for was, now in zip(before, net.weights, strict=True))


def test_the_share_is_that_of_the_cubic_schedule():
    ramp = Ramp.of(TrainingSpec(epochs=30, sparsity=0.8))
    for epoch in range(31):
        x = min(max((epoch - ramp.begin) / (ramp.end - ramp.begin), 0), 1)
        assert ramp.after(epoch) == pytest.approx(0.8 * (1 - (1 - x) ** 3))
    assert (ramp.after(ramp.begin), ramp.after(ramp.end)) == (0.0, 0.8)
    assert ramp.end <= 20


@given(kinds, st.integers(1, 5))
@examples(8)
def test_a_sparse_training_goes_on_as_one_that_was_not_interrupted(kind, stop):
    def run(**state):
        net = sparse(kind, 6, 0.7)
        done = train(net, TOUCHES, TOUCHES, generator=torch.Generator().manual_seed(1), **state)
        return done, {name: tensor.numpy().tobytes() for name, tensor in net.state_dict().items()}

    kept = []
    assert run(keep=kept.append) == run(start=kept[stop - 1])


@given(st.floats(0, 0.99), st.integers(1, 40), st.sampled_from(["loss", "accuracy", "both"]))
def test_only_an_epoch_with_the_final_share_is_kept_and_patience_counts_from_it(share, n_epochs, keep):
    spec = TrainingSpec(epochs=n_epochs, sparsity=share, patience=2, keep=keep, target_loss=0.01)
    log = [Epoch(number, 1e-4 * number, 1.0, 1e-4 * number, 1.0) for number in range(1, n_epochs + 1)]
    first = max(Ramp.of(spec).end, 1)
    assert best_in(log, spec).epoch == first
    assert [is_over(log[:n], spec) for n in range(1, n_epochs)] == [n >= first for n in range(1, n_epochs)]
    patient = spec.model_copy(update={"target_loss": 0.0})
    assert [is_over(log[:n], patient) for n in range(1, n_epochs)] == [n >= first + 2 for n in range(1, n_epochs)]


@pytest.mark.parametrize("readout", ["integrator", "stretches"])
def test_each_member_is_pruned_and_the_joined_network_has_the_share(readout):
    def new(spec, numbers):
        weights, order = (torch.Generator().manual_seed(number) for number in numbers)
        return RSNN(5, 3, spec, 1000.0, generator=weights), order

    keys = {"epochs": 3, "batch": 4, "learning_rate": 0.05, "sparsity": 0.75, "members": 3}
    spec = RSNNSpec(hidden=3, forward_weight_scale=3.0, training=TrainingSpec(**keys), **READOUTS[readout])
    whole, _ = ensemble.train(new, spec, (0, 1), TOUCHES, TOUCHES)
    assert isinstance(whole, RSNN)
    assert shares(whole) == {"w_in": 3 * round(0.75 * 15), "w_out": 3 * round(0.75 * 9), "w_rec": 3 * round(0.75 * 9)}


def test_layers_are_pruned_too():
    training = {"epochs": 3, "batch": 4, "sparsity": 0.75, "learning_rate": 0.05}
    spec = RSNNSpec.model_validate({"hidden": [6, 4], "recurrent": True, "bias": True, "training": training})
    net = module.new(5, 3, spec, 1000.0, generator=torch.Generator().manual_seed(0))
    train(net, TOUCHES, TOUCHES, generator=torch.Generator().manual_seed(1))
    matrices = [p for p in net.parameters() if p.ndim > 1]
    assert len(matrices) == 5
    assert [int((p == 0).sum()) for p in matrices] == [round(0.75 * p.numel()) for p in matrices]
    assert all(bool((p != 0).all()) for p in net.parameters() if p.ndim == 1 and p.requires_grad)


@pytest.mark.parametrize("n_epochs", [0, 1, 4])
def test_fine_tuning_keeps_zeros_and_may_keep_its_first_epoch(n_epochs, monkeypatch):
    net = sparse("integrator", 4, 0.5)
    train(net, TOUCHES, TOUCHES, generator=torch.Generator().manual_seed(1))
    gone, share = zeros(net), net.spec.training.sparsity
    losses = iter([2.0, *range(9)])
    monkeypatch.setattr(epochs, "judge", lambda *_: (next(losses), 0.5))
    monkeypatch.setattr(epochs, "evaluate", lambda *_: (9.0, 0.5))
    grids = fine_tuning.grids_of(net, Steps(0.02, 0.02, 0.02), 8)
    how = {"generator": torch.Generator().manual_seed(2), "epochs": n_epochs}
    done = fine_tuning.train_rounded(net, TOUCHES, TOUCHES, grids, **how)
    assert all(bool(zeros(net)[name][was].all()) for name, was in gone.items())
    assert done.best.epoch == (n_epochs and (1 if n_epochs == 1 else 2))
    assert net.spec.training.sparsity == share


def test_a_dense_training_prunes_nothing(monkeypatch):
    monkeypatch.setattr(sparsity, "prune", lambda *_: pytest.fail("pruned"))
    net = sparse("rsnn", 3, 0.0)
    train(net, TOUCHES, TOUCHES, generator=torch.Generator().manual_seed(1))
    assert all(bool((weights != 0).all()) for weights in net.weights)


@pytest.mark.parametrize("share", [1.0, -0.1, float("nan")])
def test_a_network_without_weights_is_refused(share):
    with pytest.raises(ValueError, match="sparsity"):
        TrainingSpec(sparsity=share)


@given(st.sampled_from([0.0, 0.5]), st.integers(1, 30), st.sampled_from(["cosine", "constant"]))
def test_a_rate_that_falls_does_so_once_pruning_has_ended(share, n_epochs, schedule):
    spec = TrainingSpec(epochs=n_epochs, sparsity=share, schedule=schedule)
    end = Ramp.of(spec).end
    left = [epochs._rate_left(spec, float(epoch)) for epoch in range(n_epochs + 1)]
    assert left[: end + 1] == [1.0] * (end + 1)
    if schedule == "cosine" and end < n_epochs:
        assert left[-1] == pytest.approx(0)
        assert sorted(left, reverse=True) == left
