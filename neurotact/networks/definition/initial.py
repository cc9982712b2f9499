"""The start of a training: initial weights are scaled on the spikes, and a start that would not learn is corrected."""

import math
import warnings

import torch
from torch import Tensor

from neurotact.networks.definition.module import ModuleNetwork
from neurotact.networks.definition.network import Network
from neurotact.networks.definition.recipe import BATCH
from neurotact.networks.definition.rsnn import RSNN
from neurotact.networks.definition.surrogate import FastSigmoid
from neurotact.neurons import CubaLIF, Decay, cuba_lif_start, cuba_lif_step

LOOKED_AT = 256
"""Training windows on which weights are scaled, evenly spaced."""
ATTEMPTS, EXPLODES, HALVINGS = 5, 1e3, 20
"""Most redraws of silent neurons; largest factor of recurrence on a gradient; most halvings of recurrent weights."""
NEVER = 1e30
"""A threshold that no membrane reaches."""


def free_deviation(spikes: Tensor, weights: Tensor, neuron: CubaLIF, alpha: Decay, beta: Decay) -> Tensor:
    """Standard deviation of each neuron's free membrane, over trials and time, `(neuron,)` in float64.

    A free membrane neither fires nor resets. spikes: `(trial, time, afferent)`. weights: `(afferent, neuron)`.

    >>> one = torch.tensor([[[0.0], [1.0]]])
    >>> free_deviation(one, torch.tensor([[1.0, 3.0]]), CubaLIF("immediate"), 0.5, 0.5).tolist()
    [0.5, 1.5]
    """
    n_trials, n_steps, _ = spikes.shape
    weights = weights.double()
    state = cuba_lif_start(n_trials, weights.shape[1], weights)
    total, squares = torch.zeros_like(weights[0]), torch.zeros_like(weights[0])
    for arriving in spikes.unbind(dim=1):
        current = alpha * state.current + arriving.to(weights.dtype) @ weights
        _, state = cuba_lif_step(neuron, current, state, beta, NEVER, FastSigmoid())
        total += state.membrane.sum(dim=0)
        squares += state.membrane.square().sum(dim=0)
    n_values = max(1, n_trials * n_steps)
    return (squares / n_values - (total / n_values).square()).clamp(min=0).sqrt()


def start(network: Network, spikes: Tensor, generator: torch.Generator) -> None:
    """Scale the initial weights of a network with an `input_deviation`, and correct a start that would not learn.

    spikes: of training windows. generator: redraws the weights of silent hidden neurons.
    Warns of corrections.
    """

    def sample_of() -> Tensor:
        return network.binned(spikes[:: max(1, math.ceil(len(spikes) / LOOKED_AT))].to(network.device))

    if isinstance(network, ModuleNetwork):
        network.begin(sample_of(), generator)
    if not isinstance(network, RSNN) or network.spec.input_deviation is None:
        return
    sample = sample_of()
    scale_weights(network, sample)
    if sample.any():
        _redraw_silent(network, sample, generator)
        _weaken_recurrence(network, sample)
        scale_readout(network, sample)


@torch.no_grad()
def scale_weights(network: RSNN, spikes: Tensor) -> None:
    """Scale each hidden neuron's input weights so that its free membrane deviates by `input_deviation` thresholds.

    spikes: on the network's clock. A neuron without input keeps its weights.
    """
    assert network.spec.input_deviation is not None
    alpha, beta = float(network.alpha[0]), float(network.beta[0])
    deviation = free_deviation(spikes.cpu(), network.w_in.cpu(), network.neuron, alpha, beta)
    wanted = network.spec.input_deviation * float(network.threshold[0])
    factor = torch.where(deviation > 0, wanted / deviation, 1.0)
    network.w_in.mul_(factor.to(network.w_in))


@torch.no_grad()
def scale_readout(network: RSNN, spikes: Tensor) -> None:
    """Scale an integrator's weights so that its classes deviate by 1 over the windows, on average."""
    if network.bias is not None:
        deviation = network.counts(spikes).readout.std(dim=0, correction=0).mean()
        if deviation > 0:
            network.w_out.div_(deviation)


@torch.no_grad()
def _redraw_silent(network: RSNN, spikes: Tensor, generator: torch.Generator) -> None:
    """Redraw the input weights of hidden neurons that never spike, a few times at most."""
    silent = ~network.counts(spikes).hidden.any(dim=0)
    redrawn = int(silent.sum())
    for _ in range(ATTEMPTS):
        if not silent.any():
            break
        drawn = torch.randn(network.w_in.shape, generator=generator).to(network.w_in)
        network.w_in[:, silent] = drawn[:, silent]
        scale_weights(network, spikes)
        silent = ~network.counts(spikes).hidden.any(dim=0)
    if redrawn > len(silent) / 2:
        warnings.warn(
            f"training: {redrawn} of {len(silent)} hidden neurons were silent; their weights were redrawn, "
            f"and {int(silent.sum())} are still silent",
            stacklevel=2,
        )


def _weaken_recurrence(network: RSNN, spikes: Tensor) -> None:
    """Halve the recurrent weights until gradients do not explode at the start."""
    if network.w_rec is None:
        return
    recurrent = network.w_rec.detach().clone()
    with torch.no_grad():
        network.w_rec.zero_()
    limit = EXPLODES * _gradient_norm(network, spikes)
    with torch.no_grad():
        network.w_rec.copy_(recurrent)
    weights, halvings = network.w_rec, 0
    while not _gradient_norm(network, spikes) <= limit and halvings < HALVINGS:
        halvings += 1
        with torch.no_grad():
            weights.mul_(0.5)
    if halvings:
        warnings.warn(
            f"training: gradients would explode; the initial recurrent weights are {2**halvings} times smaller",
            stacklevel=2,
        )


def _gradient_norm(network: RSNN, spikes: Tensor) -> float:
    """Norm of the gradient of the readout's variance over windows, by the input weights."""
    readout = network.counts(spikes[:BATCH]).readout
    (gradient,) = torch.autograd.grad(readout.var(dim=0, correction=0).sum(), network.w_in)
    return float(gradient.double().norm())
