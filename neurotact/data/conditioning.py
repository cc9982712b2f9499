"""Conditioning: from a recorded signal to the signal that drives the afferents.

The order is fixed: smoothing (EMA), resampling to the encoder's clock, baseline, standardisation, rectification.
A trial is conditioned whole or, if it is long, piece by piece; the result is the same.
"""

from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, Field
from scipy.signal import lfilter

from neurotact.data.recordings import Recordings, Trials, unit_factor
from neurotact.errors import InputError
from neurotact.files import check_size
from neurotact.spec import Spec

Baseline = Literal["none", "mean", "median", "first", "start", "running", "high-pass"]
Pieces = Callable[[], Iterator[np.ndarray]]
"""Each call starts at the beginning of a trial; all pieces but the last have equally many samples."""
PIECE_VALUES = 1_000_000
"""Samples times taxels: a longer trial is conditioned in pieces of this size."""
HALF = 0.5 + 1e-6
"""Rounds up to whole steps from a half on, rounding errors included, so that a window as long as the trial fits."""
FINEST_CLOCK = 1000
"""Steps of an encoder's clock per sample of a recording, at most: finer clocks cost time and add no information."""


def _not_zero(value: float) -> float:
    if value == 0:
        raise ValueError("must not be 0")
    return value


class ConditioningSpec(Spec):
    """The steps from a recording to the drive of afferents, in this order."""

    ema_cutoff_Hz: float | None = Field(default=None, gt=0)
    """Cut-off of the exponential moving average; none when absent."""
    resample_Hz: float | None = Field(default=None, gt=0)
    """The encoder's clock; the recording's own rate when absent."""
    baseline: Baseline = "none"
    """The level subtracted from each taxel of each trial. `mean` and `median` use the whole trial, so each window
    contains information from later samples (`ACAUSAL`). The others use only the past: the `first` sample, the mean so
    far (`running`), that mean up to `start_ms` (`start`), or an EMA at `high_pass_Hz` (`high-pass`)."""
    start_ms: float = Field(default=100.0, gt=0)
    """The baseline `start` is the mean up to this time, and constant afterwards."""
    high_pass_Hz: float = Field(default=0.5, gt=0)
    """Cut-off of the baseline `high-pass`."""
    offset: tuple[float, ...] | None = None
    """Standardisation, one value per taxel: subtracted first (fitted on training trials by `neurotact calibrate`)."""
    scale: tuple[Annotated[float, AfterValidator(_not_zero)], ...] | None = None
    """Standardisation, one value per taxel: the divisor. Negative for a sensor whose signal falls on contact."""
    rectify: bool = False
    """Take the absolute value at the end."""


USED_BY: dict[str, Baseline] = {"start_ms": "start", "high_pass_Hz": "high-pass"}
"""Keys of a conditioning that only one baseline uses."""


def check_used(given: Container[str], baseline: Baseline, table: str = "conditioning") -> None:
    """InputError if one of the dotted keys `given` has no effect under a baseline.

    table: the dotted key of the conditioning, as the user writes it.

    >>> check_used({"conditioning.high_pass_Hz": 1.0}, "high-pass")
    """
    for key, needed in USED_BY.items():
        if f"{table}.{key}" in given and baseline != needed:
            raise InputError(f"{table}.{key}: the baseline '{baseline}' ignores it; set {table}.baseline={needed}, too")


def condition(recordings: Recordings, how: ConditioningSpec) -> Recordings:
    """Condition every trial; the result has the encoder's sampling rate.

    Raises InputError for a cut-off above the Nyquist frequency and for offsets or scales that do not match the
    taxels.

    >>> import pandas as pd
    >>> skin = Recordings([np.ones((3, 2))], 35.6, "count", pd.DataFrame({"label": ["felt"]}))
    >>> condition(skin, ConditioningSpec(resample_Hz=1000.0, baseline="first")).signals[0].shape
    (84, 2)
    """
    rate_Hz, clock_Hz = recordings.sampling_rate_Hz, how.resample_Hz
    if how.ema_cutoff_Hz is not None:
        smoothing = ema_coefficient(how.ema_cutoff_Hz, rate_Hz)
        recordings = _each(recordings, lambda x: ema(x, smoothing))
    if clock_Hz is not None and clock_Hz != rate_Hz:
        recordings = replace(_each(recordings, lambda x: resample(x, rate_Hz, clock_Hz)), sampling_rate_Hz=clock_Hz)
    if how.baseline in CAUSAL:
        past = Past(how, recordings.sampling_rate_Hz)
        recordings = _each(recordings, lambda x: past.taken_off(x, None)[0])
    elif how.baseline != "none":
        level = BASELINES[how.baseline]
        recordings = _each(recordings, lambda x: x - level(x))
    _check_counts(how, recordings)
    is_plain = how.offset is None and how.scale is None
    if is_plain and not how.rectify:
        return recordings
    conditioned = _each(recordings, lambda x: standardised(x, how.offset, how.scale, how.rectify))
    return conditioned if is_plain else replace(conditioned, unit="sd")


def standardised(
    signal: np.ndarray, offset: Sequence[float] | None, scale: Sequence[float] | None, rectify: bool = False
) -> np.ndarray:
    """`(signal - offset) / scale`, one value per taxel, of `(..., time, taxel)`; its absolute value with `rectify`.

    >>> standardised(np.array([[1.0, 5.0]], np.float32), (2.0, 5.0), (0.5, 1.0)).tolist()
    [[-2.0, 0.0]]
    """
    if offset is not None or scale is not None:
        shift = np.array(0.0 if offset is None else offset, np.float32)
        signal = (signal - shift) / np.array(1.0 if scale is None else scale, np.float32)
    return np.abs(signal) if rectify else signal


def condition_pieces(
    recordings: Trials, trial: int, how: ConditioningSpec, unit: str | None = None
) -> Iterator[np.ndarray]:
    """The conditioned signal of one trial, piece by piece; the concatenation equals `condition`.

    unit: the signal is converted to it; unchanged when absent.
    A baseline that uses the whole trial (`mean`, `median`) is computed in a first pass.

    >>> import pandas as pd
    >>> skin = Recordings([np.ones((3, 2))], 35.6, "count", pd.DataFrame({"label": ["felt"]}))
    >>> how = ConditioningSpec(resample_Hz=1000.0, baseline="first")
    >>> [piece.shape for piece in condition_pieces(skin, 0, how)]
    [(84, 2)]
    """
    factor = unit_factor(recordings.unit, unit or recordings.unit, recordings.source or "recordings")
    _check_counts(how, recordings)

    def sampled() -> Iterator[np.ndarray]:
        return _sampled(recordings, trial, factor, how.ema_cutoff_Hz, how.resample_Hz)

    level = LEVELS[how.baseline](sampled) if how.baseline in LEVELS else None
    past = Past(how, how.resample_Hz or recordings.sampling_rate_Hz)
    carried: Carried | None = None
    for piece in sampled():
        if level is not None:
            piece = piece - level
        elif how.baseline in CAUSAL:
            piece, carried = past.taken_off(piece, carried)
        yield standardised(piece, how.offset, how.scale, how.rectify)


def pieces(recordings: Trials, trial: int) -> Iterator[np.ndarray]:
    """The samples of one trial as recorded, piece by piece."""
    n_rows = max(1, PIECE_VALUES // recordings.n_channels)
    for start in range(0, int(recordings.lengths[trial]), n_rows):
        yield recordings.piece(trial, start, start + n_rows)


def conditioned_length(n_samples: int, rate_Hz: float, resample_Hz: float | None = None) -> int:
    """Steps of a trial of `n_samples` on the encoder's clock: as many as the trial lasts, to the nearest step.

    A sample lasts until the next one would come, so n samples last n / rate. A step at the last sample or before it
    always counts, also where a slower clock would be nearer to the trial's length without it: a stream has made that
    step when the trial ends.

    >>> conditioned_length(200, 100.0, 1000.0), conditioned_length(3, 35.6, 1000.0), conditioned_length(11, 100.0, 10.0)
    (2000, 84, 2)
    """
    to_Hz = resample_Hz or rate_Hz
    if to_Hz > FINEST_CLOCK * rate_Hz:
        raise InputError(
            f"resample_Hz: {to_Hz:g} Hz is over {FINEST_CLOCK:,} times the sampling rate of {rate_Hz:g} Hz; lower it, "
            "or import the recordings again with the right rate or unit of time"
        )
    if to_Hz == rate_Hz:
        return n_samples
    return max(sampled_length(n_samples, rate_Hz, to_Hz), int(np.floor(n_samples / rate_Hz * to_Hz + HALF)))


def sampled_length(n_samples: int, rate_Hz: float, to_Hz: float) -> int:
    """Steps of a trial of `n_samples` up to its last sample; the steps after them hold it.

    >>> sampled_length(200, 100.0, 1000.0)
    1991
    """
    return int(np.floor((n_samples - 1) / rate_Hz * to_Hz + 1e-9)) + 1


def is_long(n_steps: int, n_channels: int) -> bool:
    """Whether a trial is conditioned in pieces."""
    return n_steps * n_channels > PIECE_VALUES


def _sampled(
    recordings: Trials, trial: int, factor: np.float32, cutoff_Hz: float | None, resample_Hz: float | None
) -> Iterator[np.ndarray]:
    """A trial's signal times `factor`, smoothed and resampled."""
    rate_Hz, n_samples = recordings.sampling_rate_Hz, int(recordings.lengths[trial])
    n_rows = max(1, PIECE_VALUES // recordings.n_channels)

    def recorded() -> Iterator[np.ndarray]:
        before = None
        for piece in pieces(recordings, trial):
            piece = piece if factor == 1 else piece * factor
            if cutoff_Hz is not None:
                piece = ema(piece, ema_coefficient(cutoff_Hz, rate_Hz), before)
                before = piece[-1].copy()
            yield piece

    if resample_Hz is None or resample_Hz == rate_Hz:
        return recorded()
    n_at_once = max(1, int(n_rows * min(1.0, resample_Hz / rate_Hz)))  # steps of a slower clock need more samples
    return _regrouped(_resampled(recorded(), n_samples, rate_Hz, resample_Hz, n_at_once), n_rows)


def _resampled(
    signal: Iterator[np.ndarray], n_samples: int, rate_Hz: float, to_Hz: float, n_rows: int
) -> Iterator[np.ndarray]:
    """`resample` of a signal that arrives in pieces, in pieces of `n_rows`."""
    n_resampled, done, first = conditioned_length(n_samples, rate_Hz, to_Hz), 0, 0
    held = next(signal)
    while done < n_resampled:
        wanted = np.arange(done, min(done + n_rows, n_resampled))
        last_needed = min(int(position(wanted[-1:], rate_Hz, to_Hz)[0]) + 1, n_samples - 1)
        parts = [held]
        while first + sum(map(len, parts)) <= last_needed:
            parts.append(next(signal))
        held = np.concatenate(parts) if len(parts) > 1 else held
        yield interpolated(held, position(wanted, rate_Hz, to_Hz), first, n_samples)
        done += len(wanted)
        passed = min(int(position(np.array([done]), rate_Hz, to_Hz)[0]) - first, len(held))
        held, first = held[passed:], first + passed


def _regrouped(signal: Iterator[np.ndarray], n_rows: int) -> Iterator[np.ndarray]:
    """The same signal in pieces of `n_rows`."""
    waiting, n_waiting = [], 0
    for piece in signal:
        while n_waiting + len(piece) >= n_rows:
            missing = n_rows - n_waiting
            yield np.concatenate([*waiting, piece[:missing]])
            waiting, n_waiting, piece = [], 0, piece[missing:]
        if len(piece):
            waiting.append(piece)
            n_waiting += len(piece)
    if waiting:
        yield np.concatenate(waiting)


def _mean(signal: np.ndarray) -> np.ndarray:
    """The mean of each taxel over time, `(..., 1, taxel)`.

    A long trial is added in float64: in float32, samples would be lost in their own sum.
    """
    n_steps, n_channels = signal.shape[-2:]
    if not is_long(n_steps, n_channels):
        return signal.mean(axis=-2, keepdims=True)
    n_rows = max(1, PIECE_VALUES // n_channels)
    parts = (signal[..., start : start + n_rows, :] for start in range(0, n_steps, n_rows))
    total = sum((part.sum(axis=-2, keepdims=True, dtype=np.float64) for part in parts), start=np.zeros(1))
    return (total / n_steps).astype(signal.dtype)


BYTES_WHILE_RESAMPLED = 32
"""Bytes for each value of the result: its position, its neighbours and itself."""

BASELINES: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "mean": _mean,
    "median": lambda x: np.median(x, axis=-2, keepdims=True).astype(x.dtype),
    "first": lambda x: x[..., :1, :],
}
"""The level that is subtracted from a signal `(..., time, taxel)`, as `(..., 1, taxel)`."""


ACAUSAL = ("mean", "median")
"""Baselines that use the whole trial, so each window contains information from later samples."""
ACAUSAL_NOTE = (
    "acausal: the baseline is the {baseline} of each whole trial, so windows contain information from later samples; "
    "conditioning.baseline = none, first, start, running or high-pass is causal"
)
CAUSAL = ("start", "running", "high-pass")
"""Baselines that change during the trial and use only its past, the current sample included."""
Carried = tuple[np.ndarray, int]
"""State between two pieces of a trial: the sum of its samples so far, or the EMA; and their number."""


def acausal_note(encoder: Mapping[str, Any] | None) -> str | None:
    """The note printed with the results of an encoder with an acausal baseline; None for any other.

    encoder: its spec, as spike trains carry it.

    >>> acausal_note({"conditioning": {"baseline": "mean"}})[:47]
    'acausal: the baseline is the mean of each whole'
    """
    baseline = ((encoder or {}).get("conditioning") or {}).get("baseline")
    return ACAUSAL_NOTE.format(baseline=baseline) if baseline in ACAUSAL else None


@dataclass(frozen=True)
class Past:
    """A baseline of `CAUSAL`, for signals at a given rate."""

    how: ConditioningSpec
    sampling_rate_Hz: float

    @property
    def smoothing(self) -> float:
        """Weight of the newest step in the EMA of `high-pass`."""
        return ema_coefficient(self.how.high_pass_Hz, self.sampling_rate_Hz, "high_pass_Hz")

    @property
    def n_start(self) -> int:
        """Number of steps in the mean of the baseline `start`."""
        return max(1, round(self.how.start_ms * 1e-3 * self.sampling_rate_Hz))

    def taken_off(self, signal: np.ndarray, carried: Carried | None) -> tuple[np.ndarray, Carried]:
        """The signal `(..., time, taxel)` without its baseline, and the state for the next piece.

        carried: the state after the previous piece; None at the start of a trial.

        >>> past = Past(ConditioningSpec(baseline="running"), 1000.0)
        >>> past.taken_off(np.array([[2.0], [4.0], [9.0]]), None)[0].ravel().tolist()
        [0.0, 1.0, 4.0]
        """
        if self.how.baseline == "high-pass":
            before, n_before = (None, 0) if carried is None else carried
            followed = ema(signal, self.smoothing, before)
            return signal - followed, (followed[..., -1, :].copy(), n_before + signal.shape[-2])
        return self._mean_taken_off(signal, carried)

    def _mean_taken_off(self, signal: np.ndarray, carried: Carried | None) -> tuple[np.ndarray, Carried]:
        """In float64, sample by sample, so that pieces give the same sum as the whole."""
        total, n_before = (np.zeros_like(signal[..., 0, :], np.float64), 0) if carried is None else carried
        n_steps = signal.shape[-2]
        last = n_before + n_steps
        if self.how.baseline == "start":
            last = self.n_start
        n_new = min(max(last - n_before, 0), n_steps)
        sums = np.cumsum(np.concatenate([total[..., None, :], signal[..., :n_new, :]], axis=-2), axis=-2)
        n_so_far = np.arange(n_before + 1, n_before + n_new + 1)
        level = sums[..., 1:, :] / n_so_far[:, None]
        after = n_before + n_new
        kept = np.repeat(sums[..., -1:, :] / max(1, after), n_steps - n_new, axis=-2)
        levels = np.concatenate([level, kept], axis=-2)
        return signal - levels.astype(signal.dtype), (sums[..., -1, :], after)


def _mean_of_pieces(signal: Pieces) -> np.ndarray:
    total, n_steps, piece = np.zeros(1), 0, np.empty(0)
    for piece in signal():
        n_steps += len(piece)
        total = total + piece.sum(axis=0, keepdims=True, dtype=np.float64)
    return _mean(piece) if len(piece) == n_steps else (total / n_steps).astype(piece.dtype)


def _median_of_pieces(signal: Pieces) -> np.ndarray:
    """The exact median of float32 pieces: a radix search, eleven bits at a time, from the highest bits down."""
    n_steps = sum(map(len, signal()))
    middle = sorted({(n_steps - 1) // 2, n_steps // 2})
    found = np.array([_ranked(signal, rank) for rank in middle], np.float32)
    return found.mean(axis=0, keepdims=True)


def _ranked(signal: Pieces, rank: int) -> np.ndarray:
    """The value of each taxel, `(taxel,)`, with index `rank` in ascending order."""
    prefix, left = None, None
    for shift, bits in ((21, 11), (10, 11), (0, 10)):
        counts: np.ndarray | None = None
        for piece in signal():
            keys = _sortable(piece)
            n_channels = keys.shape[1]
            counts = np.zeros((n_channels, 1 << bits), np.int64) if counts is None else counts
            for channel in range(n_channels):
                mine = keys[:, channel]
                if prefix is not None:
                    mine = mine[(mine >> np.uint32(shift + bits)) == prefix[channel]]
                digit = (mine >> np.uint32(shift)) & np.uint32((1 << bits) - 1)
                counts[channel] += np.bincount(digit, minlength=1 << bits)
        assert counts is not None
        left = np.full(len(counts), rank) if left is None else left
        reached = np.cumsum(counts, axis=1)
        digit = (reached > left[:, None]).argmax(axis=1)
        left = left - np.where(digit > 0, np.take_along_axis(reached, np.maximum(digit - 1, 0)[:, None], 1)[:, 0], 0)
        prefix = digit.astype(np.uint32) if prefix is None else (prefix << np.uint32(bits)) | digit.astype(np.uint32)
    assert prefix is not None
    negative = prefix < 0x80000000
    return np.where(negative, ~prefix, prefix & np.uint32(0x7FFFFFFF)).view(np.float32)


def _sortable(signal: np.ndarray) -> np.ndarray:
    """Unsigned integers in the order of float32 values: all bits inverted if negative, else the sign bit set."""
    bits = (signal + np.float32(0.0)).view(np.uint32)  # so that -0 is 0
    return np.where(bits >> np.uint32(31) == 1, ~bits, bits | np.uint32(0x80000000))


LEVELS: dict[str, Callable[[Pieces], np.ndarray]] = {
    "mean": _mean_of_pieces,
    "median": _median_of_pieces,
    "first": lambda signal: next(signal())[:1],
}
"""`BASELINES` of a trial in pieces, `(1, taxel)`."""


def ema_coefficient(cutoff_Hz: float, rate_Hz: float, key: str = "ema_cutoff_Hz") -> float:
    """Weight of the newest sample, `1 - exp(-2 pi cutoff / rate)`; InputError, which names `key`, from Nyquist up.

    >>> round(ema_coefficient(30.0, 2000.0), 4)
    0.0899
    """
    if cutoff_Hz >= rate_Hz / 2:
        raise InputError(
            f"{key}: {cutoff_Hz:g} Hz is not below the Nyquist frequency of {rate_Hz / 2:g} Hz; "
            "lower it or leave it out"
        )
    return float(1.0 - np.exp(-2.0 * np.pi * cutoff_Hz / rate_Hz))


def ema(signal: np.ndarray, coefficient: float, before: np.ndarray | None = None) -> np.ndarray:
    """`y[t] = y[t-1] + coefficient (x[t] - y[t-1])` along time, `(..., time, taxel)`.

    before: y just before the signal begins, `(..., taxel)`: the last output of the previous piece. Without it,
        y[0] = x[0].

    >>> ema(np.array([[0.0], [1.0], [1.0]]), 0.5).ravel().tolist()
    [0.0, 0.5, 0.75]
    """
    carried = signal[..., :1, :] if before is None else before[..., None, :]
    kind = signal.dtype.type
    b, a = np.array([coefficient], kind), np.array([1.0, coefficient - 1.0], kind)
    smooth, _ = lfilter(b, a, signal, axis=-2, zi=kind(1.0 - coefficient) * carried)
    return smooth


def resample(signal: np.ndarray, rate_Hz: float, to_Hz: float) -> np.ndarray:
    """Linear interpolation of `(..., time, taxel)` at another rate; the last sample holds until the trial ends.

    The result lasts as long as the trial (`conditioned_length`). Before going to a lower rate, apply an EMA.

    >>> resample(np.array([[0.0], [2.0]]), 1.0, 2.0).ravel().tolist()
    [0.0, 1.0, 2.0, 2.0]
    """
    n_samples = signal.shape[-2]
    n_resampled = conditioned_length(n_samples, rate_Hz, to_Hz)
    check_size(f"a trial resampled to {to_Hz:g} Hz", n_resampled * signal[..., :1, :].size * BYTES_WHILE_RESAMPLED)
    return interpolated(signal, position(np.arange(n_resampled), rate_Hz, to_Hz), 0, n_samples)


def position(steps: np.ndarray, rate_Hz: float, to_Hz: float) -> np.ndarray:
    """The positions of steps of one clock between the samples of another."""
    return steps * (rate_Hz / to_Hz)


def interpolated(signal: np.ndarray, position: np.ndarray, first: int, n_samples: int) -> np.ndarray:
    """Interpolates a signal of `n_samples`, of which those from `first` on are given; the last one holds."""
    before = np.minimum(position.astype(np.int64), n_samples - 1)
    after = np.minimum(before + 1, n_samples - 1)
    weight = (position - before).astype(signal.dtype)[:, None]
    left = np.take(signal, before - first, axis=-2)
    return left + weight * (np.take(signal, after - first, axis=-2) - left)


def fit_standardisation(signals: Sequence[np.ndarray]) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """`(offset, scale)`: mean and standard deviation of each taxel over training trials.

    A constant taxel gets scale 1, so that it stays silent and finite.

    >>> fit_standardisation([np.array([[1.0, 5.0], [3.0, 5.0]])])
    ((2.0, 5.0), (1.0, 1.0))
    """
    n_samples = sum(len(s) for s in signals)
    mean = sum(s.sum(axis=0, dtype=np.float64) for s in signals) / n_samples
    variance = sum(((s - mean) ** 2).sum(axis=0, dtype=np.float64) for s in signals) / n_samples
    deviation = np.sqrt(variance)
    still = deviation <= 1e-12 * np.maximum(1.0, np.abs(mean))
    return tuple(np.asarray(mean).tolist()), tuple(np.where(still, 1.0, deviation).tolist())


def _each(recordings: Recordings, change: Callable[[np.ndarray], np.ndarray]) -> Recordings:
    signals = recordings.signals
    changed = change(signals) if isinstance(signals, np.ndarray) else [change(s) for s in signals]
    return replace(recordings, signals=changed)


def _check_counts(how: ConditioningSpec, recordings: Trials) -> None:
    for values in (how.offset, how.scale):
        if values is not None and len(values) != recordings.n_channels:
            raise InputError(
                f"{recordings.source or 'recordings'}: has {recordings.n_channels} channels but the encoder's "
                f"conditioning has {len(values)} offsets or scales; calibrate an encoder for this sensor"
            )
