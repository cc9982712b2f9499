"""The stretches of training trials for the fit of gains: drawn at random, conditioned as for an encoder.

Where choices hang on them, they are drawn by numbers of the trials themselves (`numbers_of`): a trial that is left out
then changes no other's, and not every accuracy by as much as its standard error.
"""

import zlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from neurotact.data.conditioning import ConditioningSpec, condition_pieces, sampled_length, standardised
from neurotact.data.recordings import Trials
from neurotact.data.spool import Spool

LOOKED_AT = 256
"""Samples at the beginning, in the middle and at the end of a trial that give its number."""


@dataclass(frozen=True)
class Excerpts:
    """Conditioned excerpts of the trials for the fit of gains.

    signals: `(time, taxel)` each, as the encoder takes them, at `sampling_rate_Hz`.
    labels: class index of each. numbers: of the trials, by which what follows is drawn (`numbers_of`); None: at random.
    """

    signals: Spool
    labels: np.ndarray
    classes: tuple[str, ...]
    sampling_rate_Hz: float
    source: str
    numbers: np.ndarray | None = None

    @property
    def n_channels(self) -> int:
        return self.signals[0].shape[1]


def numbers_of(recordings: Trials, seed: int) -> np.ndarray:
    """A random number of each trial, `(trial,)` from 0 to 1: of its samples and the seed, whatever the other trials.

    >>> import pandas as pd
    >>> from neurotact.data.recordings import Recordings
    >>> touched = np.random.default_rng(0).normal(size=(3, 50, 2)).astype(np.float32)
    >>> every = Recordings(touched, 100.0, "mV", pd.DataFrame({"label": list("aab")}))
    >>> numbers_of(every, 1)[1:].tolist() == numbers_of(every.select([1, 2]), 1).tolist()
    True
    """
    numbers = np.empty(len(recordings))
    for trial, n_samples in enumerate(recordings.lengths.tolist()):
        digest = seed
        for first in (0, n_samples // 2, max(0, n_samples - LOOKED_AT)):
            piece = recordings.piece(trial, first, min(n_samples, first + LOOKED_AT))
            digest = zlib.crc32(np.ascontiguousarray(piece, np.float32).tobytes(), digest)
        numbers[trial] = np.random.default_rng([seed, digest]).random()
    return numbers


def draw(labels: np.ndarray, per_class: int, rng: np.random.Generator, numbers: np.ndarray | None = None) -> np.ndarray:
    """At most `per_class` trials of each class, at random or those of the smallest `numbers`; sorted indices."""
    of_each = (np.flatnonzero(labels == label) for label in np.unique(labels))
    if numbers is None:
        trials = [rng.permutation(own)[:per_class] for own in of_each]
    else:
        trials = [own[np.argsort(numbers[own], kind="stable")][:per_class] for own in of_each]
    return np.sort(np.concatenate(trials))


def permuted(labels: np.ndarray, n: int, rng: np.random.Generator, numbers: np.ndarray | None = None) -> np.ndarray:
    """Random permutations of labels, `(permutation, trial)`; by `numbers`, one trial less changes few other labels."""
    if numbers is None:
        return np.stack([rng.permutation(labels) for _ in range(n)])
    places = np.stack([np.random.default_rng(int(number * 2**53)).random(n) for number in numbers]).argsort(axis=0)
    found = np.empty((n, len(labels)), labels.dtype)
    np.put_along_axis(found, places.T, np.sort(labels)[None], axis=1)
    return found


def cut(
    recordings: Trials,
    conditioning: ConditioningSpec,
    longest_s: float,
    rng: np.random.Generator,
    numbers: np.ndarray | None = None,
) -> Spool:
    """A stretch of each trial, at a random time up to its last sample, or at that of its number.

    The trial is conditioned before it is cut, as for an encoder.
    """
    rate_Hz, clock_Hz = recordings.sampling_rate_Hz, conditioning.clock_Hz(recordings.sampling_rate_Hz)
    how = conditioning.model_copy(update={"offset": None, "scale": None, "rectify": False})

    def stretches() -> Iterator[np.ndarray]:
        for trial, n_samples in enumerate(recordings.lengths.tolist()):
            n_steps = sampled_length(n_samples, rate_Hz, clock_Hz)
            length = min(n_steps, max(1, round(longest_s * clock_Hz)))
            n_starts = n_steps - length + 1
            start = int(rng.integers(n_starts) if numbers is None else numbers[trial] * n_starts)
            pieces = condition_pieces(recordings, trial, how, n_steps=start + length)
            yield _from(start, pieces)

    return Spool(stretches())


def _from(start: int, pieces: Iterable[np.ndarray]) -> np.ndarray:
    """The steps from `start` on of a signal that comes in pieces."""
    parts, first = [], 0
    for piece in pieces:
        parts.append(piece[max(0, start - first) :].copy())  # a view would keep the whole piece
        first += len(piece)
    return np.concatenate(parts)


def liveliest(signals: Iterable[np.ndarray], most: int) -> np.ndarray:
    """At most `most` taxels: the one that varies most in each signal, then the second of each, and so on.

    So each touch moves one of them, wherever on the sensor it is. Returns sorted indices.

    >>> one, other = np.array([[0.0, 0.0, 0.0], [9.0, 5.0, 1.0]]), np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 3.0]])
    >>> liveliest([one, other], 2).tolist(), liveliest([one, other], 3).tolist()
    ([0, 2], [0, 1, 2])
    """
    orders = np.stack([np.argsort(-signal.std(axis=0), kind="stable") for signal in signals])
    in_turn = dict.fromkeys(orders.T.ravel().tolist())
    return np.sort(np.array([*in_turn][:most]))


def standardise(excerpts: Spool, how: ConditioningSpec) -> Spool:
    """The excerpts after standardisation, as the populations receive them."""
    return excerpts.then(lambda signal: standardised(signal, how.offset, how.scale, how.rectify))
