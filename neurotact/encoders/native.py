"""The compiled encoders: from signals or drives to spikes; `afferents.py` and `closed_form.py` define them."""

import math

import numpy as np

from neurotact.backend import n_threads, native
from neurotact.errors import InputError
from neurotact.neurons import LIF, ExactLIF, ExactLIFState, LIFState

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
        threads=max(1, min(n_threads(), n_trials // TRIALS_OF_A_THREAD)),
    )  # fmt: skip
    return ExactLIFState(membrane, refractory)


def _levels(neuron: LIF | ExactLIF) -> tuple[float, float, float]:
    return neuron.v_rest_mV, neuron.v_reset_mV, neuron.v_threshold_mV


def _at(array: np.ndarray) -> int:
    return array.ctypes.data if math.prod(array.shape) else 0
