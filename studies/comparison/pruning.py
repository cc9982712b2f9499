"""SOPs of a pruned network."""

import torch
from torch import Tensor

from neurotact.metrics.synops import Synops
from neurotact.networks.definition.rsnn import RSNN

BATCH = 1024


@torch.no_grad()
def remaining_synops(network: RSNN, spikes: Tensor, decided: Tensor | None = None) -> Synops:
    """SOPs of windows `(window, time, afferent)`: a spike is one operation for each of its nonzero weights.

    decided: steps of the encoder's clock until each decision, `(window,)`; None: whole windows.

    >>> from neurotact.networks.training.sparsity import prune
    >>> net = RSNN(2, 2, hidden=4, sampling_rate_Hz=1000.0, generator=torch.Generator().manual_seed(0))
    >>> spikes = torch.ones(1, 3, 2, dtype=torch.uint8)
    >>> int(remaining_synops(net, spikes).input[0])
    24
    >>> prune(net, 0.5)
    >>> int(remaining_synops(net, spikes).input[0])
    12
    """
    device = network.w_in.device
    if decided is None:
        hidden = torch.cat([network(part.to(device)).hidden for part in spikes.split(BATCH)])
    else:
        parts = zip(spikes.split(BATCH), decided.cpu().split(BATCH), strict=True)
        hidden = torch.cat([_sent_until(network, *both) for both in parts])
        spikes = spikes * _before(decided.cpu(), spikes.shape[1])
    inputs = spikes.sum(dim=1, dtype=torch.int64)
    heard = network.heard(hidden, inputs.to(device)).round().long().cpu().numpy()
    readout = network.readout_weights.reshape(-1, *network.w_out.shape).ne(0).any(dim=0)
    into, out = (weights.detach().count_nonzero(dim=1).cpu().numpy() for weights in (network.w_in, readout))
    among = torch.zeros_like(network.w_in[:1].T) if network.w_rec is None else network.w_rec
    recurrent = among.detach().count_nonzero(dim=1).cpu().numpy()
    received, sent = inputs.cpu().numpy(), hidden.round().long().cpu().numpy()
    return Synops.of(received @ into, sent @ recurrent, heard @ out)


def _before(ends: Tensor, n: int) -> Tensor:
    """Which of `n` steps are before the end of their window, `(window, time, 1)` uint8."""
    return (torch.arange(n) < ends[:, None]).to(torch.uint8)[..., None]


def _sent_until(network: RSNN, spikes: Tensor, decided: Tensor) -> Tensor:
    """The spikes of each hidden neuron until a decision, `(window, hidden)`."""
    rasters = network.simulated(spikes.to(network.w_in.device)).rasters.hidden
    return (rasters * _before(-(-decided // network.steps_per_bin), rasters.shape[1]).to(rasters)).sum(dim=1)
