"""The stretches of training trials for the fit of gains: drawn at random, conditioned as for an encoder."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from neurotact.data.conditioning import ConditioningSpec, condition_pieces, sampled_length, standardised
from neurotact.data.recordings import Trials
from neurotact.data.spool import Spool


@dataclass(frozen=True)
class Excerpts:
    """Conditioned excerpts of the trials for the fit of gains.

    signals: `(time, taxel)` each, as the encoder takes them, at `sampling_rate_Hz`.
    labels: class index of each.
    """

    signals: Spool
    labels: np.ndarray
    classes: tuple[str, ...]
    sampling_rate_Hz: float
    source: str

    @property
    def n_channels(self) -> int:
        return self.signals[0].shape[1]


def draw(labels: np.ndarray, per_class: int, rng: np.random.Generator) -> np.ndarray:
    """At most `per_class` trials of each class, at random; sorted indices."""
    trials = (rng.permutation(np.flatnonzero(labels == label))[:per_class] for label in np.unique(labels))
    return np.sort(np.concatenate(list(trials)))


def cut(recordings: Trials, conditioning: ConditioningSpec, longest_s: float, rng: np.random.Generator) -> Spool:
    """A stretch of each trial, at a random time up to its last sample.

    The trial is conditioned before it is cut, as for an encoder.
    """
    rate_Hz, clock_Hz = recordings.sampling_rate_Hz, conditioning.clock_Hz(recordings.sampling_rate_Hz)
    how = conditioning.model_copy(update={"offset": None, "scale": None, "rectify": False})

    def stretches() -> Iterator[np.ndarray]:
        for trial, n_samples in enumerate(recordings.lengths.tolist()):
            n_steps = sampled_length(n_samples, rate_Hz, clock_Hz)
            length = min(n_steps, max(1, round(longest_s * clock_Hz)))
            start = int(rng.integers(n_steps - length + 1))
            yield _stretch(condition_pieces(recordings, trial, how), start, start + length)

    return Spool(stretches())


def _stretch(pieces: Iterable[np.ndarray], start: int, stop: int) -> np.ndarray:
    """The steps from `start` to before `stop` of a signal that comes in pieces."""
    parts, first = [], 0
    for piece in pieces:
        parts.append(piece[max(0, start - first) : max(0, stop - first)].copy())  # a view would keep the whole piece
        first += len(piece)
        if first >= stop:
            break
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


def standardise(excerpts: Iterable[np.ndarray], conditioning: ConditioningSpec) -> Iterator[np.ndarray]:
    """The excerpts after standardisation, as the populations receive them."""
    for signal in excerpts:
        yield standardised(signal, conditioning.offset, conditioning.scale, conditioning.rectify)
