"""What speaks against the way recordings were read: values, lengths and counts that signals of touch rarely have.

Each doubt is one sentence with its fix. None refuses: a rare sensor may be as it seems.
"""

import logging
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from neurotact.checks import swapped
from neurotact.data.readers.clock import FASTEST_HZ, LONGEST_S, SHORTEST_S, SLOWEST_HZ
from neurotact.data.recordings import Recordings
from neurotact.errors import some

RASTER = "neurotact import raster reads spikes, of arrays or of a folder of files"
MOST_COUNTED, SILENT = 5, 0.9
"""Whole numbers up to the first, of which the second share at least is 0, look like spikes that were counted."""
ENDS = tuple(float(2**bits - 1) for bits in (7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 18, 20, 23, 24, 31, 32))
"""Highest values of converters of so many bits; of one with signs, the lowest is the negative of one more."""
AT_THE_END = 0.05
"""Share of the samples at a converter's end above which the signal is cut off."""
LEAST_RISING = 20
"""Samples of a trial from which on a taxel that never falls is a doubt."""
EVEN = 0.1
"""Share of its rise by which a time stamp or a counter may deviate from a straight line; a touch deviates more."""
LEAST_TRIALS = 10
"""Trials from which on a class of its own for each of them is a doubt."""

log = logging.getLogger("neurotact")


class Fixes(NamedTuple):
    """How an import is given again, in words. drop: without a taxel that is none. stamps: with a column of time stamps,
    before `drop`. axes: with other axes; empty if they cannot be wrong.
    """

    drop: str
    stamps: str = ""
    axes: str = ""


class _Values(NamedTuple):
    """What the samples of all trials are: of each taxel, `(taxel,)`, and of all.

    constant: has one value throughout; steady: one value within each trial; rising: rises evenly within
    each trial. low, high: of each taxel. is_whole: every sample is a whole number. zeros: share of the samples.
    """

    constant: np.ndarray
    steady: np.ndarray
    rising: np.ndarray
    low: np.ndarray
    high: np.ndarray
    is_whole: bool
    zeros: float


def say(recordings: Recordings, where: str, fixes: Fixes, *, rate_is_given: bool = True) -> None:
    """Warn of what speaks against recordings as they were read; `where` begins each line.

    rate_is_given: whether the sampling rate was not found from time stamps.
    """
    for doubt in doubts(recordings, fixes, rate_is_given=rate_is_given):
        log.warning("%s: %s", where, doubt)


def doubts(recordings: Recordings, fixes: Fixes, *, rate_is_given: bool = True) -> Iterator[str]:
    """The doubts that `say` prints, one sentence each.

    >>> import pandas as pd
    >>> raster = (np.random.default_rng(0).random((2, 90, 3)) < 0.3).astype(float)
    >>> taps = Recordings(raster, 1000.0, "mV", pd.DataFrame({"label": ["tap", "rub"]}))
    >>> print(*doubts(taps, Fixes("use `columns`")))
    every sample is 0 or 1, as of a raster; neurotact import raster reads spikes, of arrays or of a folder of files
    """
    values = _values_of(recordings.signals)
    is_spikes = _are_spikes(values)
    if is_spikes:
        yield is_spikes
    yield from _of_taxels(recordings, values, fixes, is_spikes=bool(is_spikes))
    yield from _of_lengths(recordings, fixes.axes)
    if rate_is_given:
        yield from _of_rate(recordings)
    yield from _of_classes(recordings)


def _values_of(signals: Sequence[np.ndarray] | np.ndarray) -> _Values:
    first = signals[0][0]
    n_taxels = len(first)
    constant, steady, rising = (np.ones(n_taxels, bool) for _ in range(3))
    low, high = np.full(n_taxels, np.inf), np.full(n_taxels, -np.inf)
    is_whole, zeros, n_samples = True, 0, 0
    for signal in signals:
        bounds = signal.min(axis=0), signal.max(axis=0)
        low, high = np.minimum(low, bounds[0]), np.maximum(high, bounds[1])
        steady &= bounds[0] == bounds[1]
        constant &= (bounds[0] == first) & (bounds[1] == first)
        rising &= _rises(signal)
        is_whole = is_whole and bool((signal == np.floor(signal)).all())
        zeros += int((signal == 0).sum())
        n_samples += signal.size
    return _Values(constant, steady, rising, low, high, is_whole, zeros / n_samples)


def _rises(signal: np.ndarray) -> np.ndarray:
    """Of each taxel of `(time, taxel)`, whether it rises evenly and never falls, for too long to be chance."""
    if len(signal) < LEAST_RISING:
        return np.zeros(signal.shape[1], bool)
    rises = (signal[1:] >= signal[:-1]).all(axis=0) & (signal[-1] > signal[0])
    for taxel in np.flatnonzero(rises):
        line = np.linspace(signal[0, taxel], signal[-1, taxel], len(signal))
        rises[taxel] = np.abs(signal[:, taxel] - line).max() <= EVEN * (line[-1] - line[0])
    return rises


def _are_spikes(values: _Values) -> str:
    """Whether samples look like spikes, in words; empty if they do not."""
    if not values.is_whole or values.low.min() != 0:
        return ""
    most = values.high.max()
    if most == 1:
        return f"every sample is 0 or 1, as of a raster; {RASTER}"
    if 1 < most <= MOST_COUNTED and values.zeros >= SILENT:
        return f"every sample is a whole number from 0 to {most:g}, and most are 0, as of counted spikes; {RASTER}"
    return ""


def _of_taxels(recordings: Recordings, values: _Values, fixes: Fixes, *, is_spikes: bool) -> Iterator[str]:
    names = np.array(recordings.channels)
    if recordings.lengths.max() == 1:
        return
    if values.constant.all():
        yield f"every sample is {values.low[0]:g}, so nothing was recorded; check the file"
        return
    if values.constant.any() and not is_spikes:
        yield f"every sample has the same value in {some(names[values.constant].tolist())}; {fixes.drop}"
    if values.rising.any() and not values.rising.all():
        named = some(names[values.rising].tolist())
        yield f"{named} rises throughout every trial, as time stamps or a counter do; {fixes.stamps}{fixes.drop}"
    telling = [i for i in np.flatnonzero(values.steady & ~values.constant) if _tells_the_class(recordings, int(i))]
    if telling:
        named = some(names[telling].tolist())
        yield f"{named} has one value for each class, as a label does, which would tell a network; {fixes.drop}"
    cut = _share_at_an_end(recordings, values)
    if cut is not None:
        end, share = cut
        yield (
            f"{100 * share:.0f} % of all samples are {end:g}, the end of a converter, where a signal is cut off; lower "
            "the sensor's gain, or drop these trials"
        )


def _tells_the_class(recordings: Recordings, taxel: int) -> bool:
    """Whether a taxel that is steady within trials has one value for each class, and another for each other class."""
    of_trials = np.array([signal[0, taxel] for signal in recordings.signals])
    pairs = {*zip(of_trials.tolist(), recordings.labels.tolist(), strict=True)}
    n_classes = len(recordings.classes)
    return len(pairs) == len({value for value, _ in pairs}) == n_classes < len(recordings)


def _share_at_an_end(recordings: Recordings, values: _Values) -> tuple[float, float] | None:
    """The end of a converter at which too many samples are, and their share; None if there is none."""
    if not values.is_whole:
        return None
    n_samples = int(recordings.lengths.sum()) * recordings.n_channels
    for end in (float(values.high.max()), float(values.low.min())):
        if end in ENDS or (end < 0 and -end - 1 in ENDS):
            share = sum(int((signal == end).sum()) for signal in recordings.signals) / n_samples
            if share > AT_THE_END:
                return end, share
    return None


def _of_lengths(recordings: Recordings, axes: str) -> Iterator[str]:
    lengths = recordings.lengths
    if lengths.max() == 1:
        yield "every trial has one sample, as features without time have, of which no afferent fires; give the signals"
    elif (lengths == 1).any():
        yield f"{(lengths == 1).sum()} of {len(lengths)} trials have one sample; leave them out, or check the trials"
    if axes and (doubt := swapped(int(lengths.max()), recordings.n_channels, "taxel", axes)):
        yield doubt


def _of_rate(recordings: Recordings) -> Iterator[str]:
    rate_Hz, median_s = recordings.sampling_rate_Hz, float(np.median(recordings.lengths)) / recordings.sampling_rate_Hz
    if not SLOWEST_HZ <= rate_Hz <= FASTEST_HZ:
        slow = "slow" if rate_Hz < SLOWEST_HZ else "fast"
        yield f"{rate_Hz:g} Hz is {slow} for touch; check `sampling_rate_Hz`, which is in samples per second"
    elif not SHORTEST_S <= median_s <= LONGEST_S and recordings.lengths.max() > 1:
        long = "short" if median_s < SHORTEST_S else "long"
        yield f"the median trial lasts {median_s:.3g} s at {rate_Hz:g} Hz, which is {long} for touch; check the rate"


def _of_classes(recordings: Recordings) -> Iterator[str]:
    n_classes = len(recordings.classes)
    if n_classes == len(recordings) >= LEAST_TRIALS:
        yield (
            f"each of the {n_classes} trials has a class of its own ({some(list(recordings.classes), 3)}), so none can "
            "be learned and tested; if these are numbers of trials or measured values, name another class"
        )
