"""Which afferents a trained network needs, and an encoder without the others.

For searches over ways to save: `ranked` orders pairs of a population and a taxel by how much a network needs them,
`encoder_without` keeps some of them, and `columns_of` says which spikes of the whole encoder these are, so that
nothing need be encoded again.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import ArrayLike

from neurotact.encoders.afferents import POPULATIONS, AfferentSpec, marks, under
from neurotact.encoders.cost import encoding_cost
from neurotact.encoders.specs import taxels_of
from neurotact.errors import InputError
from neurotact.metrics.prices import PriceList
from neurotact.networks.definition.rsnn import RSNN

STRETCHES = 10
"""Parts of a window in each of which spikes are counted."""
TINY = float(np.finfo(np.float64).tiny)


class Pair(NamedTuple):
    """The afferents of a population under a taxel: all its grades and polarities. part: `sa1` or `ra1`."""

    part: str
    taxel: int


def pairs_of(encoder: AfferentSpec, n_afferents: int) -> list[Pair]:
    """The pair of each afferent of an encoder, in the order of its output.

    >>> from neurotact.encoders.specs import load
    >>> pairs_of(load("sa1-ra1-lif", {"sa1.taxels": [1]}), 3)
    [Pair(part='sa1', taxel=1), Pair(part='ra1', taxel=0), Pair(part='ra1', taxel=1)]
    """
    table = encoder.model_dump()
    n_taxels = taxels_of(n_afferents, table)
    pairs = [
        Pair(part, taxel) for part in POPULATIONS for _ in marks(table[part]) for taxel in under(table[part], n_taxels)
    ]
    if len(pairs) != n_afferents:
        raise InputError(f"encoder: has {len(pairs)} afferents where there are {n_afferents}; give that of these")
    return pairs


def need_of(spikes: torch.Tensor, weights: Sequence[ArrayLike]) -> np.ndarray:
    """How much of what arrives depends on each afferent, `(afferent,)`.

    The squared weights out of an afferent times the variance of its spikes between windows, added over `STRETCHES`
    parts of a window: an afferent that always fires alike tells nothing, whatever its weights.

    spikes: of training windows, `(window, time, afferent)`. weights: each `(afferent, neuron)`.

    >>> spikes = torch.tensor([[[1, 0, 1]], [[1, 1, 1]]])
    >>> need_of(spikes, [np.array([[3.0], [1.0], [1.0]])]).tolist()
    [0.0, 0.25, 0.0]
    """
    ends = np.linspace(0, spikes.shape[1], min(STRETCHES, spikes.shape[1]) + 1).round().astype(int)
    parts = [spikes[:, a:b].sum(dim=1, dtype=torch.float64) for a, b in pairwise(ends)]
    spread = sum(part.var(dim=0, correction=0) for part in parts)
    return np.asarray(spread) * sum((np.asarray(matrix, np.float64) ** 2).sum(axis=1) for matrix in weights)


def ranked(
    network: RSNN,
    spikes: torch.Tensor,
    encoder: AfferentSpec,
    *,
    prices: PriceList | None = None,
    recorded_Hz: float | None = None,
) -> list[Pair]:
    """The pairs of an encoder, those first that a network needs most (`need_of`, added over grades and polarities).

    spikes: of training windows, `(window, time, afferent)`.
    prices: divide need by the energy that a pair costs. A taxel is conditioned once for all its afferents, so that an
    afferent beside another one is cheaper, and a taxel that goes whole saves more. recorded_Hz: samples of the
    recordings per second, where the encoder resamples.

    >>> from neurotact.encoders.specs import load
    >>> network = RSNN(2, 3, sampling_rate_Hz=1000.0, hidden=4)
    >>> ranked(network, torch.tensor([[[0, 1]], [[0, 0]]]), load("sa1-ra1-lif"))
    [Pair(part='ra1', taxel=0), Pair(part='sa1', taxel=0)]
    """
    weights, need = _driven(network), dict[Pair, float]()
    for pair, its in zip(pairs_of(encoder, spikes.shape[2]), need_of(spikes, weights).tolist(), strict=True):
        need[pair] = need.get(pair, 0.0) + its
    order = sorted(need, key=lambda pair: -need[pair])
    if prices is None:
        return order
    value = _per_energy(order, need, _energies(network, spikes, encoder, prices, recorded_Hz))
    return sorted(order, key=lambda pair: -value[pair])


def _driven(network: RSNN) -> list[torch.Tensor]:
    """The weights out of afferents, `(afferent, neuron)`: to the hidden layer, and to a readout that hears them."""
    into, out = network.w_in.detach().cpu(), network.readout_weights.detach().cpu()
    heard = out.reshape(-1, *out.shape[-2:])[:, network.spec.hidden :] if network.spec.hears_afferents else ()
    return [into, *heard]


def _energies(
    network: RSNN, spikes: torch.Tensor, encoder: AfferentSpec, prices: PriceList, recorded_Hz: float | None
) -> Callable[[Collection[Pair]], float]:
    """The energy of an encoder with some pairs alone, over a window, in nJ."""
    n_windows, steps, n_afferents = spikes.shape
    n_taxels = taxels_of(n_afferents, encoder.model_dump())
    sent, pairs = spikes.sum(dim=(0, 1), dtype=torch.float64) / n_windows, pairs_of(encoder, n_afferents)

    def energy_nJ(keep: Collection[Pair]) -> float:  # noqa: N802
        table = encoder_without(encoder, keep).model_dump(mode="json", exclude_none=True)
        fired = float(sum(its for pair, its in zip(pairs, sent, strict=True) if pair in keep))
        signal_ms = 1e3 * steps / network.sampling_rate_Hz
        made = encoding_cost(n_taxels, steps, signal_ms, table, recorded_Hz=recorded_Hz, spikes=fired)
        return made.energy_nJ(prices)

    return energy_nJ


def _per_energy(
    order: Sequence[Pair], need: Mapping[Pair, float], energy_nJ: Callable[[Collection[Pair]], float]
) -> dict[Pair, float]:
    """The need of each pair per energy that it saves when the least worthy go first, one of a taxel or all of it."""
    value: dict[Pair, float] = {}
    for taxel in {pair.taxel for pair in order}:
        left = {pair for pair in order if pair.taxel == taxel}
        while left:
            ways = [{pair} for pair in left] + ([left] if len(left) > 1 else [])
            saved = [energy_nJ(left) - (energy_nJ(left - way) if left - way else 0.0) for way in ways]
            worth = [sum(need[pair] for pair in way) / max(its, TINY) for way, its in zip(ways, saved, strict=True)]
            least = int(np.argmin(worth))
            value |= dict.fromkeys(ways[least], worth[least])
            left = left - ways[least]
    return value


def encoder_without(encoder: AfferentSpec, keep: Collection[tuple[str, int]]) -> AfferentSpec:
    """The encoder with these pairs alone, at least one.

    >>> from neurotact.encoders.specs import load
    >>> small = encoder_without(load("sa1-ra1-lif"), [("ra1", 3), ("ra1", 0)])
    >>> small.sa1.taxels, small.ra1.taxels
    ((), (0, 3))
    """
    if not keep:
        raise InputError("keep: names no afferent; keep at least one")
    kept = {part: tuple(sorted({taxel for own, taxel in keep if own == part})) for part in POPULATIONS}
    kinds = {part: getattr(encoder, part).model_copy(update={"taxels": taxels}) for part, taxels in kept.items()}
    return encoder.model_copy(update=kinds)


def columns_of(encoder: AfferentSpec, keep: Collection[tuple[str, int]], n_afferents: int) -> list[int]:
    """The afferents of `encoder` that `encoder_without(encoder, keep)` has, in its order.

    >>> from neurotact.encoders.specs import load
    >>> columns_of(load("sa1-ra1-lif"), [("ra1", 1), ("sa1", 0)], 4)
    [0, 3]
    """
    kept = {*keep}
    return [index for index, pair in enumerate(pairs_of(encoder, n_afferents)) if pair in kept]
