"""Magnitude pruning: the smallest weights become 0, and their synapses need no operation.

Gradual pruning in training (Zhu and Gupta 2017, arXiv 1710.01878): the share of weights that are 0 rises fast at first,
while many weights are redundant, and slowly at the end: `s (1 - (1 - x)^3)`, x from 0 to 1. The remaining weights then
train on. A weight that is 0 stays 0: zeros are the mask, which a checkpoint therefore holds.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import chain
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from neurotact.errors import InputError
from neurotact.networks.definition.network import Network
from neurotact.networks.definition.rsnn import RSNN
from neurotact.networks.definition.specs import TrainingSpec

BEGIN, END = 0.1, 2 / 3
"""Shares of the epochs after which pruning begins, and has ended."""
SHARED = {"w_out": "w_stretch"}
"""Parameters that are weights of the same synapses: shared ones, and deviations in each stretch."""


class Ramp(NamedTuple):
    """How the share of pruned weights rises: to `final`, from the end of epoch `begin` to that of epoch `end`."""

    final: float
    begin: int
    end: int

    @classmethod
    def of(cls, spec: TrainingSpec) -> "Ramp":
        """That of a training; no epoch before its `end` has the final share.

        >>> [Ramp.of(TrainingSpec(sparsity=0.8, epochs=n))[1:] for n in (1, 2, 30)]
        [(0, 1), (0, 1), (3, 20)]
        """
        if not spec.sparsity:
            return cls(0.0, 0, 0)
        end = max(1, round(END * spec.epochs))
        return cls(spec.sparsity, min(round(BEGIN * spec.epochs), end - 1), end)

    def after(self, epochs: float) -> float:
        """The share after so many epochs.

        >>> [Ramp(0.8, 2, 4).after(epochs) for epochs in (2, 3, 4, 9)]
        [0.0, 0.7000000000000001, 0.8, 0.8]
        """
        if epochs <= self.begin or not self.final:
            return 0.0
        left = max(0.0, (self.end - epochs) / (self.end - self.begin))
        return self.final * (1 - left**3)

    @contextmanager
    def step(self, network: Network, before: float, after: float) -> Iterator[None]:
        """In this context an optimiser takes a step, the one from `before` to `after`, in epochs."""
        absent = [(w, _absent(w)) for w in _synapses(network).values()] if self.after(before) else []
        yield
        with torch.no_grad():  # the running mean of a gradient moves weights that have none
            for weights, gone in absent:
                for part in weights:
                    part.masked_fill_(gone, 0.0)
        if share := self.after(after):
            prune(network, share)


@torch.no_grad()
def prune(network: Network, share: float) -> None:
    """Set a share of each weight matrix to 0, the smallest magnitudes first (Han et al. 2015, NeurIPS).

    Among equal magnitudes, lower indices go first; biases stay, and below a share of 1 a weight does. Of a synapse with
    a weight in each of `readout_stretches` the root mean square counts; of recurrent weights the share is of those
    within `recurrent_blocks`. The spec's `sparsity` is then at least the share, so that only what is left is counted.
    Raises InputError for a share outside 0 to 1.

    >>> net = RSNN(2, 2, hidden=4, sampling_rate_Hz=1000.0, generator=torch.Generator().manual_seed(0))
    >>> prune(net, 0.75)
    >>> [int((weights == 0).sum()) for weights in net.weights]
    [6, 12, 6]
    """
    if not 0 <= share <= 1:
        raise InputError(f"share: is a share of the weights, from 0 to 1; got {share}")
    for name, (shared, *own) in _synapses(network).items():
        magnitudes = (shared + own[0]).square().mean(dim=0).sqrt() if own else shared.abs()
        n_other = 0
        if name == "w_rec" and isinstance(network, RSNN):
            within = network.within_blocks()
            n_other = int((~within).sum())
            magnitudes = magnitudes.where(within, -1.0)
        n = shared.numel() - n_other
        pruned = magnitudes.flatten().argsort(stable=True)[: n_other + min(round(share * n), n - (share < 1))]
        for weights in (shared, *own):
            weights.view(-1, shared.numel())[:, pruned] = 0.0
    if share > network.spec.training.sparsity:
        _declare(network, share)


@contextmanager
def pruned_stay_pruned(network: Network) -> Iterator[None]:
    """In this context the zeros of a pruned network have no gradient, and a training, which leaves them at 0, may keep
    any epoch.
    """
    handles, share = list[Any](), network.spec.training.sparsity
    for weights in chain(*_synapses(network).values()) if share else ():
        remains = weights.detach() != 0
        handles.append(weights.register_hook(lambda gradient, remains=remains: gradient * remains))
    _declare(network, 0.0)
    try:
        yield
    finally:
        _declare(network, share)
        for handle in handles:
            handle.remove()


def _declare(network: Network, share: float) -> None:
    training = network.spec.training.model_copy(update={"sparsity": share})
    network.spec = network.spec.model_copy(update={"training": training})


def _synapses(network: Network) -> dict[str, list[nn.Parameter]]:
    """The matrices of weights by name, also where they are parametrised; those of the same synapses together."""
    named = ((name.removeprefix("parametrizations."), p) for name, p in network.named_parameters())
    found = {name.removesuffix(".original"): [p] for name, p in named if p.ndim > 1}
    for shared in SHARED.keys() & found.keys():
        found[shared] += found.pop(SHARED[shared], [])
    return found


def _absent(weights: Sequence[Tensor]) -> Tensor:
    """Synapses without a weight, `(presynaptic, postsynaptic)` bool."""
    shared, *own = (weight.detach() == 0 for weight in weights)
    return shared & own[0].all(dim=0) if own else shared
