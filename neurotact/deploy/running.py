"""A network that hears one window, a step at a time."""

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from neurotact.networks.early_exit import ExitRule, Leader
from neurotact.networks.rsnn import RSNN
from neurotact.neurons import CubaLIFState, cuba_lif_start, cuba_lif_step, recurrent_spikes, transmitted_spikes


class Running(NamedTuple):
    """A window under way: the state of both layers, the race of the classes, and what was counted so far.

    window: its number. start: its first step. readout: None of an integrator.
    """

    window: int
    start: int
    steps: int
    hidden: CubaLIFState
    readout: CubaLIFState | None
    leader: Leader
    input_spikes: int = 0
    hidden_spikes: int = 0
    held: int = 0


def begin(network: RSNN, window: int, start: int) -> Running:
    """Before a window's first step."""
    readout = None if network.bias is not None else cuba_lif_start(1, network.n_classes, network.w_out)
    leader = Leader.start(1, network.n_classes, network.w_in.device, network.integration)
    return Running(window, start, 0, cuba_lif_start(1, network.spec.hidden, network.w_in), readout, leader)


def step(network: RSNN, arriving: np.ndarray, state: Running) -> Running:
    """One step, `arriving` being the numbers of the afferents that spike, ascending.

    The current adds decay, then inputs, then recurrence in ascending order, as the native kernels do and the reference
    does in its `ordered` mode, so that spikes are equal to the last bit.
    """
    returning = _spiking(recurrent_spikes(network.neuron, state.hidden))
    sent, hidden = _layer(network, 0, network.w_in, arriving, network.w_rec, returning, state.hidden)
    heard = _spiking(sent)
    readout = state.readout
    if readout is None:
        gained = network.added(sent)
    else:
        decided, readout = _layer(network, 1, network.w_out, heard, None, heard, readout)
        gained = decided.to(torch.int64)
    return state._replace(
        steps=state.steps + 1,
        hidden=hidden,
        readout=readout,
        leader=state.leader.after(gained, network.integration),
        input_spikes=state.input_spikes + len(arriving),
        hidden_spikes=state.hidden_spikes + len(heard),
    )


def sent(network: RSNN, state: Running) -> np.ndarray:
    """What the hidden layer sent to the readout in the last step, `(hidden,)` bool."""
    return transmitted_spikes(network.neuron, state.hidden)[0].numpy() != 0


def has_decided(state: Running, rule: ExitRule, length: int) -> bool:
    """Whether the window is over, or the rule stops it."""
    return state.steps >= length or bool(state.leader.exits(rule))


def _layer(
    network: RSNN,
    layer: int,
    w: Tensor,
    arriving: np.ndarray,
    v: Tensor | None,
    returning: np.ndarray,
    state: CubaLIFState,
) -> tuple[Tensor, CubaLIFState]:
    current = network.alpha[layer] * state.current
    for presynaptic in arriving:
        current = current + w[presynaptic]
    if v is not None:
        for presynaptic in returning:
            current = current + v[presynaptic]
    dynamics = (network.beta[layer], network.threshold[layer])
    return cuba_lif_step(network.neuron, current, state, *dynamics, _above, network.adaptation_of(layer))


def _above(over_threshold: Tensor) -> Tensor:
    return over_threshold > 0


def _spiking(spikes: Tensor) -> np.ndarray:
    return np.flatnonzero(spikes.numpy())
