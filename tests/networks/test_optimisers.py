"""Optimisers train without torch's compiler, to the same bits."""

import os
import subprocess
import sys

import pytest
import torch

from neurotact.networks.definition import optimisers


def trained(kind: type[torch.optim.Optimizer], **options) -> list[torch.Tensor]:
    """Weights and the state of an optimiser after some steps; halfway another one goes on from its state."""
    generator = torch.Generator().manual_seed(0)
    weights = [torch.randn(4, 3, generator=generator).requires_grad_() for _ in range(2)]
    optimiser = kind([{"params": weights[:1], "lr": 0.02}, {"params": weights[1:]}], **options)
    for step in range(6):
        if step == 3:
            state, optimiser = (
                optimiser.state_dict(),
                kind([{"params": weights[:1]}, {"params": weights[1:]}], **options),
            )
            optimiser.load_state_dict(state)
        optimiser.zero_grad()
        sum(((step + 1) * each.square() + each).sum() for each in weights).backward()
        optimiser.step()
    states = [optimiser.state[each] for each in weights]
    return [*weights, *(value for state in states for value in state.values() if torch.is_tensor(value))]


@pytest.mark.parametrize("name", [*optimisers.names(), "LBFGS"])
def test_an_optimiser_steps_as_torchs_own_to_the_last_bit(name):
    if name == "LBFGS":
        generator = torch.Generator().manual_seed(0)
        start = torch.randn(4, generator=generator)
        found = []
        for kind in (optimisers.kind_of(name), torch.optim.LBFGS):
            weights = start.clone().requires_grad_()
            optimiser = kind([weights], max_iter=7)

            def closure(weights=weights, optimiser=optimiser):
                optimiser.zero_grad()
                loss = (weights.square() * torch.arange(1.0, 5.0) + weights).sum()
                loss.backward()
                return loss

            optimiser.step(closure)
            found.append(weights.detach())
        assert torch.equal(*found)
        assert not torch.equal(found[0], start)
        return
    options = {"fused": True} if name == "Adam" else {}
    ours, theirs = trained(optimisers.kind_of(name), **options), trained(getattr(torch.optim, name), **options)
    assert len(ours) == len(theirs)
    assert all(torch.equal(one, other) for one, other in zip(ours, theirs, strict=True))


def test_no_training_loads_the_compiler_of_torch(tmp_path):
    """Its import, with sympy, takes a second of each process: of a network, of a search's, of an opponent's."""
    script = """
import sys
import numpy as np
import torch
import neurotact as nt
from neurotact.networks.definition import optimisers
from neurotact_parts.opponents.pooled_gru import PooledGRUClassifier
y = np.arange(24) % 2
X = (np.random.default_rng(0).random((24, 40, 6)) < 0.1 + 0.3 * y[:, None, None]).astype(np.uint8)
nt.SpikingClassifier(network="rsnn", settings={"hidden": 5, "training.epochs": 2}, sampling_rate_Hz=1e3).fit(X, y)
PooledGRUClassifier(epochs=1).fit(X.astype(np.float32), y)
for name in optimisers.names():
    optimisers.state_shapes(name, (2, 3))
adam = optimisers.make("Adam", [{"params": [torch.zeros(2, requires_grad=True)]}])
adam.load_state_dict(adam.state_dict())
print([name for name in sys.modules if name.partition(".")[0] == "sympy" or name.startswith("torch._dynamo")])
"""
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, "-c", script], cwd=tmp_path, check=True, env=environment, capture_output=True, text=True
    )
    assert done.stdout == "[]\n"
