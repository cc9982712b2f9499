"""Adam and the loss of a population, against PyTorch's and against those of a training alone."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from neurotact.networks.population.adam import Adam
from neurotact.networks.population.losses import Settings, losses
from neurotact.networks.population.population import Batch, Counts
from neurotact.networks.rsnn import Counts as CountsAlone
from neurotact.networks.specs import RSNNSpec, TrainingSpec
from neurotact.networks.training import loss

betas = st.tuples(st.sampled_from([0.0, 0.5, 0.9]), st.sampled_from([0.0, 0.9, 0.999]))


@given(
    betas=st.lists(betas, min_size=2, max_size=2),
    rate=st.sampled_from([1e-4, 1e-2]),
    shares=st.lists(st.sampled_from([1.0, 0.3]), min_size=8, max_size=8),
    seed=st.integers(0, 99),
)
def test_adam_is_that_of_torch_but_for_rounding(betas, rate, shares, seed):
    generator = torch.Generator().manual_seed(seed)
    start = torch.randn(2, 5, generator=generator)
    ours = Adam(start.clone(), torch.full_like(start, rate), betas)
    alone = [torch.nn.Parameter(row.clone()) for row in start]
    theirs = [torch.optim.Adam([p], lr=rate, betas=b, fused=True) for p, b in zip(alone, betas, strict=True)]
    for turn, share in enumerate(shares):
        places = [0, 1] if turn % 3 else [1]  # the first misses some turns, and has fewer steps
        gradients = torch.randn(len(places), 5, generator=generator) * 10.0 ** (turn - 4)
        ours.step(torch.tensor(places, dtype=torch.int32), gradients, torch.full((len(places),), share))
        for place, gradient in zip(places, gradients, strict=True):
            alone[place].grad = gradient.clone()
            theirs[place].param_groups[0]["lr"] = rate * share
            theirs[place].step()
    moved = (torch.stack([*alone]).detach() - start).abs().max()
    assert (ours.weights - torch.stack([*alone]).detach()).abs().max() <= 1e-5 * moved + 1e-6


@given(
    temperature=st.sampled_from([1.0, 0.25]),
    rate=st.sampled_from([0.0, 0.02]),
    population=st.sampled_from([0.0, 0.003]),
    n_trials=st.integers(1, 6),
    seed=st.integers(0, 99),
)
def test_the_loss_and_its_gradient_are_those_of_a_training_alone(temperature, rate, population, n_trials, seed):
    penalties = {"rate_penalty": rate, "population_penalty": population}
    spec = RSNNSpec(hidden=5, training=TrainingSpec(temperature=temperature, **penalties))
    other = RSNNSpec(hidden=8, training=TrainingSpec(rate_penalty=1.0))
    generator = torch.Generator().manual_seed(seed)
    counts = Counts(*(torch.randint(0, 9, (1, 6, size), generator=generator).float() for size in (16, 16)))
    counts.hidden[..., 5:], counts.readout[..., 3:] = 0, 0
    labels = torch.randint(0, 3, (1, 6), generator=generator)
    numbers = (torch.tensor(each, dtype=torch.int32) for each in ([1], [[0] * 6], [n_trials]))
    found = losses(counts, labels, Batch(*numbers), Settings.of([other, spec], torch.device("cpu")), 3)

    parts = (counts.readout[0, :n_trials, :3], counts.hidden[0, :n_trials, :5])
    alone = CountsAlone(*(part.clone().requires_grad_() for part in parts))
    wanted = loss(alone, labels[0, :n_trials], spec.training)
    wanted.backward()
    assert found.loss.item() == pytest.approx(wanted.item(), rel=1e-6)
    assert found.correct.item() == (parts[0].argmax(dim=1) == labels[0, :n_trials]).sum()
    for g, part in zip(found.g, (alone.hidden, alone.readout), strict=True):
        own = torch.zeros_like(g[0])
        if part.grad is not None:
            own[: part.shape[0], : part.shape[1]] = part.grad
        torch.testing.assert_close(g[0], own, rtol=1e-5, atol=1e-7)
