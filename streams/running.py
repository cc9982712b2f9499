"""A network on one window, one step at a time."""

from typing import NamedTuple

import numpy as np
import torch
from neurotact_parts.streams.detector import Standing
from torch import Tensor

from neurotact.networks.definition.rsnn import RSNN
from neurotact.networks.exit.rule import ExitRule, Leader
from neurotact.networks.training.events import DetectorSpec
from neurotact.neurons import CubaLIFState, cuba_lif_start, cuba_lif_step, recurrent_spikes, transmitted_spikes


class Running(NamedTuple):
    """An open window: the state of both layers, the leading class, and the counts so far.

    window: its number. start: its first step. readout: None for an integrator.
    waiting: afferents that have spiked since the network's last step, `(afferent,)` bool.
    sops: operations so far, of a pruned network; else 0.
    current, leading, led: of a detector, `detector.Standing`; since: its steps before the label in force.
    """

    window: int
    start: int
    steps: int
    hidden: CubaLIFState
    readout: CubaLIFState | None
    leader: Leader
    waiting: np.ndarray
    input_spikes: int = 0
    hidden_spikes: int = 0
    held: int = 0
    sops: int = 0
    current: int = 0
    leading: int = -1
    led: int = 0
    since: int = 0


def begin(network: RSNN, window: int, start: int, band: tuple[float, ...] = ()) -> Running:
    """The state before a window's first step; band: as of `ExitRule`."""
    readout = None if network.bias is not None else cuba_lif_start(1, network.n_classes, network.w_out)
    leader = Leader.start(1, network.n_classes, network.w_in.device, network.integration, band)
    hidden = cuba_lif_start(1, network.spec.hidden, network.w_in)
    return Running(window, start, 0, hidden, readout, leader, np.zeros(network.n_inputs, bool))


def step(
    network: RSNN, arriving: np.ndarray, state: Running, length: int,
    fans: tuple[np.ndarray, np.ndarray] | None = None, band: tuple[float, ...] = (),
) -> Running:  # fmt: skip
    """One step of the encoder's clock; `arriving` contains the numbers of the afferents that spike.

    length: of the window. fans: `fans_of` the network. band: as of `ExitRule`. The network is computed at the end of
    each of its own steps, and at the end of the window.
    """
    waiting = state.waiting.copy()
    waiting[arriving] = True
    n_new = int(waiting.sum() - state.waiting.sum())
    state = state._replace(steps=state.steps + 1, waiting=waiting, input_spikes=state.input_spikes + n_new)
    return _computed(network, state, fans, band) if is_due(network, state, length) else state


def detect(network: RSNN, state: Running, rule: DetectorSpec) -> tuple[Running, bool]:
    """The state after a step with what a detector hears in it, and whether another label comes into force.

    Spikes, operations and repeated values are then counted from here on; the network runs on.
    """
    if state.steps % network.steps_per_bin:
        return state, False
    standing = Standing(state.current, state.leading, state.led).after(state.leader.counts[0].numpy(), rule)
    return state._replace(**standing._asdict()), standing.current != state.current


def counted_anew(state: Running) -> Running:
    """The state of a detector after it has told of a label."""
    return state._replace(since=state.steps, input_spikes=0, hidden_spikes=0, held=0, sops=0)


def fans_of(network: RSNN) -> tuple[np.ndarray, np.ndarray] | None:
    """Synapses of each afferent and of each hidden neuron, of a pruned network; else None."""
    if not network.synapses:
        return None
    into, among, out = (fan.numpy() for fan in network.fans)
    of_hidden, of_afferents = out[: len(among)], out[len(among) :]
    return into + of_afferents if len(of_afferents) else into, among + of_hidden


def is_due(network: RSNN, state: Running, length: int) -> bool:
    """Whether the network's step ends with the last step of the encoder's clock."""
    return state.steps >= length or state.steps % network.steps_per_bin == 0


def _computed(
    network: RSNN, state: Running, fans: tuple[np.ndarray, np.ndarray] | None, band: tuple[float, ...]
) -> Running:
    """The state after a step of the network, from the spikes that wait.

    The current adds decay, then inputs, then recurrence in ascending order, as the native kernels and the `ordered`
    mode of the reference do. Spikes are therefore equal to the last bit.
    """
    recurrent = _spiking(recurrent_spikes(network.neuron, state.hidden))
    arriving = np.flatnonzero(state.waiting)
    spikes, hidden = _layer(network, 0, network.w_in, arriving, network.w_rec, recurrent, state.hidden)
    hidden_spikes = _spiking(spikes)
    sops = 0 if fans is None else int(fans[0][arriving].sum() + fans[1][hidden_spikes].sum())
    readout = state.readout
    if readout is None:
        heard = network.heard(spikes, torch.from_numpy(state.waiting)[None])
        increments = network.gained(heard, -(-state.steps // network.steps_per_bin) - 1)
    else:
        readout_spikes, readout = _layer(network, 1, network.w_out, hidden_spikes, None, hidden_spikes, readout)
        increments = readout_spikes.to(torch.int64)
    return state._replace(
        hidden=hidden,
        readout=readout,
        leader=state.leader.after(increments, network.integration, band),
        waiting=np.zeros_like(state.waiting),
        hidden_spikes=state.hidden_spikes + len(hidden_spikes),
        sops=state.sops + sops,
    )


def sent(network: RSNN, state: Running) -> np.ndarray:
    """Spikes that the hidden layer sent to the readout in the network's last step, `(hidden,)` bool."""
    return transmitted_spikes(network.neuron, state.hidden)[0].numpy() != 0


def has_decided(network: RSNN, state: Running, rule: ExitRule, length: int) -> bool:
    """Whether the window is over, or the rule stops it."""
    if not is_due(network, state, length):
        return False
    return state.steps >= length or bool(state.leader.exits(rule.in_bins(network.steps_per_bin)))


def _layer(
    network: RSNN,
    layer: int,
    w: Tensor,
    inputs: np.ndarray,
    v: Tensor | None,
    recurrent: np.ndarray,
    state: CubaLIFState,
) -> tuple[Tensor, CubaLIFState]:
    current = network.alpha[layer] * state.current
    for presynaptic in inputs:
        current = current + w[presynaptic]
    if v is not None:
        for presynaptic in recurrent:
            current = current + v[presynaptic]
    dynamics = (network.beta[layer], network.threshold[layer])
    return cuba_lif_step(network.neuron, current, state, *dynamics, _above, network.adaptation_of(layer))


def _above(over_threshold: Tensor) -> Tensor:
    return over_threshold > 0


def _spiking(spikes: Tensor) -> np.ndarray:
    return np.flatnonzero(spikes.numpy())
