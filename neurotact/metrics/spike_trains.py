"""Statistics of spike trains: counts, rates, inter-spike intervals, Fano factor.

Rates and intervals as in the texture paper, Sec. VI-B and Fig. 10. Every function takes either a raster
`(trial, time, afferent)` of zeros and ones or `Events`, which hold only the spikes, for trials of any length.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from neurotact.errors import InputError


class Events(NamedTuple):
    """The spikes of all trials end to end, in order of trial, then afferent, then step.

    trial, afferent, step: one entry per spike, `(spike,)` int64.
    trial_steps: length of each trial in steps, `(trial,)` int64.
    n_afferents: the afferents of every trial, silent ones included.
    """

    trial: np.ndarray
    afferent: np.ndarray
    step: np.ndarray
    trial_steps: np.ndarray
    n_afferents: int


class Intervals(NamedTuple):
    """Inter-spike intervals of all trials and afferents: trial, afferent and length, `(interval,)` each."""

    trial: np.ndarray
    afferent: np.ndarray
    isi_ms: np.ndarray


Spikes = np.ndarray | Events


def events(
    steps: Sequence[np.ndarray], units: Sequence[np.ndarray], trial_steps: np.ndarray, n_afferents: int
) -> Events:
    """Events from one array of steps and one of afferent indices per trial, in any order.

    trial_steps: length of each trial in steps, `(trial,)`.
    Raises InputError if their lengths differ, a spike is outside its trial or afferents, or one afferent
    spikes twice in one step.

    >>> felt = events([np.array([1, 3])], [np.array([0, 0])], np.array([10]), n_afferents=2)
    >>> spike_counts(felt).tolist()
    [[2, 0]]
    """
    lengths = np.array([len(s) for s in steps], np.int64)
    trial_steps = np.asarray(trial_steps, np.int64)
    if len(units) != len(steps) or trial_steps.shape != (len(steps),):
        raise InputError(f"spikes: {len(steps)} trials of steps, {len(units)} of units, {trial_steps.size} lengths")
    if not np.array_equal(lengths, [len(u) for u in units]):
        raise InputError("spikes: a trial has more steps than units or fewer; give one unit per step")
    step, unit = (np.concatenate([np.empty(0, np.int64), *parts]).astype(np.int64) for parts in (steps, units))
    trial = np.repeat(np.arange(len(lengths)), lengths)
    outside = (step < 0) | (step >= trial_steps[trial]) | (unit < 0) | (unit >= n_afferents)
    if outside.any():
        first = int(np.argmax(outside))
        raise InputError(
            f"spikes: trial {trial[first]} has a spike of afferent {unit[first]} at step {step[first]}, outside its "
            f"{n_afferents} afferents and {trial_steps[trial[first]]} steps"
        )
    return _sorted(trial, unit, step, trial_steps, n_afferents)


def events_of_raster(raster: np.ndarray) -> Events:
    """Events from a raster `(trial, time, afferent)` of zeros and ones.

    >>> events_of_raster(np.array([[[0, 1], [1, 1]]])).step.tolist()
    [1, 0, 1]
    """
    raster = _checked(raster)
    n_trials, n_steps, n_afferents = raster.shape
    index = np.flatnonzero(raster.swapaxes(1, 2))
    group = index // n_steps
    trial = group // n_afferents
    return Events(
        trial, group - trial * n_afferents, index - group * n_steps, np.full(n_trials, n_steps, np.int64), n_afferents
    )


def spike_counts(spikes: Spikes) -> np.ndarray:
    """Spikes of each trial and afferent, `(trial, afferent)` int64.

    >>> spike_counts(np.array([[[0, 1], [1, 1]]])).tolist()
    [[1, 2]]
    """
    if not isinstance(spikes, Events):
        return _checked(spikes).sum(axis=1, dtype=np.int64)
    n_trials = len(spikes.trial_steps)
    counts = np.bincount(_group(spikes), minlength=n_trials * spikes.n_afferents)
    return counts.reshape(n_trials, spikes.n_afferents).astype(np.int64)


def rates_Hz(spikes: Spikes, sampling_rate_Hz: float) -> np.ndarray:  # noqa: N802
    """Firing rates, `FR = n_spikes / T` with T the trial's length (texture paper, Sec. VI-B), `(trial, afferent)`.

    >>> rates_Hz(np.array([[[0, 1], [1, 1]]]), sampling_rate_Hz=2000.0).tolist()
    [[1000.0, 2000.0]]
    """
    check_rate(sampling_rate_Hz)
    counts = spike_counts(spikes)
    steps = spikes.trial_steps[:, None] if isinstance(spikes, Events) else np.array(np.shape(spikes)[1])
    if (steps < 1).any():
        raise InputError("spikes: a trial without steps has no rate; drop it")
    return counts / (steps / sampling_rate_Hz)


def isis_ms(spikes: Spikes, sampling_rate_Hz: float) -> Intervals:
    """Every interval between one spike and the next of the same trial and afferent (texture paper, Sec. VI-B).

    An afferent with fewer than two spikes has none.

    >>> isis_ms(np.array([[[1], [0], [1], [1]]]), sampling_rate_Hz=2000.0).isi_ms.tolist()
    [1.0, 0.5]
    """
    check_rate(sampling_rate_Hz)
    trains = spikes if isinstance(spikes, Events) else events_of_raster(spikes)
    group = _group(trains)
    within = group[1:] == group[:-1]
    isi = np.diff(trains.step)[within] * (1e3 / sampling_rate_Hz)
    return Intervals(trains.trial[1:][within], trains.afferent[1:][within], isi)


def _sorted(trial: np.ndarray, unit: np.ndarray, step: np.ndarray, trial_steps: np.ndarray, n_afferents: int) -> Events:
    # One sort of one key is several times faster than an indirect sort of three.
    longest = int(trial_steps.max(initial=1))
    key = np.sort((trial * n_afferents + unit) * longest + step)
    if (key[1:] == key[:-1]).any():
        raise InputError("spikes: an afferent spikes twice in one step; remove the double events")
    group, step = np.divmod(key, longest)
    return Events(group // n_afferents, group % n_afferents, step, trial_steps, n_afferents)


def _group(spikes: Events) -> np.ndarray:
    return spikes.trial * spikes.n_afferents + spikes.afferent


def _checked(raster: np.ndarray) -> np.ndarray:
    """The raster, as truth values if its elements are bytes: NumPy finds those that are true several times faster."""
    raster = np.asarray(raster)
    if raster.ndim != 3:
        raise InputError(f"spikes: a raster is (trial, time, afferent); got shape {raster.shape}")
    is_bits = raster.dtype == bool or (raster.dtype == np.uint8 and raster.max(initial=0) <= 1)
    if not is_bits and not ((raster == 0) | (raster == 1)).all():
        raise InputError("spikes: a raster holds zeros and ones; got other values")
    return raster.view(bool) if raster.dtype == np.uint8 else raster


def check_rate(sampling_rate_Hz: float) -> None:
    """Refuse a sampling rate that is not a positive number."""
    if not (np.isfinite(sampling_rate_Hz) and sampling_rate_Hz > 0):
        raise InputError(f"sampling_rate_Hz: must be a positive number; got {sampling_rate_Hz}")
