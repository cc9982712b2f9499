"""NeuroBench's columns of a run: what its network stores and does on test windows, as NeuroBench 2.3.0 counts it.

NeuroBench (github NeuroBench/neurobench, `metrics/static` and `metrics/workload`) counts in networks of torch and
snnTorch's modules. So these are the numbers of the network that `nt.to_snntorch` makes of the run, here from the spikes
of the run's own network; membranes alone are those of snnTorch. They stand beside the SOPs of the ledger, which differ
where

- a weight is zero: NeuroBench counts no operation there, the ledger only leaves it out in a pruned network;
- the window ends: a spike that arrives after it is no operation of NeuroBench's, and one of the ledger's;
- a recurrent layer resets to zero: snnTorch computes the recurrent projection twice in a step, and NeuroBench counts
  both.

Neither the encoder nor the weights that an integrator has in each stretch of a window are NeuroBench's matter.
"""

from typing import NamedTuple

import torch
from neurotact_parts.exporters.snntorch import SnnTorchNetwork, to_snntorch
from torch import Tensor, nn

from neurotact.networks.definition.rsnn import RSNN

AT_ONCE = 64
"""Windows whose spikes are counted together."""


class Counts(NamedTuple):
    """What a network does on some windows, in all.

    into, among, out: effective operations of the input, recurrent and readout projections. active, outputs: outputs of
    neurons that are not zero, and all of them. updates: of membranes.
    """

    into: float
    among: float
    out: float
    active: float
    outputs: int
    updates: int


def columns(network: RSNN, windows: Tensor) -> dict[str, float]:
    """NeuroBench's columns of a network on windows `(window, time, afferent)`, without its accuracy.

    >>> net = RSNN(2, 2, hidden=3, sampling_rate_Hz=1000.0, generator=torch.Generator().manual_seed(0))
    >>> {name: columns(net, torch.ones(1, 9, 2))[name] for name in ("footprint_bytes", "effective_macs")}
    {'footprint_bytes': 168, 'effective_macs': 0.0}
    """
    module = to_snntorch(network)
    stored = [*module.parameters(), *module.buffers()]
    weights = [weight for weight in (network.w_in, network.w_rec, network.w_out) if weight is not None]
    zeros = sum(int((weight == 0).sum()) for weight in weights)
    parts = [_counts(network, module, part) for part in windows.split(AT_ONCE)]
    found = Counts(*map(sum, zip(*parts, strict=True)))  # pyright: ignore[reportArgumentType]
    return {
        "footprint_bytes": sum(value.numel() * value.element_size() for value in stored),
        "connection_sparsity": round(zeros / sum(weight.numel() for weight in weights), 4),
        "activation_sparsity": 1 - found.active / found.outputs if found.outputs else 0.0,
        "effective_acs": (found.into + found.among + found.out) / len(windows),
        "effective_macs": 0.0,  # of values other than 0 and 1: every projection takes spikes
        "membrane_updates": found.updates / len(windows),
    }


@torch.no_grad()
def _counts(network: RSNN, module: SnnTorchNetwork, windows: Tensor) -> Counts:
    """module: the network in snnTorch's neurons, whose layers compute fewer steps by those by which they are late."""
    spikes, late = network.binned(windows), module.late
    hidden, readout = network.simulate(windows)
    n_steps, spiking = spikes.shape[1], network.bias is None
    among = 0.0
    if network.w_rec is not None:
        returning = hidden[:, : n_steps - max(1, late) - network.spec.recurrent_delay_steps]
        among = (1 + (network.spec.reset == "zero")) * _operations(returning, network.w_rec)
    heard = network.heard(hidden, spikes)[:, : n_steps - late if spiking else n_steps]
    sent = [layer[:, late:] for layer in ((hidden, readout) if spiking else (hidden,))]
    return Counts(
        into=_operations(spikes[:, : n_steps - late], network.w_in),
        among=among,
        out=_operations(heard, network.w_out),
        active=float(sum(layer.count_nonzero() for layer in sent)),
        outputs=sum(layer.numel() for layer in sent),
        updates=_updates(module, windows),
    )


def _operations(spikes: Tensor, weights: Tensor) -> float:
    """Operations of spikes `(window, time, presynaptic)`: one at each weight that is not zero."""
    return float(spikes.sum(dim=(0, 1)).double() @ (weights != 0).sum(dim=1).double())


def _updates(module: SnnTorchNetwork, windows: Tensor) -> int:
    """How often a membrane changes; in the first step NeuroBench counts every one.

    Of snnTorch's membranes: whether one that hardly moves changes is a matter of rounding, which is theirs.
    """
    last: dict[nn.Module, Tensor] = {}
    total = 0

    def count(layer: nn.Module, _: object, found: tuple[Tensor, ...]) -> None:
        nonlocal total
        membrane = found[-1]
        total += int((membrane != last[layer]).sum()) if layer in last else membrane.numel()
        last[layer] = membrane

    hooks = [layer.register_forward_hook(count) for layer in (module.hidden, module.readout) if layer is not None]
    module(windows)
    for hook in hooks:
        hook.remove()
    return total
