"""Magnitude pruning takes the smallest weights, which stay 0 in training, and counts what remains."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from neurotact_parts.studies.comparison.pruning import prune, pruned_stay_pruned, remaining_synops

from neurotact.errors import InputError
from neurotact.networks.definition.rsnn import RSNN
from neurotact.networks.definition.specs import RSNNSpec, TrainingSpec
from neurotact.networks.training.epochs import Examples, train
from neurotact.networks.use import measuring

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
        assert int(gone.sum()) == round(share * was.numel())
        assert torch.equal(now[~gone], was[~gone])
        if gone.any() and not gone.all():
            assert was[gone].abs().max() <= was[~gone].abs().min()


@pytest.mark.parametrize("share", [-0.1, 1.1, float("nan")])
def test_an_impossible_share_is_refused(share):
    with pytest.raises(InputError, match="share: is a share of the weights"):
        prune(network(), share)


@given(models, readouts)
def test_a_whole_network_counts_as_ever(model, readout):
    net, spikes = network(model, readout), windows()
    counted = measuring.synops_of(net.infer(spikes), net)
    for part, expected in zip(remaining_synops(net, spikes), counted, strict=True):
        assert part.tolist() == expected.tolist()


@given(models, readouts, st.floats(0.1, 0.9))
def test_remaining_operations_are_those_counted_one_by_one(model, readout, share):
    net, spikes = network(model, readout), windows()
    prune(net, share)
    hidden = net.simulate(spikes).hidden
    total = torch.zeros(len(spikes))
    for sent, weights in zip([spikes, *[hidden] * (len(net.weights) - 1)], net.weights, strict=True):
        for neuron in range(weights.shape[0]):
            total += sent[:, :, neuron].sum(dim=1) * int((weights[neuron] != 0).sum())
    assert remaining_synops(net, spikes).total.tolist() == total.tolist()


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
        assert stayed == [held] * 3
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
