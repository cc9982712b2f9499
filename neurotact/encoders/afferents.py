"""SA-I and RA-I afferents: LIF neurons driven by a taxel's signal and by its rate of change.

Texture paper, Eqs. 1 to 3 and Tables II and III. SA-I feels `gain x`, RA-I feels `gain |dx/dt|`.
"""

from typing import ClassVar, Literal, NamedTuple

import numpy as np
from pydantic import Field, model_validator

from neurotact.backend import Backend, use_native
from neurotact.data.conditioning import ConditioningSpec
from neurotact.encoders import native
from neurotact.errors import InputError
from neurotact.neurons import LIF, LIFState, decay_per_step, lif_start, lif_step, refractory_steps
from neurotact.spec import Spec


class AfferentType(Spec):
    """One population: an afferent of this type under each taxel."""

    gain: float = Field(gt=0)
    """Drive in mV, for each unit of the conditioned signal (SA-I) or each unit per ms (RA-I)."""
    t_ref_ms: float = Field(default=1.0, ge=0)
    """Refractory period."""


class AfferentSpec(Spec):
    """An SA-I and an RA-I population over every taxel (`encoders/*.toml`)."""

    folder: ClassVar[str] = "encoders"

    model: Literal["lif"] = "lif"
    """Leaky integrate-and-fire neurons."""
    unit: str = "mV"
    """The unit of the recordings that the encoder takes."""
    v_rest_mV: float = -65.0
    """Membrane potential at rest, to which it decays without drive."""
    v_reset_mV: float = -65.0
    """Membrane potential after a spike and throughout the refractory period."""
    v_threshold_mV: float = -55.0
    """Membrane potential at which the neuron fires."""
    tau_mem_ms: float = Field(default=10.0, gt=0)
    """Time constant of the membrane."""
    conditioning: ConditioningSpec = ConditioningSpec()
    sa1: AfferentType
    """Driven by the signal."""
    ra1: AfferentType
    """Driven by the signal's rate of change."""

    @model_validator(mode="after")
    def _can_fire(self) -> "AfferentSpec":
        if self.v_threshold_mV <= max(self.v_rest_mV, self.v_reset_mV):
            raise ValueError("v_threshold_mV must be above v_rest_mV and v_reset_mV, else the neuron never rests")
        return self

    def neuron(self, kind: AfferentType, sampling_rate_Hz: float) -> LIF:
        """The neuron of a population on a clock."""
        return LIF(
            decay=decay_per_step(self.tau_mem_ms, sampling_rate_Hz),
            refractory_steps=refractory_steps(kind.t_ref_ms, sampling_rate_Hz),
            v_rest_mV=self.v_rest_mV,
            v_reset_mV=self.v_reset_mV,
            v_threshold_mV=self.v_threshold_mV,
        )


class EncoderState(NamedTuple):
    """What an encoder remembers between pieces: both populations and the signal's last sample, `(trial, taxel)`.

    `last` is None before the first sample.
    """

    sa1: LIFState
    ra1: LIFState
    last: np.ndarray | None


def encode(
    signal: np.ndarray,
    sampling_rate_Hz: float,
    spec: AfferentSpec,
    state: EncoderState | None = None,
    *,
    out: np.ndarray | None = None,
    backend: Backend = "auto",
) -> tuple[np.ndarray, EncoderState]:
    """Spikes of conditioned signals, `(trial, time, taxel)` to `(trial, time, 2 taxel)` uint8, SA-I first.

    The state goes in and comes out, so that a recording encoded in pieces gives the spikes of the whole. The
    arithmetic is done in the signal's float type. At the very first sample the derivative is 0.

    out: an array of the result's shape to write to, so that encoding in a loop asks for no memory.
    backend: which implementation runs; all give the same spikes.

    >>> spec = AfferentSpec(sa1=AfferentType(gain=3.2), ra1=AfferentType(gain=16.0))
    >>> spikes, _ = encode(np.full((1, 200, 1), 10.0), 2000.0, spec)
    >>> spikes.shape, spikes.sum(axis=1).tolist()
    ((1, 200, 2), [[20, 0]])
    """
    signal = checked(signal)
    neurons = (spec.neuron(spec.sa1, sampling_rate_Hz), spec.neuron(spec.ra1, sampling_rate_Hz))
    # RA-I feels the change per ms; per sample it is this much.
    gains = (spec.sa1.gain, spec.ra1.gain * sampling_rate_Hz * 1e-3)
    state = _start(signal, neurons) if state is None else state
    if use_native(backend, signal.dtype in (np.float32, np.float64), "signals in float32 or float64"):
        spikes, populations, last = native.encode(signal, gains, neurons, (state.sa1, state.ra1), state.last, out)
        return spikes, EncoderState(*populations, last)
    return _encode_by_steps(signal, gains, neurons, state, out)


def _encode_by_steps(
    signal: np.ndarray,
    gains: tuple[float, float],
    neurons: tuple[LIF, LIF],
    state: EncoderState,
    out: np.ndarray | None,
) -> tuple[np.ndarray, EncoderState]:
    """The definition: a step at a time."""
    n_trials, n_steps, n_taxels = signal.shape
    spikes = np.empty((n_trials, n_steps, 2 * n_taxels), np.uint8) if out is None else out
    drive, last = drives(signal, gains, state.last)
    sa1, ra1 = state.sa1, state.ra1
    for t in range(n_steps):
        spikes[:, t, :n_taxels], sa1 = lif_step(neurons[0], drive[:, t, :n_taxels], sa1)
        spikes[:, t, n_taxels:], ra1 = lif_step(neurons[1], drive[:, t, n_taxels:], ra1)
    return spikes, EncoderState(sa1, ra1, last)


def afferent_names(taxels: tuple[str, ...]) -> tuple[str, ...]:
    """Names in the order of every encoder's output: SA-I of every taxel, then RA-I of every taxel.

    >>> afferent_names(("taxel1", "taxel2"))
    ('SA-I taxel1', 'SA-I taxel2', 'RA-I taxel1', 'RA-I taxel2')
    """
    return tuple(f"{kind} {taxel}" for kind in ("SA-I", "RA-I") for taxel in taxels)


def drives(
    signal: np.ndarray, gains: tuple[float, float], last: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray | None]:
    """What SA-I and RA-I afferents feel, `(trial, time, 2 taxel)`, and the signal's last sample (Eqs. 2 and 3).

    gains: SA-I drive for each unit of the signal; RA-I drive for each unit of change from one sample to the next.
    last: the sample before the first, `(trial, taxel)`; None: the first change is 0.

    >>> drives(np.array([[[1.0], [3.0]]]), (2.0, 10.0), None)[0].tolist()
    [[[2.0, 0.0], [6.0, 20.0]]]
    """
    gain_sa1, gain_ra1 = map(signal.dtype.type, gains)
    before = signal[:, :1] if last is None else last[:, None]
    change = np.abs(np.diff(signal, axis=1, prepend=before[:, : signal.shape[1]]))
    return np.concatenate([gain_sa1 * signal, gain_ra1 * change], axis=2), signal[:, -1] if signal.shape[1] else last


def checked(signal: np.ndarray) -> np.ndarray:
    """The signal if it is a float array `(trial, time, taxel)`; InputError otherwise."""
    signal = np.asarray(signal)
    if signal.ndim != 3 or signal.dtype.kind != "f":
        raise InputError(f"signal: must be a float array (trial, time, taxel); got {signal.dtype} {signal.shape}")
    return signal


def _start(signal: np.ndarray, neurons: tuple[LIF, LIF]) -> EncoderState:
    shape = (signal.shape[0], signal.shape[2])
    sa1, ra1 = neurons
    return EncoderState(lif_start(sa1, shape, signal.dtype), lif_start(ra1, shape, signal.dtype), None)
