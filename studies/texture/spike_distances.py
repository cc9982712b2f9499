"""Distances between spike trains: van Rossum and Victor-Purpura (texture paper, Table I, its reference 17).

Both compare trials of several afferents, each train with that of the same afferent (labelled lines):
squared van Rossum distances add up over afferents, Victor-Purpura distances directly. Only spikes count: the
length of a trial has no effect.
"""

from typing import NamedTuple

import numpy as np
from scipy.signal import lfilter
from scipy.sparse import csr_array

from neurotact.errors import InputError
from neurotact.metrics.spike_trains import Events, Spikes, check_rate, events_of_raster

ROWS, COLUMNS = 64, 512
"""Trials of a block, whose pairs go through the recursion together: small enough for the cache."""


def van_rossum(spikes: Spikes, sampling_rate_Hz: float, *, tau_ms: float, others: Spikes | None = None) -> np.ndarray:
    """Distances of trials to other trials (to one another when none are given), `(trial, other)`.

    van Rossum 2001: each spike becomes exp(-t / tau) from its time on, and the distance is the root of the integrated
    squared difference, scaled so that a lone spike is at distance 1 from silence. The integral is exact, not sampled:
    two spikes overlap by exp(-|t - t'| / tau).

    >>> trains = np.array([[[0], [0]], [[1], [0]], [[1], [1]]])
    >>> van_rossum(trains, 1000.0, tau_ms=1.0)[0].round(3).tolist()
    [0.0, 1.0, 1.654]
    """
    check_rate(sampling_rate_Hz)
    if not tau_ms > 0:
        raise InputError(f"tau_ms: must be > 0; got {tau_ms}")
    decay = float(np.exp(-1e3 / (sampling_rate_Hz * tau_ms)))
    mine, theirs = _pair(spikes, others)
    n_steps = int(max(mine.trial_steps.max(initial=0), theirs.trial_steps.max(initial=0)))
    overlap = np.zeros((len(mine.trial_steps), len(theirs.trial_steps)))
    own, their_own = (np.zeros(len(side.trial_steps)) for side in (mine, theirs))
    for afferent in range(mine.n_afferents):
        ours, other = (_raster(side, afferent, n_steps) for side in (mine, theirs))
        if not other.nnz and not ours.nnz:
            continue
        blurred = _blurred(other, decay)
        overlap += ours @ blurred
        their_own += other.multiply(blurred.T).sum(axis=1)
        own += ours.multiply((blurred if mine is theirs else _blurred(ours, decay)).T).sum(axis=1)
    # A sum of products may round to slightly more than its squares.
    squared = np.maximum(own[:, None] + their_own[None, :] - 2 * overlap, 0.0)
    if mine is theirs:
        np.fill_diagonal(squared, 0.0)
    return np.sqrt(squared)


def victor_purpura(
    spikes: Spikes, sampling_rate_Hz: float, *, shift_cost_per_s: float, others: Spikes | None = None
) -> np.ndarray:
    """Distances of trials to other trials (to one another when none are given), `(trial, other)`.

    Victor and Purpura 1996: the least cost of turning one train into the other, where adding or deleting a spike costs
    1 and shifting one by dt costs `shift_cost_per_s` dt. Exact, by the recursion over both trains, for all pairs of
    a block of trials at once.

    >>> trains = np.array([[[1], [0], [0]], [[0], [1], [0]], [[0], [0], [0]]])
    >>> victor_purpura(trains, 1000.0, shift_cost_per_s=300.0)[0].round(3).tolist()
    [0.0, 0.3, 1.0]
    """
    check_rate(sampling_rate_Hz)
    if not 0 <= shift_cost_per_s < np.inf:
        raise InputError(f"shift_cost_per_s: must be >= 0; got {shift_cost_per_s}")
    mine, theirs = _pair(spikes, others)
    total = np.zeros((len(mine.trial_steps), len(theirs.trial_steps)))
    for afferent in range(mine.n_afferents):
        # In units of cost: a shift of one unit costs 1.
        rows, columns = (_padded(side, afferent, shift_cost_per_s / sampling_rate_Hz) for side in (mine, theirs))
        for some in _blocks(rows, ROWS):
            for others_ in _blocks(columns, COLUMNS):
                total[np.ix_(some, others_)] += _least_costs(rows, some, columns, others_)
    return total


class _Padded(NamedTuple):
    """The trains of one afferent: `times` `(spike, trial)`, of which the first `counts` `(trial,)` are valid."""

    times: np.ndarray
    counts: np.ndarray


def _least_costs(a: _Padded, rows: np.ndarray, b: _Padded, columns: np.ndarray) -> np.ndarray:
    """The recursion over the spikes i of one train and j of the other, all pairs of a block side by side."""
    n, m = a.counts[rows], b.counts[columns]
    if not n.any() or not m.any():
        return np.add.outer(n, m).astype(float)
    longest, most = int(n.max()), int(m.max())
    shape = len(rows), len(columns)
    cost = np.empty((most + 1, *shape))
    cost[:] = np.arange(most + 1.0)[:, None, None]
    before, shifted = np.empty_like(cost), np.empty(shape)
    result = np.where(n[:, None] == 0, m[None, :].astype(float), 0.0)
    for i in range(longest):
        before, cost = cost, before
        cost[0] = i + 1.0
        for j in range(most):
            np.subtract(a.times[i, rows][:, None], b.times[j, columns][None, :], out=shifted)
            np.abs(shifted, out=shifted)
            shifted += before[j]
            np.minimum(before[j + 1], cost[j], out=cost[j + 1])
            cost[j + 1] += 1.0
            np.minimum(cost[j + 1], shifted, out=cost[j + 1])
        ends = n == i + 1
        if ends.any():
            result[ends] = cost[m[None, :], np.flatnonzero(ends)[:, None], np.arange(len(m))[None, :]]
    return result


def _blocks(trains: _Padded, size: int) -> list[np.ndarray]:
    """Groups of trials with similar counts, to compute little past the end of a train; silent ones separately."""
    order = np.argsort(trains.counts, kind="stable")
    silent = int(np.searchsorted(trains.counts[order], 1))
    starts = [order[:silent], *(order[i : i + size] for i in range(silent, len(order), size))]
    return [block for block in starts if len(block)]


def _padded(events: Events, afferent: int, scale: float) -> _Padded:
    mine = events.afferent == afferent
    trial, step = events.trial[mine], events.step[mine]
    counts = np.bincount(trial, minlength=len(events.trial_steps))
    rank = np.arange(len(trial)) - np.repeat(np.cumsum(counts) - counts, counts)
    times = np.zeros((int(counts.max(initial=0)), len(counts)))
    times[rank, trial] = step * scale
    return _Padded(times, counts)


def _raster(events: Events, afferent: int, n_steps: int) -> csr_array:
    """Spikes of one afferent, `(trial, time)`."""
    mine = events.afferent == afferent
    ones = np.ones(int(mine.sum()))
    return csr_array((ones, (events.trial[mine], events.step[mine])), shape=(len(events.trial_steps), n_steps))


def _blurred(raster: csr_array, decay: float) -> np.ndarray:
    """Each train under a two-sided exponential, `decay ** |t - t_spike|` summed over its spikes, `(time, trial)`."""
    dense = raster.toarray().T
    after = lfilter([1.0], [1.0, -decay], dense, axis=0)
    before = lfilter([1.0], [1.0, -decay], dense[::-1], axis=0)[::-1]
    return after + before - dense


def _pair(spikes: Spikes, others: Spikes | None) -> tuple[Events, Events]:
    mine = spikes if isinstance(spikes, Events) else events_of_raster(spikes)
    theirs = mine if others is None else others if isinstance(others, Events) else events_of_raster(others)
    if mine.n_afferents != theirs.n_afferents:
        raise InputError(
            f"others: have {theirs.n_afferents} afferents, the trials {mine.n_afferents}; give the same afferents"
        )
    return mine, theirs
