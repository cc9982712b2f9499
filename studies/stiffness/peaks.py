"""Grasp peaks: the samples around the drop of piezoelectric taxels in a grasp (stiffness paper, Sec. III-B).

A threshold on any channel triggers; the deepest channel's minimum locates the peak; all channels are cut there. The
same rule works on a whole recording or on its pieces as they arrive, with equal results.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import DTypeLike
from pydantic import Field

from neurotact.errors import InputError
from neurotact.spec import Spec


class PeakSpec(Spec):
    """Detection of a grasp, and the samples to keep (stiffness paper, Sec. IV-B: 30 samples before, 120 after)."""

    threshold: float = Field(default=1.0, gt=0)
    """In the signal's unit: a channel at or below minus this triggers. The paper gives no value."""
    before: int = Field(default=30, ge=0)
    """Samples kept before the minimum."""
    after: int = Field(default=120, ge=1)
    """Samples kept from the minimum on."""
    search: int = Field(default=120, ge=1)
    """Samples from the trigger on in which the minimum is searched."""
    rest: int = Field(default=2000, ge=0)
    """Samples after a peak's end without triggers, to skip the release and its ringing."""

    @property
    def n_samples(self) -> int:
        """Samples of a peak, the paper's n.

        >>> PeakSpec().n_samples
        150
        """
        return self.before + self.after


class Peaks(NamedTuple):
    """Peaks of one recording.

    minimum: sample of the deepest channel's minimum, counted from the recording's first, `(peak,)` int64.
    channel: the deepest channel, `(peak,)` int64.
    samples: `(peak, time, channel)`, `spec.n_samples` long, the minimum at index `spec.before`.
    """

    minimum: np.ndarray
    channel: np.ndarray
    samples: np.ndarray


class PeakState(NamedTuple):
    """The state of the search between pieces.

    kept: the last samples that may still belong to a peak, `(time, channel)`; first: the number of their first.
    armed_from: the number of the sample from which a trigger counts.
    """

    kept: np.ndarray
    first: int
    armed_from: int


def peaks_start(n_channels: int, dtype: DTypeLike = np.float32) -> PeakState:
    """The state before a recording's first sample."""
    return PeakState(np.empty((0, n_channels), dtype), 0, 0)


def next_peaks(signal: np.ndarray, spec: PeakSpec, state: PeakState) -> tuple[Peaks, PeakState]:
    """The peaks that end in a piece of a recording, `(time, channel)`, and the state after it.

    A peak may span any number of pieces: it is returned with the piece that holds its last sample. A peak with fewer
    than `before` samples before its minimum is skipped.

    Raises InputError for a piece with other channels than the previous ones.
    """
    signal = np.asarray(signal)
    if signal.ndim != 2 or signal.shape[1] != state.kept.shape[1]:
        raise InputError(
            f"signal: must be (time, channel) with {state.kept.shape[1]} channels as before; got shape {signal.shape}"
        )
    held = np.concatenate([state.kept, signal])
    triggers = np.flatnonzero((held <= -spec.threshold).any(axis=1))
    peaks: list[tuple[int, int, np.ndarray]] = []
    armed = state.armed_from - state.first
    while True:
        index = np.searchsorted(triggers, armed)
        if index == len(triggers):
            keep_from = max(len(held), armed) - spec.before
            break
        trigger = int(triggers[index])
        keep_from = trigger - spec.before
        if trigger + spec.search > len(held):
            break
        time, channel = _deepest(held[trigger : trigger + spec.search])
        minimum = trigger + time
        end = minimum + spec.after
        if end > len(held):
            break
        if minimum - spec.before >= 0:
            peaks.append((state.first + minimum, channel, held[minimum - spec.before : end]))
        armed = end + spec.rest
    keep_from = min(max(keep_from, 0), len(held))
    after = PeakState(held[keep_from:].copy(), state.first + keep_from, state.first + armed)
    return _as_peaks(peaks, spec, held), after


def find_peaks(signal: np.ndarray, spec: PeakSpec) -> Peaks:
    """The peaks of a whole recording, `(time, channel)`; a peak cut off by the end of the recording is dropped.

    >>> signal = np.zeros((400, 2))
    >>> signal[100:140, 1] = -3.0 * np.hanning(40)
    >>> peaks = find_peaks(signal, PeakSpec())
    >>> peaks.minimum.tolist(), peaks.channel.tolist(), peaks.samples.shape
    ([119], [1], (1, 150, 2))
    """
    signal = np.asarray(signal)
    if signal.ndim != 2:
        raise InputError(f"signal: must be (time, channel); got shape {signal.shape}")
    return next_peaks(signal, spec, peaks_start(signal.shape[1], signal.dtype))[0]


def _deepest(piece: np.ndarray) -> tuple[int, int]:
    """Time and channel of the lowest sample (ties: the first)."""
    time, channel = np.unravel_index(int(piece.argmin()), piece.shape)
    return int(time), int(channel)


def _as_peaks(peaks: list[tuple[int, int, np.ndarray]], spec: PeakSpec, like: np.ndarray) -> Peaks:
    minimum, channel = (np.array([peak[i] for peak in peaks], np.int64) for i in (0, 1))
    shape = (len(peaks), spec.n_samples, like.shape[1])
    samples = np.array([peak[2] for peak in peaks], like.dtype).reshape(shape)
    return Peaks(minimum, channel, samples)
