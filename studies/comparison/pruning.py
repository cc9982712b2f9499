"""Magnitude pruning: the smallest weights of a trained network become 0, and their synapses need no operation."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import torch
from torch import Tensor

from neurotact.errors import InputError
from neurotact.metrics.synops import Synops
from neurotact.networks.definition.rsnn import RSNN

BATCH = 1024


@torch.no_grad()
def prune(network: RSNN, share: float) -> None:
    """Set a share of each weight matrix to 0, the smallest magnitudes first (Han et al. 2015, NeurIPS).

    Among equal magnitudes, lower indices go first; an integrator's bias is not pruned. A synapse with a weight in each
    of `readout_stretches` has the magnitude of their root mean square. Of recurrent weights the share is of those
    within `recurrent_blocks`. Raises InputError for a share outside 0 to 1.

    >>> net = RSNN(2, 2, hidden=4, sampling_rate_Hz=1000.0, generator=torch.Generator().manual_seed(0))
    >>> prune(net, 0.75)
    >>> [int((weights == 0).sum()) for weights in net.weights]
    [6, 12, 6]
    """
    if not 0 <= share <= 1:
        raise InputError(f"share: is a share of the weights, from 0 to 1; got {share}")
    for weights in (network.w_in, network.w_rec, network.w_out):
        if weights is None:
            continue
        magnitudes = weights.abs()
        if weights is network.w_out and network.w_stretch is not None:
            magnitudes = network.readout_weights.square().mean(dim=0).sqrt()
        n_absent = 0
        if weights is network.w_rec:
            within = network.within_blocks()
            n_absent = int((~within).sum())
            magnitudes = magnitudes.where(within, -1.0)
        pruned = magnitudes.flatten().argsort(stable=True)[: n_absent + round(share * (weights.numel() - n_absent))]
        weights.view(-1)[pruned] = 0.0
        if weights is network.w_out and network.w_stretch is not None:
            network.w_stretch.flatten(1)[:, pruned] = 0.0


@contextmanager
def pruned_stay_pruned(network: RSNN) -> Iterator[None]:
    """In this context, weights that are 0 have no gradient: an optimiser that starts here leaves them at 0."""
    handles: list[Any] = []
    for weights in network.weights:
        remains = weights.detach() != 0
        handles.append(weights.register_hook(lambda gradient, remains=remains: gradient * remains))
    try:
        yield
    finally:
        for handle in handles:
            handle.remove()


@torch.no_grad()
def remaining_synops(network: RSNN, spikes: Tensor) -> Synops:
    """SOPs of whole windows `(window, time, afferent)`: a spike is one operation for each of its nonzero weights.

    >>> net = RSNN(2, 2, hidden=4, sampling_rate_Hz=1000.0, generator=torch.Generator().manual_seed(0))
    >>> spikes = torch.ones(1, 3, 2, dtype=torch.uint8)
    >>> int(remaining_synops(net, spikes).input[0])
    24
    >>> prune(net, 0.5)
    >>> int(remaining_synops(net, spikes).input[0])
    12
    """
    device = network.w_in.device
    hidden = torch.cat([network(part.to(device)).hidden for part in spikes.split(BATCH)])
    inputs = spikes.sum(dim=1, dtype=torch.int64)
    heard = network.heard(hidden, inputs.to(device)).round().long().cpu().numpy()
    readout = network.readout_weights.reshape(-1, *network.w_out.shape).ne(0).any(dim=0)
    into, out = (weights.detach().count_nonzero(dim=1).cpu().numpy() for weights in (network.w_in, readout))
    among = torch.zeros_like(network.w_in[:1].T) if network.w_rec is None else network.w_rec
    recurrent = among.detach().count_nonzero(dim=1).cpu().numpy()
    received, sent = inputs.cpu().numpy(), hidden.round().long().cpu().numpy()
    return Synops.of(received @ into, sent @ recurrent, heard @ out)
