"""Conditioning of a signal during recording: block by block, the state is an argument and a result.

The concatenated result equals `conditioning.condition` of the whole trial to the last bit, for any block size, one
sample included. Baselines that use the whole trial cannot be subtracted before it ends.
"""

from typing import NamedTuple

import numpy as np

from neurotact.data.conditioning import (
    ACAUSAL,
    CAUSAL,
    Carried,
    ConditioningSpec,
    Past,
    conditioned_length,
    ema,
    ema_coefficient,
    interpolated,
    position,
    standardised,
)
from neurotact.errors import InputError


class Conditioned(NamedTuple):
    """The state of conditioning between two blocks of a trial.

    n_samples, n_steps: samples received and steps of the encoder's clock returned so far.
    smoothed: the moving average after the last sample, `(taxel,)`; held: the last smoothed samples, which resampling
    still needs, `(sample, taxel)`; level: the first sample, `(1, taxel)`; carried: the state of a moving baseline.
    None where there is none yet.
    """

    n_samples: int = 0
    n_steps: int = 0
    smoothed: np.ndarray | None = None
    held: np.ndarray | None = None
    level: np.ndarray | None = None
    carried: Carried | None = None


class Conditioner:
    """Conditioning of blocks `(sample, taxel)` float32 of one trial, as `condition` does.

    factor: multiplies the samples first (see `unit_factor`).
    Raises InputError for a baseline that uses the whole trial.

    >>> how = ConditioningSpec(ema_cutoff_Hz=30.0, baseline="first")
    >>> conditioner, state = Conditioner(2000.0, how), Conditioned()
    >>> first, state = conditioner.push(np.array([[2.0], [3.0]], np.float32), state)
    >>> second, state = conditioner.push(np.array([[3.0]], np.float32), state)
    >>> first.ravel().tolist()[0], second.shape
    (0.0, (1, 1))
    """

    def __init__(self, sampling_rate_Hz: float, how: ConditioningSpec, *, factor: np.float32 = np.float32(1.0)) -> None:
        if how.baseline in ACAUSAL:
            raise InputError(
                f"conditioning.baseline: '{how.baseline}' uses the whole trial, which a stream has not received yet; "
                "encode and train with conditioning.baseline start, first, running, high-pass or none"
            )
        self.how, self.rate_Hz, self.factor = how, sampling_rate_Hz, factor
        self.clock_Hz = how.resample_Hz or sampling_rate_Hz
        self.smoothing = None if how.ema_cutoff_Hz is None else ema_coefficient(how.ema_cutoff_Hz, sampling_rate_Hz)
        self.past = Past(how, self.clock_Hz)

    def push(self, samples: np.ndarray, state: Conditioned) -> tuple[np.ndarray, Conditioned]:
        """The steps `(step, taxel)` that these samples complete, and the state after them.

        Resampling gives a step when the samples on both of its sides are known.
        """
        if not len(samples):
            return samples, state
        signal = samples if self.factor == 1 else samples * self.factor
        if self.smoothing is not None:
            signal = ema(signal, self.smoothing, state.smoothed)
            state = state._replace(smoothed=signal[-1].copy())
        state = state._replace(n_samples=state.n_samples + len(samples))
        signal, state = self._on_the_clock(signal, state, at_end=False)
        return self._without_baseline(signal, state)

    def whole(self, samples: np.ndarray) -> np.ndarray:
        """The steps `(step, taxel)` of a whole trial of samples."""
        steps, state = self.push(samples, Conditioned())
        last, _ = self.finish(state)
        return np.concatenate([steps, last]) if len(last) else steps

    def finish(self, state: Conditioned) -> tuple[np.ndarray, Conditioned]:
        """The steps of resampling from the last sample to the trial's end, which hold that sample; none without it."""
        if state.held is None:
            return np.empty((0, 0), np.float32), state
        signal, state = self._on_the_clock(state.held[:0], state, at_end=True)
        return self._without_baseline(signal, state)

    def _on_the_clock(self, signal: np.ndarray, state: Conditioned, *, at_end: bool) -> tuple[np.ndarray, Conditioned]:
        if self.clock_Hz == self.rate_Hz:
            return signal, state._replace(n_steps=state.n_steps + len(signal))
        held = signal if state.held is None else np.concatenate([state.held, signal])
        first = state.n_samples - len(held)
        steps = np.arange(state.n_steps, conditioned_length(state.n_samples, self.rate_Hz, self.clock_Hz))
        places = position(steps, self.rate_Hz, self.clock_Hz)
        if not at_end:
            whole = places.astype(np.int64)
            places = places[(whole + 1 < state.n_samples) | (places == whole)]
        n_steps = state.n_steps + len(places)
        needed = int(position(np.array([n_steps]), self.rate_Hz, self.clock_Hz)[0]) - first
        signal = interpolated(held, places, first, state.n_samples)
        kept = held[min(needed, len(held) - 1) :].copy()
        return signal, state._replace(held=kept, n_steps=n_steps)

    def _without_baseline(self, signal: np.ndarray, state: Conditioned) -> tuple[np.ndarray, Conditioned]:
        if not len(signal):
            return signal, state
        if self.how.baseline == "first":
            level = signal[:1].copy() if state.level is None else state.level
            signal, state = signal - level, state._replace(level=level)
        elif self.how.baseline in CAUSAL:
            signal, carried = self.past.taken_off(signal, state.carried)
            state = state._replace(carried=carried)
        return standardised(signal, self.how.offset, self.how.scale, self.how.rectify), state
