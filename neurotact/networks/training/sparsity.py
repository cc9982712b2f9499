"""Magnitude pruning: the smallest weights become 0, and their synapses need no operation.

Gradual pruning in training (Zhu and Gupta 2017, arXiv 1710.01878): the share of zeros rises fast at first, and slowly
at the end: `s (1 - (1 - x)^3)`, x from 0 to 1; then the remaining weights train on. A weight that is 0 stays 0: zeros
are the mask, which a checkpoint therefore holds.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from itertools import chain
from typing import Any, NamedTuple

import torch
from torch import nn

from neurotact.errors import InputError
from neurotact.networks.definition.network import Network
from neurotact.networks.definition.rsnn import RSNN
from neurotact.networks.definition.specs import TrainingSpec

BEGIN, END = 0.1, 2 / 3
"""Shares of the epochs after which pruning begins, and has ended."""


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
        """The share after so many epochs."""
        if epochs <= self.begin or not self.final:
            return 0.0
        left = max(0.0, (self.end - epochs) / (self.end - self.begin))
        return self.final * (1 - left**3)

    @contextmanager
    def step(self, network: Network, before: float, after: float) -> Iterator[None]:
        """In this context an optimiser takes a step, the one from `before` to `after`, in epochs."""
        found = _synapses(network).values() if self.after(before) else ()
        absent = [(shared == 0) & (own[0] == 0).all(dim=0) if own else shared == 0 for shared, *own in found]
        yield
        with torch.no_grad():  # the running mean of a gradient moves weights that have none
            for weights, gone in zip(found, absent, strict=True):
                for part in weights:
                    part.masked_fill_(gone, 0.0)
        if share := self.after(after):
            prune(network, share)


@torch.no_grad()
def prune(network: Network, share: float) -> None:
    """Set a share of each weight matrix to 0, the smallest magnitudes first (Han et al. 2015, NeurIPS).

    Of equal magnitudes lower indices go first; biases stay. Of a synapse with weights in `readout_stretches` the root
    mean square counts; of recurrent weights the share is of those within `recurrent_blocks`. The spec's `sparsity`
    is then at least the share: only what is left is counted. Raises InputError for a share outside 0 to 1.

    >>> net = RSNN(2, 2, hidden=4, sampling_rate_Hz=1000.0, generator=torch.Generator().manual_seed(0))
    >>> prune(net, 0.75)
    >>> [int((weights == 0).sum()) for weights in net.weights]
    [6, 12, 6]
    """
    if not 0 <= share <= 1:
        raise InputError(f"share: is a share of the weights, from 0 to 1; got {share}")
    for name, (shared, *own) in _synapses(network).items():
        if not shared.numel():  # without a hidden layer
            continue
        magnitudes, n = (shared + own[0]).square().mean(dim=0).sqrt() if own else shared.abs(), shared.numel()
        if name == "w_rec" and isinstance(network, RSNN):
            magnitudes, n = magnitudes.where(within := network.within_blocks(), -1.0), int(within.sum())
        n_pruned = shared.numel() - n + min(round(share * n), n - (share < 1))
        pruned = magnitudes.flatten().argsort(stable=True)[:n_pruned]
        for part in (shared, *own):
            part.view(-1, shared.numel())[:, pruned] = 0.0
    if share > network.spec.training.sparsity:
        _declare(network, share)


@contextmanager
def pruned_stay_pruned(network: Network) -> Iterator[None]:
    """In this context zeros of a pruned network have no gradient: a training leaves them and may keep any epoch."""
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
    if "w_stretch" in found:  # deviations of the readout's weights in each stretch
        found["w_out"] += found.pop("w_stretch")
    return found
