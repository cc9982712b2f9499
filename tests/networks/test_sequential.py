"""A network stands inside `nn.Sequential`, and learns there."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from levels import examples
from torch import nn

from neurotact.errors import InputError
from neurotact.networks.definition.rsnn import RSNN

SPIKES = (torch.rand(6, 40, 3, generator=torch.Generator().manual_seed(0)) < 0.3).float()


def network(n_inputs, n_classes, seed=0, **keys):
    generator = torch.Generator().manual_seed(seed)
    strong = {"hidden": 6, "forward_weight_scale": 4.0, "sampling_rate_Hz": 500.0, **keys}
    return RSNN(n_inputs, n_classes, generator=generator, **strong)


@examples(8)
@given(st.sampled_from(["count", "integrator", "max"]), st.sampled_from(["auto", "reference"]), st.sampled_from([2, 6]))
def test_scores_are_the_readout_of_the_counts(readout, backend, step_ms):
    keys = {"readout": readout, "backend": backend, "step_ms": step_ms}
    counts, scores = network(3, 2, **keys)(SPIKES), network(3, 2, returns="scores", **keys)(SPIKES)
    assert torch.equal(scores, counts.readout)
    assert scores.any()


@pytest.mark.parametrize("backend", ["auto", "reference"])
def test_spikes_in_each_step_add_up_to_the_counts(backend):
    sent = network(3, 2, returns="spikes", backend=backend, step_ms=4)(SPIKES)
    assert sent.shape == (6, 20, 2)
    assert torch.equal(sent.sum(dim=1), network(3, 2, backend=backend, step_ms=4)(SPIKES).readout)


@pytest.mark.parametrize("backend", ["auto", "reference"])
def test_every_part_of_a_sequence_gets_a_gradient(backend):
    first = network(3, 5, returns="spikes", backend=backend)
    whole = nn.Sequential(first, network(5, 2, seed=1, returns="scores", backend=backend), nn.Linear(2, 4))
    nn.functional.cross_entropy(whole(SPIKES), torch.arange(6) % 4).backward()
    assert all(p.grad is not None and p.grad.any() for p in whole.parameters() if p.requires_grad)


def test_the_copy_on_its_own_clock_returns_the_same():
    assert network(3, 2, returns="scores", step_ms=4).on_own_clock().returns == "scores"


def test_what_a_network_cannot_return_is_refused():
    with pytest.raises(InputError, match=r"returns: .*'score'.*did you mean 'scores'"):
        network(3, 2, returns="score")
    with pytest.raises(InputError, match="returns: readout = 'integrator' sends no spikes"):
        network(3, 2, returns="spikes", readout="integrator")
