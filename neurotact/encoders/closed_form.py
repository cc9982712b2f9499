"""LIF afferents that are computed once per sample, in closed form, and not at each step of a clock.

Between two samples the drive of an afferent is constant: that of the last sample. So the times of its spikes have a
closed form (`neurons.exact_lif_interval`), and a sensor of 100 Hz costs 100 updates per second, and what its spikes
cost, at any clock. The clock of the encoder is only that of the bins that the spikes are put into. A sensor that is
faster than that clock is resampled to it first, as for any encoder.
"""

import warnings
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from neurotact.backend import Backend, use_native
from neurotact.data.conditioning import conditioned_length
from neurotact.encoders import native
from neurotact.encoders.afferents import AfferentSpec, Gains, drives
from neurotact.encoders.model import checked
from neurotact.errors import InputError
from neurotact.metrics.flops import Cost, in_registers
from neurotact.neurons import ExactLIF, ExactLIFState, exact_lif_interval, exact_lif_start

AT_ONCE = 1e-9
"""Of a step: times this close to the border of a bin are on it."""


class ExactState(NamedTuple):
    """The state of an encoder between samples.

    membrane_mV, refractory_ms: of all afferents, `(trial, afferent)` float64, refractory from the next sample on.
    waiting: spikes in the bin that the samples so far do not fill, `(trial, afferent)` uint8.
    last: the last sample, `(trial, taxel)`. n_samples, n_steps: samples received and steps returned so far.
    """

    membrane_mV: np.ndarray
    refractory_ms: np.ndarray
    waiting: np.ndarray
    last: np.ndarray | None
    n_samples: int
    n_steps: int


def encode(
    signal: np.ndarray,
    sampling_rate_Hz: float,
    spec: AfferentSpec,
    state: ExactState | None = None,
    *,
    backend: Backend = "auto",
) -> tuple[np.ndarray, ExactState]:
    """Spikes of conditioned samples, `(trial, sample, taxel)` to `(trial, step, afferent)` uint8, SA-I first.

    The steps are those of the encoder's clock, `conditioning.resample_Hz`, that end with the last sample's interval or
    before; without it there is one per sample. Step k holds the spikes after its begin and until its end; several of an
    afferent count as one. The state is an argument and a result, so that a recording in pieces gives the spikes of the
    whole. RA-I are driven by the change from the sample before, for as long as the sample holds; 0 at the first one.

    backend: which implementation runs. Their logarithms and exponentials may differ in the last bit, so that a spike
        within some 1e-9 of the border of a step may be in the other one.

    >>> from neurotact.encoders.specs import load
    >>> spec = load("sa1-ra1-lif", {"integration": "exact", "conditioning.resample_Hz": 1000.0, "sa1.t_ref_ms": 5.0})
    >>> spikes, _ = encode(np.full((1, 2, 1), 6.25), 100.0, spec)  # 3.2 * 6.25 = 20 mV
    >>> spikes.shape, np.flatnonzero(spikes[0, :, 0]).tolist()
    ((1, 20, 2), [6, 18])
    """
    spikes, state = _with_begun_step(signal, sampling_rate_Hz, spec, state, backend)
    return spikes[:, :-1], state


def encode_whole(
    signal: np.ndarray, sampling_rate_Hz: float, spec: AfferentSpec, *, backend: Backend = "auto"
) -> np.ndarray:
    """The spikes of whole trials: those of `encode`, and the step that `finish` adds."""
    spikes, state = _with_begun_step(signal, sampling_rate_Hz, spec, None, backend)
    return spikes[:, : _length(sampling_rate_Hz, spec, state)]


def tally(felt: np.ndarray, sampling_rate_Hz: float, spec: AfferentSpec, part: str, to: native.Tally) -> None:
    """Tally the spikes of `encode` of the afferents of one type, of a plain spec whose populations have all taxels.

    felt: `(trial, sample, taxel)` float32, the signal or its rectified change.
    """
    rate_Hz, clock_Hz = sampling_rate_Hz, spec.conditioning.clock_Hz(sampling_rate_Hz)
    gains, neuron = _gains(spec, rate_Hz)[part == "ra1"], _neuron(spec, felt.shape[2], 1e3 / clock_Hz)
    drive = np.concatenate([felt.dtype.type(gain) * felt for gain in gains], axis=2)
    periods = neuron.t_ref_ms[-drive.shape[2] :] if part == "ra1" else neuron.t_ref_ms[: drive.shape[2]]
    native.tally_exact(drive, replace(neuron, t_ref_ms=periods), to, rate_Hz=rate_Hz, clock_Hz=clock_Hz)


def _gains(spec: AfferentSpec, rate_Hz: float) -> Gains:
    return spec.sa1.gains, tuple(gain * rate_Hz * 1e-3 for gain in spec.ra1.gains)


def _with_begun_step(
    signal: np.ndarray, sampling_rate_Hz: float, spec: AfferentSpec, state: ExactState | None, backend: Backend
) -> tuple[np.ndarray, ExactState]:
    """The spikes of `encode` and, as a last step, those in the one that the samples do not fill."""
    signal = checked(signal)
    rate_Hz, clock_Hz = sampling_rate_Hz, spec.conditioning.clock_Hz(sampling_rate_Hz)
    n_trials, n_samples, n_taxels = signal.shape
    neuron = _neuron(spec, n_taxels, 1e3 / clock_Hz)
    n_afferents = len(neuron.t_ref_ms)
    if state is None:
        state = ExactState(*exact_lif_start(neuron, n_trials), np.zeros((n_trials, n_afferents), np.uint8), None, 0, 0)
    drive, last = drives(
        signal, _gains(spec, rate_Hz), state.last, spec.columns(n_taxels), rate_steps=spec.sa1.rate_ms * rate_Hz * 1e-3,
        half_wave=spec.ra1.change != "rectified",
    )  # fmt: skip
    n_steps = n_complete(state.n_samples + n_samples, rate_Hz, clock_Hz)
    spikes = np.zeros((n_trials, n_steps - state.n_steps + 1, n_afferents), np.uint8)
    spikes[:, 0] = state.waiting
    compiled = use_native(backend, drive.dtype in (np.float32, np.float64), "signals in float32 or float64")
    lif = (native.encode_exact if compiled else _encode_by_samples)(
        drive, neuron, ExactLIFState(state.membrane_mV, state.refractory_ms), spikes,
        rate_Hz=rate_Hz, clock_Hz=clock_Hz, samples_before=state.n_samples, first_step=state.n_steps,
    )  # fmt: skip
    return spikes, ExactState(*lif, spikes[:, -1].copy(), last, state.n_samples + n_samples, n_steps)


def _encode_by_samples(
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
    """The definition of `native.encode_exact`, sample by sample; writes to `spikes`."""
    steps_per_sample = clock_Hz / rate_Hz
    for before, now in enumerate(drive.swapaxes(0, 1), start=samples_before):
        fired, state = exact_lif_interval(neuron, now.astype(np.float64), state, 1e3 / rate_Hz)
        steps = np.ceil(before * steps_per_sample + fired.time_ms * (1e-3 * clock_Hz) - AT_ONCE).astype(np.int64) - 1
        first, last = (n_complete(n_samples, rate_Hz, clock_Hz) for n_samples in (before, before + 1))
        trial, afferent = np.divmod(fired.which, now.shape[1])
        spikes[trial, np.clip(steps, first, last) - first_step, afferent] = 1
    return state


def finish(sampling_rate_Hz: float, spec: AfferentSpec, state: ExactState) -> np.ndarray:
    """The steps that the end of a trial adds, `(trial, step, afferent)`: none, or one, if half of it is filled.

    With them a trial has the steps of `conditioned_length`. No afferent fires after the last sample's interval.
    """
    n_steps = _length(sampling_rate_Hz, spec, state)
    rest = np.zeros((len(state.waiting), n_steps - state.n_steps, state.waiting.shape[1]), np.uint8)
    rest[:, :1] = state.waiting[:, None][:, : rest.shape[1]]
    return rest


def _length(sampling_rate_Hz: float, spec: AfferentSpec, state: ExactState) -> int:
    """The steps of a trial that ends here."""
    return conditioned_length(state.n_samples, sampling_rate_Hz, spec.conditioning.clock_Hz(sampling_rate_Hz))


def n_complete(n_samples: int, rate_Hz: float, clock_Hz: float) -> int:
    """The steps that end within the intervals of `n_samples`."""
    return int(n_samples * (clock_Hz / rate_Hz) + AT_ONCE)


def _neuron(spec: AfferentSpec, n_taxels: int, step_ms: float) -> ExactLIF:
    kinds = {"sa1": spec.sa1, "ra1": spec.ra1}
    for key, kind in kinds.items():
        if kind.t_ref_ms < step_ms * (1 - AT_ONCE):
            warnings.warn(
                f"{key}.t_ref_ms: {kind.t_ref_ms:g} ms is shorter than a step of {step_ms:g} ms, in which several "
                "spikes of an afferent count as one; raise conditioning.resample_Hz",
                stacklevel=5,
            )
    periods = [
        np.full(len(taxels) * len(kind.gains), kind.t_ref_ms)
        for taxels, kind in zip(spec.columns(n_taxels), kinds.values(), strict=True)
    ]
    levels = {"v_rest_mV": spec.v_rest_mV, "v_reset_mV": spec.v_reset_mV, "v_threshold_mV": spec.v_threshold_mV}
    return ExactLIF(spec.tau_mem_ms, np.concatenate(periods), **levels)


def cost_of_spikes(spikes: float) -> Cost:
    """What so many spikes cost in one decision, a mean or a number, beside the afferents once per sample.

    Per spike: its time takes two differences, a division, a logarithm and a MAC; the end of its refractory period an
    addition and a comparison with the end of the sample; the membrane from there to that end a difference, a product,
    an exponential, a difference and a MAC, and a comparison with the threshold; its bin a product that is rounded up.

    >>> cost_of_spikes(10).flops
    340
    """
    if not spikes >= 0:
        raise InputError(f"spikes: must be >= 0; got {spikes}")
    timed, ended = in_registers(macs=1, acs=2, divisions=1, exponentials=1), in_registers(acs=1, comparisons=1)
    carried = in_registers(macs=1, acs=2, multiplications=1, exponentials=1, comparisons=1)
    binned = in_registers(multiplications=1, comparisons=1)
    return (timed + ended + carried + binned).times(spikes)
