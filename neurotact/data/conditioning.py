"""Conditioning: from a recorded signal to the signal that drives the afferents.

The order is fixed: smoothing (EMA), resampling to the encoder's clock, baseline, standardisation, rectification.
A trial is conditioned whole, piece by piece if it is long, or block by block as it is recorded; the result is the same.
"""

import math
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import AfterValidator, Field

from neurotact.backend import native
from neurotact.data.recordings import Recordings, Trials, unit_factor
from neurotact.errors import InputError
from neurotact.files import check_size
from neurotact.spec import Spec

Baseline = Literal["none", "mean", "start", "high-pass"]
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
    """The level subtracted from each taxel of each trial. `mean` is that of the whole trial, so each window contains
    information from later samples (`ACAUSAL`). The others use only the past: the mean so far up to `start_ms`, then
    constant (`start`), or an EMA at `high_pass_Hz` (`high-pass`)."""
    start_ms: float = Field(default=100.0, gt=0)
    """The baseline `start` is the mean up to this time, and constant afterwards."""
    high_pass_Hz: float = Field(default=0.5, gt=0)
    """Cut-off of the baseline `high-pass`."""
    offset: tuple[float, ...] | None = None
    """Standardisation, one value per taxel: subtracted first (fitted on training trials by `neurotact calibrate`)."""
    scale: tuple[Annotated[float, AfterValidator(_not_zero)], ...] | None = None
    """Standardisation, one value per taxel: the divisor. Negative for a sensor whose signal falls on contact."""
    taxels: tuple[str, ...] | None = None
    """Names of the taxels that `offset` and `scale` are of (`neurotact calibrate`). Recordings whose taxels have these
    names are put into this order."""
    rectify: bool = False
    """Take the absolute value at the end."""

    def clock_Hz(self, recorded_Hz: float) -> float:  # noqa: N802
        """Steps per second of the encoder, for a recording of that rate.

        >>> ConditioningSpec().clock_Hz(93.0), ConditioningSpec(resample_Hz=1000.0).clock_Hz(93.0)
        (93.0, 1000.0)
        """
        return self.resample_Hz or recorded_Hz


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
    >>> condition(skin, ConditioningSpec(resample_Hz=1000.0, baseline="start")).signals[0].shape
    (84, 2)
    """
    conditioner = Conditioner(recordings.sampling_rate_Hz, how)
    _check_counts(how, recordings)
    signals = [conditioner.whole(signal) for signal in recordings.signals]
    is_plain = how.offset is None and how.scale is None
    return replace(
        recordings,
        signals=np.stack(signals) if isinstance(recordings.signals, np.ndarray) else signals,
        sampling_rate_Hz=conditioner.clock_Hz,
        unit=recordings.unit if is_plain else "sd",
    )


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
    recordings: Trials, trial: int, how: ConditioningSpec, unit: str | None = None, n_steps: int | None = None
) -> Iterator[np.ndarray]:
    """The conditioned signal of one trial, piece by piece; the concatenation equals `condition`.

    unit: the signal is converted to it; unchanged when absent. n_steps: so many from the start, if there are more.
    The baseline `mean`, which uses the whole trial, is computed in a first pass.

    >>> import pandas as pd
    >>> skin = Recordings([np.ones((3, 2))], 35.6, "count", pd.DataFrame({"label": ["felt"]}))
    >>> how = ConditioningSpec(resample_Hz=1000.0, baseline="start")
    >>> [piece.shape for piece in condition_pieces(skin, 0, how)]
    [(84, 2)]
    """
    factor = unit_factor(recordings.unit, unit or recordings.unit, recordings.source or "recordings")
    conditioner = Conditioner(recordings.sampling_rate_Hz, how, factor=factor)
    _check_counts(how, recordings)
    n_rows = _rows_at_once(recordings)
    n_samples = max(1, int(n_rows * min(1.0, conditioner.rate_Hz / conditioner.clock_Hz)))
    needed = math.inf  # samples, up to that after the last step
    if n_steps is not None and how.baseline not in ACAUSAL:
        needed = int(_position(np.array(n_steps - 1), conditioner.rate_Hz, conditioner.clock_Hz)) + 2

    def sampled() -> Iterator[np.ndarray]:
        signal = conditioner.sampled(pieces(recordings, trial, n_samples, needed))
        return signal if conditioner.clock_Hz == conditioner.rate_Hz else _regrouped(signal, n_rows)

    state, level = Conditioned(), _mean(sampled()) if how.baseline in ACAUSAL else None
    left = n_steps
    for piece in sampled():
        signal, state = conditioner.without_baseline(piece[:left], state, level)
        left = None if left is None else left - len(signal)
        yield signal


def pieces(recordings: Trials, trial: int, n_rows: int | None = None, most: float = math.inf) -> Iterator[np.ndarray]:
    """The samples of one trial as recorded, at `most` so many, in pieces of `n_rows`; of `PIECE_VALUES` when None."""
    n_rows, stop = n_rows or _rows_at_once(recordings), int(min(recordings.lengths[trial], most))
    for start in range(0, stop, n_rows):
        yield recordings.piece(trial, start, min(start + n_rows, stop))


def _rows_at_once(recordings: Trials) -> int:
    return max(1, PIECE_VALUES // recordings.n_channels)


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


ACAUSAL = ("mean",)
"""Baselines that use the whole trial, so each window contains information from later samples."""
ACAUSAL_NOTE = (
    "acausal: the baseline is the {baseline} of each whole trial, so windows contain information from later samples; "
    "conditioning.baseline = none, start or high-pass is causal"
)
CAUSAL = ("start", "high-pass")
"""Baselines that change during the trial and use only its past, the current sample included."""
BYTES_WHILE_RESAMPLED = 32
"""Bytes for each value of the result: its position, its neighbours and itself."""
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


class Conditioned(NamedTuple):
    """The state of conditioning between two blocks of a trial.

    n_samples, n_steps: samples received and steps of the encoder's clock returned so far.
    smoothed: the moving average after the last sample, `(taxel,)`; held: the last smoothed samples, which resampling
    still needs, `(sample, taxel)`;
    carried: the state of a baseline of the past.
    None where there is none yet.
    """

    n_samples: int = 0
    n_steps: int = 0
    smoothed: np.ndarray | None = None
    held: np.ndarray | None = None
    carried: Carried | None = None


class Conditioner:
    """Conditioning of blocks `(sample, taxel)` of one trial; the state is an argument and a result.

    The concatenated blocks equal the whole trial to the last bit, for any size of a block, one sample included.
    factor: multiplies the samples first (see `unit_factor`).

    >>> how = ConditioningSpec(ema_cutoff_Hz=30.0, baseline="start")
    >>> conditioner, state = Conditioner(2000.0, how), Conditioned()
    >>> first, state = conditioner.push(np.array([[2.0], [3.0]], np.float32), state)
    >>> second, state = conditioner.push(np.array([[3.0]], np.float32), state)
    >>> first.ravel().tolist()[0], second.shape
    (0.0, (1, 1))
    """

    def __init__(self, sampling_rate_Hz: float, how: ConditioningSpec, *, factor: np.float32 = np.float32(1.0)) -> None:
        self.how, self.rate_Hz, self.factor = how, sampling_rate_Hz, factor
        self.clock_Hz = how.clock_Hz(sampling_rate_Hz)
        self.smoothing = None if how.ema_cutoff_Hz is None else ema_coefficient(how.ema_cutoff_Hz, sampling_rate_Hz)
        self.following = None
        """Weight of the newest step in the EMA of `high-pass`."""
        if how.baseline == "high-pass":
            self.following = ema_coefficient(how.high_pass_Hz, self.clock_Hz, "high_pass_Hz")
        self.n_start = max(1, round(how.start_ms * 1e-3 * self.clock_Hz))
        """Number of steps in the mean of the baseline `start`."""

    def push(self, samples: np.ndarray, state: Conditioned) -> tuple[np.ndarray, Conditioned]:
        """The steps `(step, taxel)` that these samples complete, and the state after them.

        Resampling gives a step when the samples on both of its sides are known.
        """
        return self.without_baseline(*self._on_the_clock(samples, state))

    def finish(self, state: Conditioned) -> tuple[np.ndarray, Conditioned]:
        """The steps of resampling from the last sample to the trial's end, which hold that sample; none without it."""
        if state.held is None:
            return np.empty((0, 0), np.float32), state
        return self.without_baseline(*self._on_the_clock(state.held[:0], state, at_end=True))

    def whole(self, samples: np.ndarray) -> np.ndarray:
        """The steps `(step, taxel)` of a whole trial of samples."""
        signal, state = self._on_the_clock(samples, Conditioned(), at_end=True)
        level = _mean([signal]) if self.how.baseline in ACAUSAL else None
        return self.without_baseline(signal, state, level)[0]

    def sampled(self, blocks: Iterable[np.ndarray]) -> Iterator[np.ndarray]:
        """The smoothed and resampled signal of a whole trial, block by block."""
        state = Conditioned()
        for block in blocks:
            signal, state = self._on_the_clock(block, state)
            yield signal
        if state.held is not None:
            yield self._on_the_clock(state.held[:0], state, at_end=True)[0]

    def without_baseline(
        self, signal: np.ndarray, state: Conditioned, level: np.ndarray | None = None
    ) -> tuple[np.ndarray, Conditioned]:
        """The conditioned steps of a smoothed and resampled signal, and the state after them.

        level: the mean of the whole trial, `(1, taxel)`, which the baseline `mean` needs.
        """
        if not len(signal):
            return signal, state
        if self.how.baseline in ACAUSAL:
            if level is None:
                raise InputError(
                    f"conditioning.baseline: '{self.how.baseline}' uses the whole trial, which a stream has not "
                    "received yet; encode and train with conditioning.baseline start, high-pass or none"
                )
            signal = signal - level
        elif self.following is not None:
            before, n_before = state.carried or (None, 0)
            followed = ema(signal, self.following, before)
            state = state._replace(carried=(followed[-1].copy(), n_before + len(signal)))
            signal = signal - followed
        elif self.how.baseline == "start":
            signal, state = self._without_mean(signal, state)
        return standardised(signal, self.how.offset, self.how.scale, self.how.rectify), state

    def _on_the_clock(
        self, samples: np.ndarray, state: Conditioned, *, at_end: bool = False
    ) -> tuple[np.ndarray, Conditioned]:
        """The smoothed samples on the encoder's clock. at_end: whether the last sample holds until the trial's end."""
        signal = samples if self.factor == 1 else samples * self.factor
        if self.smoothing is not None and len(signal):
            signal = ema(signal, self.smoothing, state.smoothed)
            state = state._replace(smoothed=signal[-1].copy())
        state = state._replace(n_samples=state.n_samples + len(signal))
        if self.clock_Hz == self.rate_Hz:
            return signal, state._replace(n_steps=state.n_steps + len(signal))
        held = signal if state.held is None else np.concatenate([state.held, signal])
        first = state.n_samples - len(held)
        steps = np.arange(state.n_steps, conditioned_length(state.n_samples, self.rate_Hz, self.clock_Hz))
        check_size(f"a trial resampled to {self.clock_Hz:g} Hz", len(steps) * held[:1].size * BYTES_WHILE_RESAMPLED)
        places = _position(steps, self.rate_Hz, self.clock_Hz)
        if not at_end:
            whole = places.astype(np.int64)
            places = places[(whole + 1 < state.n_samples) | (places == whole)]
        n_steps = state.n_steps + len(places)
        needed = int(_position(np.array([n_steps]), self.rate_Hz, self.clock_Hz)[0]) - first
        signal = interpolated(held, places, first, state.n_samples)
        return signal, state._replace(held=held[min(needed, len(held) - 1) :].copy(), n_steps=n_steps)

    def _without_mean(self, signal: np.ndarray, state: Conditioned) -> tuple[np.ndarray, Conditioned]:
        """Without the mean so far: in float64, sample by sample, so that blocks give the same sum as the whole."""
        total, n_before = state.carried or (np.zeros(signal.shape[1]), 0)
        n_steps = len(signal)
        n_new = min(max(self.n_start - n_before, 0), n_steps)
        sums = np.cumsum(np.concatenate([total[None], signal[:n_new]]), axis=0)
        after = n_before + n_new
        levels = sums[1:] / np.arange(n_before + 1, after + 1)[:, None]
        kept = np.repeat(sums[-1:] / max(1, after), n_steps - n_new, axis=0)
        levels = np.concatenate([levels, kept]).astype(signal.dtype)
        return signal - levels, state._replace(carried=(sums[-1], after))


def _mean(signal: Iterable[np.ndarray]) -> np.ndarray:
    """A long trial is added in float64: in float32, samples would be lost in their own sum."""
    total, n_steps, piece = np.zeros(1), 0, np.empty(0)
    for piece in signal:
        n_steps += len(piece)
        n_rows = max(1, PIECE_VALUES // piece.shape[1])
        for start in range(0, len(piece), n_rows):
            total = total + piece[start : start + n_rows].sum(axis=0, keepdims=True, dtype=np.float64)
    if len(piece) == n_steps and not is_long(*piece.shape):
        return piece.mean(axis=0, keepdims=True)
    return (total / n_steps).astype(piece.dtype)


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
    if native is not None and signal.dtype == np.float32:
        given, carried = (np.ascontiguousarray(values, np.float32) for values in (signal, carried))
        *trials, n_steps, n_taxels = given.shape
        native.moving_average(
            smooth=(smooth := np.empty_like(given)).ctypes.data, signal=given.ctypes.data, before=carried.ctypes.data,
            newest=coefficient, kept=1.0 - coefficient, trials=math.prod(trials), steps=n_steps, taxels=n_taxels,
        )  # fmt: skip
        return smooth
    from scipy.signal import lfilter

    kind = signal.dtype.type
    b, a = np.array([coefficient], kind), np.array([1.0, coefficient - 1.0], kind)
    smooth, _ = lfilter(b, a, signal, axis=-2, zi=kind(1.0 - coefficient) * carried)
    return smooth


def _position(steps: np.ndarray, rate_Hz: float, to_Hz: float) -> np.ndarray:
    """The positions of steps of one clock between the samples of another."""
    return steps * (rate_Hz / to_Hz)


def interpolated(signal: np.ndarray, position: np.ndarray, first: int, n_samples: int) -> np.ndarray:
    """Interpolates a signal of `n_samples`, of which those from `first` on are given; the last one holds."""
    before = np.minimum(position.astype(np.int64), n_samples - 1)
    after = np.minimum(before + 1, n_samples - 1)
    weight = (position - before).astype(signal.dtype)[:, None]
    left = np.take(signal, before - first, axis=-2)
    return left + weight * (np.take(signal, after - first, axis=-2) - left)


def _check_counts(how: ConditioningSpec, recordings: Trials) -> None:
    for values in (how.offset, how.scale):
        if values is not None and len(values) != recordings.n_channels:
            raise InputError(
                f"{recordings.source or 'recordings'}: has {recordings.n_channels} channels but the encoder's "
                f"conditioning has {len(values)} offsets or scales; calibrate an encoder for this sensor"
            )
