"""The compiled encoders: from signals or drives to spikes; `afferents.py` and `closed_form.py` define them."""

import math
from typing import NamedTuple, Self

import numpy as np

from neurotact.backend import n_threads, native
from neurotact.errors import InputError
from neurotact.neurons import LIF, ExactLIF, ExactLIFState, LIFState, exact_lif_start

LANES = 8
"""Taxels that the kernels of LIF afferents compute side by side."""
TRIALS_OF_A_THREAD = 4
"""With fewer, waking a thread takes longer than what it computes, as in a stream, which has one trial."""


def encode(
    signal: np.ndarray,
    gains: tuple[float, float],
    neurons: tuple[LIF, LIF],
    states: tuple[LIFState, LIFState],
    last: np.ndarray | None,
    out: np.ndarray | None = None,
) -> tuple[np.ndarray, tuple[LIFState, LIFState], np.ndarray | None]:
    """Spikes `(trial, time, 2 taxel)` uint8 of both populations, their next states, and the last sample.

    signal: conditioned, `(trial, time, taxel)`, float32 or float64; the arithmetic is done in its type.
    gains: SA-I drive in mV per unit; RA-I drive in mV per unit of change from one sample to the next.
    neurons, states: of the SA-I and of the RA-I population; they differ only in their refractory steps.
    last: the sample before the first, `(trial, taxel)`; None: the first change is 0.
    out: an array of the result's shape to write to, so that encoding in a loop allocates no memory.
    """
    n_trials, n_steps, n_taxels = signal.shape
    sa1, ra1 = neurons
    if (sa1.decay, *_levels(sa1)) != (ra1.decay, *_levels(ra1)):
        raise InputError("neurons: SA-I and RA-I may differ only in refractory_steps; encode them separately")
    if signal.strides[2] != signal.itemsize or any(s % signal.itemsize for s in signal.strides):
        signal = np.ascontiguousarray(signal)
    shape = (n_trials, n_steps, 2 * n_taxels)
    if out is None:
        out = np.empty(shape, np.uint8)
    elif out.shape != shape or out.dtype != np.uint8 or not out.flags.c_contiguous or not out.flags.writeable:
        raise InputError(f"out: must be a writable C-contiguous uint8 array {shape}; got {out.dtype} {out.shape}")
    membranes = [np.array(state.membrane_mV, signal.dtype, order="C") for state in states]
    silent = [np.array(state.silent_steps, np.int32, order="C") for state in states]
    latest = np.zeros((n_trials, n_taxels), signal.dtype) if last is None else np.array(last, signal.dtype, order="C")
    for array in (*membranes, *silent, latest):
        if array.shape != (n_trials, n_taxels):
            raise InputError(f"state: has shape {array.shape} where (trial, taxel) is {(n_trials, n_taxels)}")
    itemsize = signal.itemsize
    v_rest, v_reset, v_threshold = _levels(sa1)
    native.encode(  # pyright: ignore[reportOptionalMemberAccess]
        is_double=signal.dtype == np.float64, trials=n_trials, steps=n_steps, taxels=n_taxels, signal=_at(signal),
        trial_stride=signal.strides[0] // itemsize, time_stride=signal.strides[1] // itemsize,
        sa_gain=gains[0], ra_gain=gains[1], decay=sa1.decay, v_rest=v_rest, v_reset=v_reset, v_threshold=v_threshold,
        sa_silent=sa1.refractory_steps, ra_silent=ra1.refractory_steps,
        sa_membrane=_at(membranes[0]), ra_membrane=_at(membranes[1]), last=_at(latest),
        sa_silent_left=_at(silent[0]), ra_silent_left=_at(silent[1]), has_last=last is not None,
        spikes=_at(out), threads=n_threads(),
    )  # fmt: skip
    following = tuple(LIFState(*parts) for parts in zip(membranes, silent, strict=True))
    return out, (following[0], following[1]), last if n_steps == 0 else latest


def encode_exact(
    drive: np.ndarray,
    neuron: ExactLIF,
    state: ExactLIFState,
    spikes: np.ndarray,
    *,
    rate_Hz: float,
    clock_Hz: float,
    samples_before: int,
    first_step: int,
) -> ExactLIFState:
    """Mark the spikes of LIF neurons in closed form in `spikes`, `(trial, step, afferent)` uint8; their next state.

    drive: mV, `(trial, sample, afferent)`, float32 or float64; the arithmetic is done in float64.
    rate_Hz, clock_Hz: of the samples and of the steps. samples_before: samples of the trials before these.
    first_step: the number of the step that comes first in `spikes`, which reaches to the end of the last sample.
    """
    n_trials, n_samples, n_afferents = drive.shape
    drive, t_ref_ms = np.ascontiguousarray(drive), np.array(neuron.t_ref_ms, np.float64)
    membrane, refractory = (np.array(values, np.float64, order="C") for values in state)
    for array in (membrane, refractory):
        if array.shape != (n_trials, n_afferents) or t_ref_ms.shape != (n_afferents,):
            raise InputError(f"state: has shape {array.shape} where (trial, afferent) is {(n_trials, n_afferents)}")
    v_rest, v_reset, v_threshold = _levels(neuron)
    native.encode_exact(  # pyright: ignore[reportOptionalMemberAccess]
        is_double=drive.dtype == np.float64, trials=n_trials, samples=n_samples, steps=spikes.shape[1],
        afferents=n_afferents, drive=_at(drive), t_ref_ms=_at(t_ref_ms), tau_ms=neuron.tau_mem_ms, v_rest=v_rest,
        v_reset=v_reset, v_threshold=v_threshold, sample_ms=1e3 / rate_Hz, steps_per_ms=1e-3 * clock_Hz,
        steps_per_sample=clock_Hz / rate_Hz, samples_before=samples_before, first_step=first_step,
        membrane=_at(membrane), refractory_ms=_at(refractory), spikes=_at(spikes),
        threads=threads_of(n_trials),
    )  # fmt: skip
    return ExactLIFState(membrane, refractory)


class Tally(NamedTuple):
    """What a search for gains asks of the spikes of some afferents, in place of their raster.

    bin_of: the bin of an interval of so many steps. floor: the longest interval at the refractory floor.
    ends: the steps of each trial, `(trial,)`; later ones do not count. last: the step of the last spike, -1 if there is
    none, `(trial, afferent)`. intervals: between spikes, `(trial, afferent, bin)`; at_floor: of these, `(trial,)`.
    """

    bin_of: np.ndarray
    floor: int
    ends: np.ndarray
    last: np.ndarray
    intervals: np.ndarray
    at_floor: np.ndarray

    @classmethod
    def empty(cls, ends: np.ndarray, n_afferents: int, edges: np.ndarray, floor: int) -> Self:
        """Before the first spike. edges: of the bins in steps, after which a last bin stays empty (`shares_of`)."""
        from neurotact.metrics.isi_distributions import bins_of

        shape = len(ends), n_afferents
        return cls(
            bins_of(edges, int(ends.max(initial=0))).astype(np.int32),
            floor,
            ends.astype(np.int64),
            np.full(shape, -1, np.int32),
            np.zeros((*shape, len(edges)), np.int32),
            np.zeros(len(ends), np.int64),
        )

    @property
    def counts(self) -> np.ndarray:
        """Spikes, `(trial, afferent)`."""
        return self.intervals.sum(axis=-1) + (self.last >= 0)

    def at(self, first: int) -> dict[str, int]:
        """The arguments of a kernel whose afferents are those from `first` on."""
        pitch = self.last.shape[1]
        size = self.last.itemsize
        return {
            "bin_of": _at(self.bin_of), "bins": self.intervals.shape[2], "floor": self.floor, "ends": _at(self.ends),
            "pitch": pitch, "last_spike": _at(self.last) + first * size,
            "intervals": _at(self.intervals) + first * self.intervals.shape[2] * size, "at_floor": _at(self.at_floor),
        }  # fmt: skip


def tally_raster(raster: np.ndarray, tally: Tally) -> None:
    """Tally the spikes of a raster `(trial, step, afferent)` uint8, whose neighbouring afferents lie side by side."""
    native.tally_raster(  # pyright: ignore[reportOptionalMemberAccess]
        spikes=_at(raster), trials=len(raster), trial_stride=raster.strides[0], time_stride=raster.strides[1],
        afferents=raster.shape[2], **tally.at(0),
    )  # fmt: skip


def tally_population(felt: np.ndarray, gain: float, neuron: LIF, tally: Tally, first: int) -> None:
    """Tally the spikes of LIF neurons that are driven by `gain` times `felt`; their rows begin at `first`.

    felt: `(trial, step, taxel)` float32, contiguous; as many taxels as `LANES` divides, zeros in those that are added.
    """
    v_rest, v_reset, v_threshold = _levels(neuron)
    native.tally_population(  # pyright: ignore[reportOptionalMemberAccess]
        trials=len(felt), steps=felt.shape[1], taxels=felt.shape[2], felt=_at(felt), gain=gain, decay=neuron.decay,
        v_rest=v_rest, v_reset=v_reset, v_threshold=v_threshold, silent=neuron.refractory_steps,
        threads=n_threads(), **tally.at(first),
    )  # fmt: skip


def tally_exact(drive: np.ndarray, neuron: ExactLIF, tally: Tally, *, rate_Hz: float, clock_Hz: float) -> None:
    """Tally the spikes of LIF neurons in closed form, from rest; arguments as those of `encode_exact`.

    drive: `(trial, sample, afferent)` float32, contiguous.
    """
    t_ref_ms = np.array(neuron.t_ref_ms, np.float64)
    membrane, refractory = (np.ascontiguousarray(values) for values in exact_lif_start(neuron, len(drive)))
    v_rest, v_reset, v_threshold = _levels(neuron)
    native.tally_exact(  # pyright: ignore[reportOptionalMemberAccess]
        trials=len(drive), samples=drive.shape[1], afferents=drive.shape[2], drive=_at(drive), t_ref_ms=_at(t_ref_ms),
        tau_ms=neuron.tau_mem_ms, v_rest=v_rest, v_reset=v_reset, v_threshold=v_threshold, sample_ms=1e3 / rate_Hz,
        steps_per_ms=1e-3 * clock_Hz, steps_per_sample=clock_Hz / rate_Hz, membrane=_at(membrane),
        refractory_ms=_at(refractory), threads=n_threads(), **tally.at(0),
    )  # fmt: skip


def threads_of(n_trials: int) -> int:
    """Threads of a kernel that shares trials among them: each has `TRIALS_OF_A_THREAD` or more."""
    return max(1, min(n_threads(), n_trials // TRIALS_OF_A_THREAD))


def _levels(neuron: LIF | ExactLIF) -> tuple[float, float, float]:
    return neuron.v_rest_mV, neuron.v_reset_mV, neuron.v_threshold_mV


def _at(array: np.ndarray) -> int:
    return array.ctypes.data if math.prod(array.shape) else 0
