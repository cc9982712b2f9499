"""SA-I and RA-I afferents: LIF neurons driven by a taxel's signal and by its rate of change.

Texture paper, Eqs. 1 to 3 and Tables II and III. The drive of SA-I is `gain x`, that of RA-I `gain |dx/dt|`. A taxel
may have several afferents of a type: grades, with the same drive times a factor, and SA-I driven by the falling signal.
Two options make them more like recorded afferents: RA-I driven by the rise or by the fall alone, which follow a
vibration with one spike a cycle; and SA-I driven by the signal's rise, too, which have an onset
(`docs/afferent-validation.md`).
"""

import math
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal, NamedTuple, Self

import numpy as np
from pydantic import Field, field_validator, model_validator

from neurotact.backend import Backend, use_native
from neurotact.encoders import native
from neurotact.encoders.model import DrivenSpec, Model, RefractoryMs, checked
from neurotact.errors import InputError
from neurotact.metrics.flops import Cost, changed, index_bytes, with_weights
from neurotact.neurons import LIF, LIFState, decay_per_step, lif_start, lif_step, refractory_steps
from neurotact.spec import Spec

POPULATIONS = {"sa1": "SA-I", "ra1": "RA-I"}
"""The key of each type in an encoder's spec and the first word of its afferents' names, in the order of the output."""
MOST_GRADES = 16
FLOOR_OF_TAU = 0.1
"""Charging within this share of tau_mem takes 10.5 times the threshold drive: such an ISI is mostly t_ref."""
LEAST_EXACT_MS = 0.1
"""The shortest refractory period of membranes in closed form."""
Gains = tuple[Sequence[float], Sequence[float]]
"""Drives in mV of the SA-I and of the RA-I under each taxel."""
Columns = tuple[Any, Any]
"""The taxels of the SA-I and of the RA-I, as indices."""
EVERY: Columns = slice(None), slice(None)


Integration = Literal["clock", "exact"]
"""When membranes are computed: at each step of the clock, or once per sample (`encoders.closed_form`)."""
Change = Literal["rectified", "on", "off", "both"]
"""What drives RA-I: rise and fall equally, the rise, the fall, or one afferent each."""


class AfferentType(Spec):
    """The afferents of one type: one under each taxel, or one for each grade and polarity."""

    gain: float = Field(gt=0)
    """Drive in mV per unit of the conditioned signal (SA-I) or per unit per ms (RA-I)."""
    t_ref_ms: RefractoryMs = 1.0
    """Refractory period."""
    grades: tuple[Annotated[float, Field(gt=0)], ...] = Field(default=(1.0,), min_length=1, max_length=MOST_GRADES)
    """One afferent per grade, with the gain times the grade: it fires from threshold / grade on."""
    opposite: bool = False
    """Add as many afferents that are driven by the signal below zero, with the same gains (SA-I only)."""
    rate_ms: float = Field(default=0.0, ge=0)
    """Add this many ms of the signal's rise to the signal, `x + rate_ms (dx/dt)+`: an onset (SA-I only)."""
    change: Change = "rectified"
    """`rectified`: |dx/dt|. `on`, `off`: its rise or its fall alone. `both`: an afferent of each (RA-I only)."""
    taxels: tuple[Annotated[int, Field(ge=0)], ...] | None = None
    """The taxels that have such afferents, counted from 0 in the order of the recordings; all when absent, none if
    empty. Other afferents, and the conditioning of taxels that no population has, are not computed."""

    @field_validator("taxels")
    @classmethod
    def _are_chosen_once(cls, taxels: tuple[int, ...] | None) -> tuple[int, ...] | None:
        if taxels is None:
            return None
        if twice := [index for index in taxels if taxels.count(index) > 1]:
            raise ValueError(f"names taxel {twice[0]} twice; give each index once")
        return tuple(sorted(taxels))

    @field_validator("grades")
    @classmethod
    def _differ(cls, grades: tuple[float, ...]) -> tuple[float, ...]:
        if list(grades) != sorted(set(grades)):
            raise ValueError("must rise from each to the next")
        if len(grades) == 1 and grades[0] != 1:
            raise ValueError("must be [1.0] if there is one grade; change the gain")
        return grades

    @property
    def gains(self) -> tuple[float, ...]:
        """The gain of each afferent under a taxel, in the order of `marks`; negative for the falling signal."""
        rising = tuple(self.gain * grade for grade in self.grades)
        falling = tuple(-gain for gain in rising)
        if self.change == "off":
            return falling
        return rising + (falling if self.opposite or self.change == "both" else ())


class AfferentSpec(DrivenSpec):
    """An SA-I and an RA-I population over every taxel (`encoders/*.toml`).

    >>> spec = AfferentSpec.model_validate({"sa1": {"gain": 3.0, "t_ref_ms": 5}, "ra1": {"gain": 9.0}})
    >>> spec.sa1.t_ref_ms, spec.unit
    (5.0, 'mV')
    """

    model: Literal["lif"] = "lif"
    """Leaky integrate-and-fire neurons."""
    v_rest_mV: float = -65.0
    """Membrane potential at rest; it decays to this value without drive."""
    v_reset_mV: float = -65.0
    """Membrane potential after a spike and throughout the refractory period."""
    v_threshold_mV: float = -55.0
    """Membrane potential at which the neuron fires."""
    tau_mem_ms: float = Field(default=10.0, gt=0)
    """Time constant of the membrane."""
    integration: Integration = "clock"
    """`clock`: each membrane is computed at each step of the encoder's clock. `exact`: once per sample of the sensor,
    in closed form, with the drive held until the next one; then `conditioning.resample_Hz` is the clock of the spikes
    alone, and a sensor that is slower is not resampled to it (`docs/clock.md`)."""
    recorded_Hz: float | None = Field(default=None, gt=0)
    """With `exact`: the rate of the recording that was encoded, for the cost ledger. Encoding sets it."""
    recorded_taxels: tuple[str, ...] | None = None
    """Where a population has only some `taxels`: the names of all taxels of the recordings. Encoding sets it."""
    sa1: AfferentType
    """Driven by the signal."""
    ra1: AfferentType
    """Driven by the signal's rate of change."""

    @model_validator(mode="after")
    def _has_periods(self) -> "AfferentSpec":
        for key, kind in (("sa1", self.sa1), ("ra1", self.ra1)):
            if self.integration == "exact" and kind.t_ref_ms < LEAST_EXACT_MS:
                raise ValueError(
                    f"{key}.t_ref_ms must be {LEAST_EXACT_MS:g} or more with integration = 'exact': without a clock, "
                    "it alone limits the rate"
                )
        return self

    @model_validator(mode="after")
    def _has_afferents(self) -> "AfferentSpec":
        if self.sa1.taxels == self.ra1.taxels == ():
            raise ValueError("sa1.taxels and ra1.taxels must not both be empty: no afferent is left")
        how = self.conditioning
        known = self.recorded_taxels or how.taxels or how.offset or how.scale
        if known is not None:
            check_taxels(self.model_dump(), len(known))
        return self

    @model_validator(mode="after")
    def _can_fire(self) -> "AfferentSpec":
        if self.v_threshold_mV <= max(self.v_rest_mV, self.v_reset_mV):
            raise ValueError("v_threshold_mV must be above v_rest_mV and v_reset_mV, else the neuron never rests")
        if self.ra1.opposite:
            raise ValueError("ra1.opposite must be false: rise and fall drive RA-I equally")
        if self.ra1.rate_ms:
            raise ValueError("ra1.rate_ms must be 0: the rate of change alone drives RA-I")
        if self.sa1.change != "rectified":
            raise ValueError("sa1.change must be left out: the signal drives SA-I; for its rise, set sa1.rate_ms")
        if self.sa1.opposite and self.conditioning.rectify:
            raise ValueError("sa1.opposite must be false if conditioning.rectify is true: no signal is below zero")
        return self

    def columns(self, n_taxels: int) -> tuple[list[int], list[int]]:
        """The taxels of the SA-I and of the RA-I of one grade and polarity.

        >>> AfferentSpec(sa1=AfferentType(gain=3.0, taxels=(1,)), ra1=AfferentType(gain=9.0)).columns(2)
        ([1], [0, 1])
        """
        check_taxels(self.model_dump(), n_taxels)
        sa1, ra1 = ([*range(n_taxels)] if kind.taxels is None else [*kind.taxels] for kind in (self.sa1, self.ra1))
        return sa1, ra1

    @property
    def has_all_taxels(self) -> bool:
        """Whether both populations have afferents under every taxel."""
        return self.sa1.taxels is self.ra1.taxels is None

    def of_used(self, n_taxels: int) -> tuple[list[int], Self]:
        """The taxels that a population uses, and the encoder for recordings of these alone.

        >>> spec = AfferentSpec(sa1=AfferentType(gain=3.0, taxels=(4,)), ra1=AfferentType(gain=9.0, taxels=(1, 4)))
        >>> columns, used = spec.of_used(6)
        >>> columns, used.sa1.taxels, used.ra1.taxels
        ([1, 4], (1,), None)
        """
        if self.has_all_taxels:
            return [*range(n_taxels)], self
        sa1, ra1 = self.columns(n_taxels)
        used, how = sorted({*sa1, *ra1}), self.conditioning
        parts: dict[str, Any] = {
            part: getattr(self, part).model_copy(
                update={"taxels": None if its == used else tuple(used.index(index) for index in its)}
            )
            for part, its in (("sa1", sa1), ("ra1", ra1))
        }
        own = {key: getattr(how, key) for key in ("offset", "scale", "taxels")}
        own = {key: values and tuple(values[index] for index in used) for key, values in own.items()}
        parts |= {"conditioning": how.model_copy(update=own), "recorded_taxels": None}
        return used, self.model_copy(update=parts)

    @property
    def is_plain(self) -> bool:
        """Whether the signal and its rectified rate of change are the drives, as in the texture paper."""
        return not self.sa1.rate_ms and self.ra1.change == "rectified"

    @property
    def has_one_grade(self) -> bool:
        """Whether all afferents of a type have one threshold."""
        return len(self.sa1.grades) == len(self.ra1.grades) == 1

    @property
    def is_signed(self) -> bool:
        return self.sa1.opposite

    def gains_at(self, sampling_rate_Hz: float) -> Gains:
        """The gains of SA-I and of RA-I under a taxel on a clock: RA-I is driven by the change of a step, in ms.

        >>> spec = AfferentSpec(sa1=AfferentType(gain=3.0, opposite=True), ra1=AfferentType(gain=16.0))
        >>> spec.gains_at(2000.0)
        ((3.0, -3.0), (32.0,))
        """
        per_ms = sampling_rate_Hz * 1e-3
        return self.sa1.gains, tuple(gain * per_ms for gain in self.ra1.gains)

    @property
    def gain_units(self) -> dict[str, str]:
        return {"SA-I": "mV per sd", "RA-I": "mV per sd/ms"}

    def felt(self, part: str, signal: np.ndarray, sampling_rate_Hz: float) -> np.ndarray:
        per_ms = sampling_rate_Hz * 1e-3
        if part == "ra1":
            change = np.diff(signal, axis=0) * per_ms
            if self.ra1.change in ("on", "off"):
                return np.maximum(change if self.ra1.change == "on" else -change, 0)
            return np.abs(change)
        level = np.abs(signal) if self.sa1.opposite else signal
        if not self.sa1.rate_ms:
            return level
        rise = np.maximum(np.diff(level, axis=0, prepend=level[:1]), 0)
        return level + signal.dtype.type(self.sa1.rate_ms * per_ms) * rise

    def least_drive(self, part: str) -> float:
        del part
        return self.v_threshold_mV - self.v_rest_mV

    def least_isi_steps(self, part: str, sampling_rate_Hz: float) -> int:
        if self.integration == "exact":
            return super().least_isi_steps(part, sampling_rate_Hz)
        return self.neuron(getattr(self, part), sampling_rate_Hz).refractory_steps + 1

    def floor_steps(self, part: str, sampling_rate_Hz: float) -> int:
        """The longest interval that counts as at the refractory floor.

        In it, charging takes one step, or at most `FLOOR_OF_TAU` of tau_mem.
        """
        if self.integration == "exact":
            per_ms = 1e-3 * sampling_rate_Hz
            steps = getattr(self, part).t_ref_ms * per_ms + max(1.0, FLOOR_OF_TAU * self.tau_mem_ms * per_ms)
            return int(min(round(steps), np.iinfo(np.int64).max))
        neuron = self.neuron(getattr(self, part), sampling_rate_Hz)
        with np.errstate(divide="ignore"):  # a membrane without leak gives an infinite share
            charging = np.maximum(1.0, np.round(-FLOOR_OF_TAU / np.log(neuron.decay)))
        return int(min(neuron.refractory_steps + charging, np.iinfo(np.int64).max))

    def at_gain(self, part: str, gain: float) -> Self:
        """With one afferent of a type under each taxel, of that gain."""
        kind = getattr(self, part).model_copy(update={"gain": gain, "grades": (1.0,)})
        return self.model_copy(update={part: kind})

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
    """The state of an encoder between pieces: both types, `(trial, afferent)`, and the last sample `(trial, taxel)`.

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
    """Spikes of conditioned signals, `(trial, time, taxel)` to `(trial, time, afferent)` uint8, SA-I first.

    The state is an argument and a result, so that a recording encoded in pieces gives the spikes of the whole. The
    arithmetic is done in the signal's float type. At the very first sample the derivative is 0.

    out: an array of the result's shape to write to, so that encoding in a loop allocates no memory.
    backend: which implementation runs; all give the same spikes.

    >>> spec = AfferentSpec(sa1=AfferentType(gain=3.2), ra1=AfferentType(gain=16.0))
    >>> spikes, _ = encode(np.full((1, 200, 1), 10.0), 2000.0, spec)
    >>> spikes.shape, spikes.sum(axis=1).tolist()
    ((1, 200, 2), [[20, 0]])
    """
    signal = checked(signal)
    neurons = (spec.neuron(spec.sa1, sampling_rate_Hz), spec.neuron(spec.ra1, sampling_rate_Hz))
    gains, columns = spec.gains_at(sampling_rate_Hz), spec.columns(signal.shape[2])
    state = _start(signal, gains, columns, neurons) if state is None else state
    compiled = use_native(backend, signal.dtype in (np.float32, np.float64), "signals in float32 or float64")
    if compiled and spec.is_plain and spec.has_all_taxels:
        return _encode_natively(signal, gains, neurons, state, out)
    half_wave = spec.ra1.change != "rectified"
    rate_steps = spec.sa1.rate_ms * (sampling_rate_Hz * 1e-3)
    drive, last = drives(signal, gains, state.last, columns, rate_steps=rate_steps, half_wave=half_wave)
    encode_drive = _encode_drive_natively if compiled else _encode_drive_by_steps
    spikes = np.empty(drive.shape, np.uint8) if out is None else out
    return spikes, encode_drive(drive, neurons, state, spikes)._replace(last=last)


def _encode_natively(
    signal: np.ndarray, gains: Gains, neurons: tuple[LIF, LIF], state: EncoderState, out: np.ndarray | None
) -> tuple[np.ndarray, EncoderState]:
    """With the kernel, which handles one SA-I and one RA-I under each taxel: one call per pair."""
    if len(gains[0]) == len(gains[1]) == 1:
        pair = gains[0][0], gains[1][0]
        spikes, populations, last = native.encode(signal, pair, neurons, (state.sa1, state.ra1), state.last, out)
        return spikes, EncoderState(*populations, last)
    n_trials, n_steps, n_taxels = signal.shape
    n_copies = len(gains[0]), len(gains[1])
    spikes = np.empty((n_trials, n_steps, n_taxels * sum(n_copies)), np.uint8) if out is None else out
    columns = spikes[..., : n_taxels * n_copies[0]], spikes[..., n_taxels * n_copies[0] :]
    following: tuple[list[LIFState], list[LIFState]] = [], []
    last = state.last
    for copy in range(max(n_copies)):
        # If one type has fewer afferents, its first is computed again and dropped.
        copies = [copy if copy < n else 0 for n in n_copies]
        blocks = [slice(n_taxels * copy_index, n_taxels * (copy_index + 1)) for copy_index in copies]
        states = tuple(
            LIFState(*(values[:, block] for values in whole))
            for whole, block in zip((state.sa1, state.ra1), blocks, strict=True)
        )
        pair = gains[0][copies[0]], gains[1][copies[1]]
        fired, after, last = native.encode(signal, pair, neurons, (states[0], states[1]), state.last)
        for kind in (kind for kind in (0, 1) if copy < n_copies[kind]):
            columns[kind][..., blocks[kind]] = fired[..., n_taxels * kind : n_taxels * (kind + 1)]
            following[kind].append(after[kind])
    sa1, ra1 = (LIFState(*(np.concatenate(part, axis=1) for part in zip(*kind, strict=True))) for kind in following)
    return spikes, EncoderState(sa1, ra1, last)


def _encode_drive_natively(
    drive: np.ndarray, neurons: tuple[LIF, LIF], state: EncoderState, spikes: np.ndarray
) -> EncoderState:
    """With the kernel, whose SA-I with a gain of 1 take any drive; its RA-I are computed, too, and dropped."""
    n_sa1 = state.sa1.membrane_mV.shape[1]
    blocks, following = (slice(n_sa1), slice(n_sa1, None)), []
    for block, neuron, population in zip(blocks, neurons, (state.sa1, state.ra1), strict=True):
        fired, after, _ = native.encode(drive[..., block], (1.0, 1.0), (neuron, neuron), (population, population), None)
        spikes[..., block] = fired[..., : population.membrane_mV.shape[1]]
        following.append(after[0])
    return EncoderState(following[0], following[1], None)


def _encode_drive_by_steps(
    drive: np.ndarray, neurons: tuple[LIF, LIF], state: EncoderState, spikes: np.ndarray
) -> EncoderState:
    """The definition, step by step; writes to `spikes`."""
    sa1, ra1 = state.sa1, state.ra1
    n_sa1 = sa1.membrane_mV.shape[1]
    for t in range(drive.shape[1]):
        spikes[:, t, :n_sa1], sa1 = lif_step(neurons[0], drive[:, t, :n_sa1], sa1)
        spikes[:, t, n_sa1:], ra1 = lif_step(neurons[1], drive[:, t, n_sa1:], ra1)
    return EncoderState(sa1, ra1, None)


def marks(kind: Mapping[str, Any]) -> tuple[str, ...]:
    """The suffixes of the names of a taxel's afferents of one type, by its table; all have equally many words.

    >>> marks({}), marks({"grades": [0.5, 2.0]}), marks({"opposite": True}), marks({"fits": [1, 3]})
    (('',), (' x0.5', ' x2'), (' rising', ' falling'), (' fit1', ' fit3'))
    >>> marks({"change": "both"})
    (' on', ' off')
    """
    fits = kind.get("fits") or ()
    if len(fits) > 1:
        return tuple(f" fit{fit}" for fit in fits)
    grades = kind.get("grades") or (1.0,)
    ends = [f" x{float(grade)!r}".removesuffix(".0") for grade in grades] if len(grades) > 1 else [""]
    poles = (" rising", " falling") if kind.get("opposite") else ("",)
    poles = (" on", " off") if kind.get("change") == "both" else poles
    return tuple(pole + end for pole in poles for end in ends)


def under(kind: Mapping[str, Any], n_taxels: int) -> Sequence[int]:
    """The taxels under which a population has afferents, by its table.

    >>> [*under({}, 3)], [*under({"taxels": [0, 2]}, 3)]
    ([0, 1, 2], [0, 2])
    """
    chosen = kind.get("taxels")
    return range(n_taxels) if chosen is None else chosen


def used_taxels(encoder: Mapping[str, Any], n_taxels: int) -> list[int]:
    """The taxels that a population of SA-I and RA-I uses, by the encoder's table; those of other models use all.

    >>> used_taxels({"sa1": {"taxels": [2]}, "ra1": {"taxels": [0, 2]}}, 4)
    [0, 2]
    """
    return sorted({index for part in POPULATIONS for index in under(encoder.get(part) or {}, n_taxels)})


def check_taxels(encoder: Mapping[str, Any], n_taxels: int) -> None:
    """InputError if a population, by the encoder's table, has afferents under a taxel that is not there."""
    for part in POPULATIONS:
        if (last := max((encoder.get(part) or {}).get("taxels") or (), default=0)) >= n_taxels:
            raise InputError(
                f"{part}.taxels: names taxel {last} of {n_taxels}, which are counted from 0; give indices from 0 to "
                f"{n_taxels - 1}"
            )


def drives(
    signal: np.ndarray,
    gains: Gains,
    last: np.ndarray | None,
    columns: Columns = EVERY,
    *,
    rate_steps: float = 0.0,
    half_wave: bool = False,
) -> tuple[np.ndarray, np.ndarray | None]:
    """The drives of the afferents, `(trial, time, afferent)`, and the signal's last sample (Eqs. 2 and 3).

    gains: of the SA-I under a taxel, per unit of the signal; of its RA-I, per unit of change between two samples.
        Those that follow the falling signal are negative.
    last: the sample before the first, `(trial, taxel)`; None: the first change is 0.
    columns: the taxels of the SA-I and of the RA-I.
    rate_steps: how many times the rise between two samples is added to the signal that drives SA-I.
    half_wave: RA-I are driven by the rise (gain above zero) or the fall (below), not by both.

    >>> drives(np.array([[[1.0], [3.0]]]), ((2.0, -2.0), (10.0,)), None)[0].tolist()
    [[[2.0, -2.0, 0.0], [6.0, -6.0, 20.0]]]
    >>> drives(np.array([[[1.0], [3.0]]]), ((2.0,), (10.0, -10.0)), None, rate_steps=5.0, half_wave=True)[0].tolist()
    [[[2.0, 0.0, 0.0], [26.0, 20.0, 0.0]]]
    """
    kind = signal.dtype.type
    before = signal[:, :1] if last is None else last[:, None]
    change = np.diff(signal, axis=1, prepend=before[:, : signal.shape[1]])
    felt, moved = signal[..., columns[0]], change[..., columns[1]]
    sa1 = [kind(gain) * felt for gain in gains[0]]
    if rate_steps:
        rise = (np.maximum(kind(gain) * change[..., columns[0]], 0) for gain in gains[0])
        sa1 = [level + kind(rate_steps) * scale for level, scale in zip(sa1, rise, strict=True)]
    if half_wave:
        ra1 = [np.maximum(kind(gain) * moved, 0) for gain in gains[1]]
    else:
        ra1 = [kind(gain) * np.abs(moved) for gain in gains[1]]
    return np.concatenate([*sa1, *ra1], axis=2), signal[:, -1] if signal.shape[1] else last


def _start(
    signal: np.ndarray, gains: Gains, columns: tuple[list[int], list[int]], neurons: tuple[LIF, LIF]
) -> EncoderState:
    sa1, ra1 = (
        lif_start(neuron, (len(signal), len(its) * len(taxels)), signal.dtype)
        for neuron, its, taxels in zip(neurons, gains, columns, strict=True)
    )
    return EncoderState(sa1, ra1, None)


def cost(spec: Mapping[str, Any], taxels: int, steps: int, step_ms: float) -> Cost:
    """The cost of LIF afferents, given as a table, over that many steps.

    Per afferent and step: gain times drive and the membrane's decay (two MACs) and the comparison with the threshold;
    RA-I takes a difference and its absolute value beside, once a taxel. Refractory steps are counted as the others.
    Where the signal's rise drives SA-I, too: the larger of the change and zero, and a MAC to add it, once a taxel.
    Of taxels without an RA-I (or such an SA-I) there is no difference, and the sample before is not kept.
    Numbers have 32 bits, as in exported integer C, but for refractory counters on a clock if a byte counts their steps.
    """
    kinds = [spec.get(part) or {} for part in POPULATIONS]
    sa1, ra1 = ({*under(kind, taxels)} for kind in kinds)
    rising = sa1 if kinds[0].get("rate_ms") else set()
    used = [(kind, its) for kind, its in zip(kinds, (sa1, ra1), strict=True) if its]
    gains = sum(len(marks(kind)) for kind, _ in used)
    n = sum(len(marks(kind)) * len(its) for kind, its in used)
    state = n + len(ra1 | rising)  # membranes, the sample before
    step = Cost(
        macs=2 * n + len(rising), acs=len(ra1 | rising), comparisons=n + len(ra1) + len(rising), weights_accesses=n,
        **changed(state),
    )  # fmt: skip
    counters = with_weights(0, n, **changed(n, steps))
    longest_ms = max(kind.get("t_ref_ms", 1.0) for kind, _ in used)
    most = math.ceil(longest_ms / step_ms * (1 - 1e-9)) + 1 if step_ms else 1
    if spec.get("integration") == "exact" or index_bytes(most) > 1:
        counters = counters.in_32_bits()
    return (with_weights(gains, state) + step.times(steps)).in_32_bits() + counters


MODEL = Model("LIF afferents", AfferentSpec, encode, EncoderState, cost=cost)
