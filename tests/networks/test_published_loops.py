"""The networks of the Braille-reading study and of SpyTorch, loop by loop, beside ours with equal weights.

S. F. Mueller-Cleve et al., Braille letter reading (2022), has two kinds of hidden layer, which differ in the step
in which a spike is fed back. Each is written here from its equations; the place of the line for `current`
decides it.
"""

from typing import NamedTuple, get_args

import pytest
import torch
from torch import Tensor

from neurotact.networks.definition import native
from neurotact.networks.definition.rsnn import RSNN
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.networks.definition.surrogate import FastSigmoid
from neurotact.neurons import Membrane, Reset

N_IN, HIDDEN, CLASSES, STEPS, TRIALS = 6, 12, 4, 60, 16
ALPHA, BETA, SCALE = 0.8, 0.9, 10.0
SPIKE = FastSigmoid(SCALE)
"""Theta(U - 1), whose derivative is 1 / (1 + SCALE |U - 1|)^2."""
VARIANTS = [(m, r, d) for m in get_args(Membrane) for r in get_args(Reset) for d in (0, 1)]


class Ran(NamedTuple):
    """Spikes of both layers, `(trial, time, neuron)`, the loss and its gradient to each matrix of weights."""

    hidden: Tensor
    readout: Tensor
    loss: Tensor
    gradients: tuple[Tensor, ...]
    margin: float
    """How near a membrane came to the threshold: two orders of addition agree on every spike above rounding."""


def delayed_layer(x: Tensor, w: Tensor, v: Tensor | None, seen: list[Tensor]) -> Tensor:
    """SpyTorch's layer: a turn adds the recurrent input before it asks who spikes, so that it adds s[t-1]."""
    current = membrane = out = x.new_zeros(len(x), w.shape[1])
    sent = []
    for t in range(x.shape[1]):
        arriving = x[:, t] @ w if v is None else x[:, t] @ w + out @ v
        seen.append(membrane)
        out = SPIKE(membrane - 1)
        sent.append(out)
        current, membrane = ALPHA * current + arriving, (BETA * membrane + current) * (1 - out.detach())
    return torch.stack(sent, dim=1)


def immediate_layer(x: Tensor, w: Tensor, v: Tensor | None, seen: list[Tensor]) -> Tensor:
    """Loihi's layer: the current comes first, then the membrane, then the spike, which the next turn adds."""
    current = membrane = out = x.new_zeros(len(x), w.shape[1])
    sent = []
    for t in range(x.shape[1]):
        current = ALPHA * current + x[:, t] @ w
        current = current if v is None else current + out @ v
        membrane = BETA * membrane + current
        seen.append(membrane)
        out = SPIKE(membrane - 1)
        sent.append(out)
        membrane = membrane * (1 - out.detach())
    return torch.stack(sent, dim=1)


LAYERS = {"recurrent": delayed_layer, "loihi": immediate_layer}
OURS = {"recurrent": ("delayed", "zero", 1), "loihi": ("immediate", "hard", 0)}
"""Membrane, reset and recurrent delay: what our specs call the network of each notebook."""


def inputs() -> tuple[Tensor, Tensor]:
    x = torch.rand(TRIALS, STEPS, N_IN, generator=torch.Generator().manual_seed(2), dtype=torch.float64) < 0.2
    return x.double(), torch.arange(TRIALS) % CLASSES


def weights(recurrent: bool = True) -> list[Tensor]:
    generator = torch.Generator().manual_seed(0)
    shapes = {(N_IN, HIDDEN): 0.6, (HIDDEN, HIDDEN): 0.25, (HIDDEN, CLASSES): 0.4}
    made = [scale * torch.randn(shape, generator=generator, dtype=torch.float64) for shape, scale in shapes.items()]
    return made if recurrent else [made[0], made[2]]


def loss_of(hidden_counts: Tensor, readout_counts: Tensor, labels: Tensor) -> Tensor:
    decision = torch.nn.functional.cross_entropy(readout_counts, labels, reduction="sum")
    return decision + 0.01 * hidden_counts.square().mean()


def published(name: str, recurrent: bool = True) -> Ran:
    (x, labels), layer, seen = inputs(), LAYERS[name], []
    given = [part.requires_grad_() for part in weights(recurrent)]
    hidden = layer(x, given[0], given[1] if recurrent else None, seen)
    readout = layer(hidden, given[-1], None, seen)
    loss = loss_of(hidden.sum(dim=1), readout.sum(dim=1), labels)
    margin = min((membrane - 1).abs().min().item() for membrane in seen)
    return Ran(hidden.detach(), readout.detach(), loss.detach(), torch.autograd.grad(loss, given), margin)


def ours(variant: tuple[str, str, int], recurrent: bool = True, backend: str = "reference") -> Ran:
    membrane, reset, delay = variant
    table = {"membrane": membrane, "reset": reset, "recurrent_delay_steps": delay, "surrogate_scale": SCALE}
    spec = RSNNSpec(model="rsnn" if recurrent else "snn", hidden=HIDDEN, **table)
    net = RSNN(N_IN, CLASSES, spec, 1000.0, backend=backend, dtype=torch.float64)
    parameters = [p for p in (net.w_in, net.w_rec, net.w_out) if p is not None]
    with torch.no_grad():
        for parameter, value in zip(parameters, weights(recurrent), strict=True):
            parameter.copy_(value)
        net.alpha.fill_(ALPHA)
        net.beta.fill_(BETA)
    x, labels = inputs()
    counts, rasters = net(x), net.simulate(x)
    loss = loss_of(counts.hidden, counts.readout, labels)
    gradients = torch.autograd.grad(loss, parameters)
    return Ran(rasters.hidden.detach(), rasters.readout.detach(), loss.detach(), gradients, 0.0)


def agree(mine: Ran, theirs: Ran, rounding: float) -> bool:
    """Every spike equal, the loss and all gradients within rounding, relative to the largest of each matrix."""
    pairs = zip(mine.gradients, theirs.gradients, strict=True)
    return (
        torch.equal(mine.hidden, theirs.hidden)
        and torch.equal(mine.readout, theirs.readout)
        and abs(mine.loss / theirs.loss - 1).item() <= rounding
        and all(((a - b).abs().max() / b.abs().max()).item() <= rounding for a, b in pairs)
    )


@pytest.mark.parametrize("name", LAYERS)
def test_one_variant_alone_is_the_published_loop(name):
    theirs = published(name)
    assert theirs.margin > 1e-9
    assert theirs.hidden.mean() > 0.1
    assert theirs.readout.mean() > 0.05
    assert all(gradient.abs().max() > 0.1 for gradient in theirs.gradients)
    assert [variant for variant in VARIANTS if agree(ours(variant), theirs, 1e-12)] == [OURS[name]]


@pytest.mark.skipif(native.native is None, reason="the kernels are not compiled here")
@pytest.mark.parametrize("name", LAYERS)
def test_the_kernels_are_the_published_loop(name):
    assert agree(ours(OURS[name], backend="native"), published(name), 1e-9)


@pytest.mark.parametrize("name", LAYERS)
@pytest.mark.parametrize("delay", [0, 1])
def test_without_recurrence_the_delay_makes_no_difference(name, delay):
    membrane, reset, _ = OURS[name]
    assert agree(ours((membrane, reset, delay), recurrent=False), published(name, recurrent=False), 1e-12)


def test_the_feedback_of_the_same_step_gives_another_loss():
    theirs, same_step = published("recurrent"), ours(("delayed", "zero", 0))
    assert abs(same_step.loss - theirs.loss) > 1
    first = (same_step.hidden != theirs.hidden).any(dim=2).any(dim=0).nonzero()[0].item()
    assert torch.equal(same_step.hidden[:, :first], theirs.hidden[:, :first])
    assert first > 2  # a spike must have been sent before it can come back
