"""SA-I, RA-I and PC afferents as fitted to recorded spikes (Saal et al. 2017, PNAS: TouchSim).

Saal, Delhaye, Rayhaun and Bensmaia 2017, doi 10.1073/pnas.1704856114. A taxel is taken as a pin of 0.5 mm radius
straight above its afferents: its conditioned signal times `gain` is the depth in mm to which the pin indents the skin.
The static drive of an afferent is proportional to the depth, its dynamic drive to the rate of change, with the
constants of the skin where the afferent ends. The equations are in `docs/equations.md`.
"""

import csv
import math
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import cache, cached_property
from pathlib import Path
from typing import Any, Literal, NamedTuple, Self

import numpy as np
from neurotact_parts.encoders.compiled import Signals, address, is_compiled, padded
from neurotact_parts.encoders.random_numbers import between, check_continued, digests, places, random_integers
from pydantic import Field, model_validator
from scipy.signal import butter, lfilter
from scipy.special import ndtri

from neurotact.backend import Backend, native
from neurotact.encoders.model import SA_RA, DrivenSpec, Model, Population, RefractoryMs, checked
from neurotact.errors import InputError
from neurotact.metrics.flops import Cost, changed, in_registers, with_weights
from neurotact.neurons import refractory_steps
from neurotact.spec import Spec

KINDS = ("sa1", "ra1", "pc")
FITTED_Hz = 5000.0
"""The clock on which the mechanoreceptors were fitted; their constants hold there and nowhere else."""
POST_SPIKE_STEPS = 190
"""Steps after a spike in which its post-spike current flows."""
FITS = Path(__file__).parent / "fitted_afferents.csv"
LEAST_CLOCK_Hz = 1000.0
"""In a longer step of the clock, two spikes would fall into one step."""
LEAST_PC_Hz = 500.0
"""A PC afferent feels best at about 250 Hz, which slower recordings do not contain."""
STATIC = {"sa1": 0.0426143949, "ra1": 0.0, "pc": 0.0}
"""Static drive per mm of depth. That of RA-I and PC has no gain in any fit."""
DYNAMIC = {"sa1": 0.6613757, "ra1": 0.0232514886, "pc": 0.0148809527}
"""Dynamic drive per mm/s."""
LEAST = {"sa1": 0.1, "ra1": 5.0, "pc": 1.0}
"""About the depth in mm (SA-I) and the rates of change in mm/s (RA-I, PC) at which the most sensitive fits fire."""
DERIVED_LATE = 2
"""Steps of the fits' clock by which currents come late: rate and acceleration of the fits look ahead, a step each."""
ORDER = 3
"""Of the low-pass filter."""
MOST_VALUES = 1_000_000
"""Currents in memory at once; a longer signal is encoded in pieces, which stay in a cache."""
LANES = 8
"""Taxels side by side in the kernel."""
EXACT = 2**53
"""Whole numbers below it are exact in float64."""


@dataclass(frozen=True)
class Mechanoreceptor:
    """Integrate-and-fire neurons with a post-spike current, on a clock of 5 kHz (Saal et al. 2017, PNAS, TouchSim).

    `V <- V - V / tau + I + H`, with H the post-spike current of the last spike alone. `V > 1` spikes if the last
    spike is `least_steps` or more steps ago; then V <- 0. Below that distance V goes on, above 1 or not.
    """

    tau_steps: np.ndarray
    """Time constants in steps, `(afferent,)`."""
    post_spike: np.ndarray
    """H in the steps after a spike, `(fit, POST_SPIKE_STEPS + 1)`; the last is 0 (`post_spike_currents`)."""
    fit: np.ndarray
    """The row of `post_spike` of each afferent, `(afferent,)`."""
    least_steps: np.ndarray
    """Least distance of two spikes in steps, `(afferent,)`."""

    @cached_property
    def longest(self) -> int:
        """The steps since a spike that are counted: later, neither H nor the least distance depends on them."""
        return max(POST_SPIKE_STEPS, int(self.least_steps.max(initial=0)))


class MechanoreceptorState(NamedTuple):
    """Membrane V and the steps since the last spike (at most those that matter), both `(trial, afferent)`."""

    membrane: np.ndarray
    steps_since: np.ndarray


def post_spike_currents(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """H for each fit's two weights, `(fit, POST_SPIKE_STEPS + 1)`.

    The weights are those of two raised cosines of the logarithm of the time t since the spike, with peaks at 0 and
    8 ms: `(1 + cos(clip(a - 3 pi j / 2, -pi, pi))) / 2` for j = 0, 1 with `a = 3 pi / 2 ln(1 + t / 1 ms) / ln 9`.

    >>> post_spike_currents(np.array([1.0, 0.0]), np.array([0.0, 1.0]))[:, [0, 1, 10, 40, 190]].round(3).tolist()
    [[1.0, 0.962, 0.146, 0.0, 0.0], [0.0, 0.0, 0.146, 1.0, 0.0]]
    """
    t_ms = np.arange(POST_SPIKE_STEPS + 1) * 1e3 / FITTED_Hz
    angle = 1.5 * np.pi * np.log1p(t_ms) / np.log(9.0)
    bumps = [(1 + np.cos(np.clip(angle - 1.5 * np.pi * j, -np.pi, np.pi))) / 2 for j in (0, 1)]
    currents = np.outer(first, bumps[0]) + np.outer(second, bumps[1])
    currents[:, POST_SPIKE_STEPS] = 0.0
    return currents


def mechanoreceptor_start(neuron: Mechanoreceptor, n_trials: int) -> MechanoreceptorState:
    """The resting state, without an earlier spike."""
    shape = (n_trials, len(neuron.tau_steps))
    return MechanoreceptorState(np.zeros(shape), np.full(shape, neuron.longest, np.int64))


def mechanoreceptor_step(
    neuron: Mechanoreceptor, current: np.ndarray, state: MechanoreceptorState
) -> tuple[np.ndarray, MechanoreceptorState]:
    """One step of 0.2 ms: `(spikes, next state)`; current: I, `(trial, afferent)`; spikes are boolean.

    >>> post_spike = post_spike_currents(np.array([-1.0]), np.array([0.0]))
    >>> neuron = Mechanoreceptor(np.array([50.0]), post_spike, fit=np.array([0]), least_steps=np.array([6]))
    >>> state, spikes = mechanoreceptor_start(neuron, n_trials=1), []
    >>> for _ in range(60):
    ...     fired, state = mechanoreceptor_step(neuron, np.array([[0.2]]), state)
    ...     spikes.append(fired[0, 0])
    >>> np.flatnonzero(spikes).tolist()
    [5, 37]
    """
    since_spike = np.minimum(state.steps_since, POST_SPIKE_STEPS)
    after_spike = neuron.post_spike.take(since_spike + (POST_SPIKE_STEPS + 1) * neuron.fit)
    membrane = state.membrane - state.membrane / neuron.tau_steps + current + after_spike
    since = np.minimum(state.steps_since + 1, neuron.longest)
    fired = (membrane > 1.0) & (since >= neuron.least_steps)
    membrane[fired], since[fired] = 0.0, 0
    return fired, MechanoreceptorState(membrane, since)


class _MechanoreceptorType(Spec):
    """The afferents of one type under each taxel: one for each fit."""

    gain: float = Field(gt=0)
    """Depth in mm for each unit of the conditioned signal."""
    t_ref_ms: RefractoryMs = 1.2
    """Least distance of two spikes; 1.2 in the fits."""
    fits: tuple[int, ...] = Field(min_length=1)
    """Numbers of fitted afferents, one of each under each taxel: SA-I has 1 to 4, RA-I 1 to 9, PC 1 to 4."""


class MechanoreceptorSpec(DrivenSpec):
    """Populations of fitted SA-I, RA-I and perhaps PC afferents over every taxel (`encoders/mechanoreceptor.toml`)."""

    model: Literal["mechanoreceptor"] = "mechanoreceptor"
    """Mechanoreceptors fitted to recorded spikes."""
    noise: bool = True
    """Add the noise of the fits to the currents."""
    seed: int = Field(default=0, ge=0, lt=2**63)
    """Random seed of the noise: a trial has the same spikes whenever its samples and the spec are the same."""
    conduction: bool = True
    """Delay spikes by the conduction times of the fits, 1.0 to 11.0 ms; otherwise by the 0.4 ms of the derivatives."""
    sa1: _MechanoreceptorType
    """Driven by depth, and by its rate of change."""
    ra1: _MechanoreceptorType
    """Driven by the depth's rate of change and by the change of that."""
    pc: _MechanoreceptorType | None = None
    """As RA-I, and most sensitive at 200 to 300 Hz; needs recordings of 500 Hz or more."""

    @model_validator(mode="after")
    def _has_the_fits(self) -> "MechanoreceptorSpec":
        for part, kind in self.populations.items():
            known = sorted(fit for population, fit in fitted() if population == part)
            for fit in kind.fits:
                if fit not in known:
                    raise ValueError(f"{part}.fits: there is no fit {fit}; known: {', '.join(map(str, known))}")
            if list(kind.fits) != sorted(set(kind.fits)):
                raise ValueError(f"{part}.fits must rise from each to the next")
        return self

    @property
    def gain_units(self) -> dict[str, str]:
        return dict.fromkeys(("SA-I", "RA-I", "PC"), "mm per sd")

    @property
    def for_search(self) -> Self:
        """The encoder whose spikes are counted in the search for gains: without noise, and of the first fit."""
        first = {part: kind.model_copy(update={"fits": kind.fits[:1]}) for part, kind in self.populations.items()}
        return self.model_copy(update={"noise": False, **first})

    def felt(self, part: str, signal: np.ndarray, sampling_rate_Hz: float) -> np.ndarray:
        """The depth (SA-I) or its rate of change in mm/s at a gain of 1, of a signal `(time, taxel)`.

        Both are magnitudes after the low pass of the first fit; of a change, there is one value less.
        """
        fit = fitted()[part, self.populations[part].fits[0]]
        drive = signal if part == "sa1" else np.diff(signal, axis=0) * sampling_rate_Hz
        b, a = butter(ORDER, fit.lowpass_Hz / (sampling_rate_Hz / 2))
        filtered: Any = lfilter(b, a, drive, axis=0) if drive.size else drive
        return np.abs(filtered).astype(signal.dtype)

    def least_drive(self, part: str) -> float:
        """About the depth in mm, or the rate of change in mm/s, at which a type just fires (`LEAST`)."""
        return LEAST[part]

    @property
    def populations(self) -> dict[str, _MechanoreceptorType]:
        """The afferents of each type that there is, by its key."""
        kinds = {"sa1": self.sa1, "ra1": self.ra1, "pc": self.pc}
        return {part: kind for part, kind in kinds.items() if kind is not None}


class _Fit(NamedTuple):
    """The constants of a fitted afferent, on the clock of the fits (`fitted_afferents.csv`).

    Gains are those of drives at or above zero (up) and below (down). saturation: 0 for none.
    """

    lowpass_Hz: float
    static_up: float
    static_down: float
    velocity_up: float
    velocity_down: float
    acceleration_up: float
    acceleration_down: float
    saturation: float
    noise: float
    tau_steps: float
    post_spike_1: float
    post_spike_2: float
    delay_ms: float


@cache
def fitted() -> Mapping[tuple[str, int], _Fit]:
    """Every fitted afferent, by its population's key and its number.

    >>> len(fitted()), fitted()["pc", 2].lowpass_Hz
    (17, 369.96826171875)
    """
    with FITS.open(encoding="utf-8") as file:
        rows = list(csv.DictReader(line for line in file if not line.startswith("#")))
    return {
        (row["population"], int(row["fit"])): _Fit(**{name: float(row[name]) for name in _Fit._fields}) for row in rows
    }


class FilterState(NamedTuple):
    """The filters of one fit between pieces.

    static, dynamic: memories of the low passes, `(trial, ORDER, taxel)`. pressed, rate: the last filtered drives,
    `(trial, taxel)`.
    """

    static: np.ndarray
    dynamic: np.ndarray
    pressed: np.ndarray
    rate: np.ndarray

    @classmethod
    def at_rest(cls, n_trials: int, n_taxels: int) -> "FilterState":
        """Before the first drive."""
        memory, last = np.zeros((n_trials, ORDER, n_taxels)), np.zeros((n_trials, n_taxels))
        return cls(memory, memory, last, last)


class _MechanoreceptorEncoderState(NamedTuple):
    """The state of the encoder between pieces.

    digest: of the samples so far, from which the noise is drawn, `(trial, taxel)` uint64.
    step: steps of the clock done.
    last: the signal's last sample, `(trial, taxel)`, None before the first. before: the two last samples on the clock
    of the fits, `(trial, 2, taxel)`. filters: of each fit. neurons: all afferents.
    under_way: spikes that have not arrived, `(trial, steps of the longest delay, afferent)`.
    """

    digest: np.ndarray
    step: int
    last: np.ndarray | None
    before: np.ndarray
    filters: tuple[FilterState, ...]
    neurons: MechanoreceptorState
    under_way: np.ndarray


class _Copy(NamedTuple):
    """One fit under every taxel: its type, its constants and its gain in mm per unit of the signal."""

    part: str
    fit: _Fit
    gain: float
    t_ref_ms: float

    def least_steps(self, rate_Hz: float) -> int:
        """The least distance of two spikes: a step of the signal's clock or more."""
        return max(math.ceil(FITTED_Hz / rate_Hz - 1e-9), refractory_steps(self.t_ref_ms, FITTED_Hz))

    def constants(self, rate_Hz: float, delay: int) -> list[float]:
        """A `MechanoreceptorFit` of `native/kernels.hpp`."""
        fit = self.fit
        b, a = butter(ORDER, fit.lowpass_Hz / (FITTED_Hz / 2))
        by_depth, by_rate = self.gain * STATIC[self.part], self.gain * DYNAMIC[self.part] * FITTED_Hz / 2
        return [by_depth, by_rate, *b, *a, *fit[1:10], self.least_steps(rate_Hz), delay]


def encode(
    signal: np.ndarray,
    sampling_rate_Hz: float,
    spec: MechanoreceptorSpec,
    state: _MechanoreceptorEncoderState | None = None,
    *,
    backend: Backend = "auto",
) -> tuple[np.ndarray, _MechanoreceptorEncoderState]:
    """Spikes of conditioned signals, `(trial, time, taxel)` to `(trial, time, afferent)` uint8, as `afferent_names`.

    The fits hold at 5 kHz. So the neurons run on that clock whatever the signal's: between its samples the signal is a
    straight line, and a spike is put into the step of the signal's clock in which it arrives. The state is an argument
    and a result, so that a recording encoded in pieces gives the spikes of the whole. All arithmetic is in float64.
    Both implementations give the same spikes and states; where SciPy is built with fused multiply-adds, as on ARM, the
    noise may differ in its last bits.

    The noise of an afferent depends on the seed, its place on the skin and the samples of its taxel so far
    (`random_numbers.py`), so that pieces, other trials and other taxels do not change it. Trials of the same samples
    have the same noise; more of it needs other seeds.

    Raises InputError for a clock below 1 kHz.

    >>> one = {"gain": 1.0, "fits": [1]}
    >>> spec = MechanoreceptorSpec.model_validate({"sa1": one, "ra1": one, "unit": "mm", "noise": False})
    >>> press = np.minimum(np.arange(1000) * 0.01, 0.5)[None, :, None]  # 10 mm/s, then held, at 1 kHz
    >>> spikes, _ = encode(press, 1000.0, spec)
    >>> spikes.shape, spikes[:, :100].sum(axis=1).tolist(), spikes[:, 100:].sum(axis=1).tolist()
    ((1, 1000, 2), [[5, 2]], [[15, 0]])
    """
    signal = checked(signal)
    if sampling_rate_Hz < LEAST_CLOCK_Hz * (1 - 1e-9):
        raise InputError(
            f"sampling_rate_Hz: mechanoreceptors need a clock of 1 kHz or more; got {sampling_rate_Hz:g} Hz; "
            "set conditioning.resample_Hz = 1000.0"
        )
    n_trials, n_steps, n_taxels = signal.shape
    copies = [
        _Copy(part, fitted()[part, fit], kind.gain, kind.t_ref_ms)
        for part, kind in spec.populations.items()
        for fit in kind.fits
    ]
    neuron = _neurons(copies, n_taxels, sampling_rate_Hz)
    delays = [_delay_steps(copy.fit, conduction=spec.conduction) for copy in copies]
    how = _Encoder(sampling_rate_Hz, spec, copies, delays, neuron)
    if state is None:
        state = _start(n_trials, n_taxels, len(copies), neuron, max(delays))
    check_continued(state.digest, signal)
    spikes = np.zeros((n_trials, n_steps, len(copies) * n_taxels), np.uint8)
    per_step = max(1, spikes.shape[0] * spikes.shape[2]) * FITTED_Hz / sampling_rate_Hz
    n_at_once = max(1, int(MOST_VALUES / per_step))
    encode_piece = _compiled_piece if is_compiled(signal, backend) else _encode_piece
    for first in range(0, n_steps, n_at_once):
        piece, out = (array[:, first : first + n_at_once] for array in (signal, spikes))
        state = encode_piece(piece, how, state, out)
    return spikes, state


class _Encoder(NamedTuple):
    """What all pieces of an encoding share: the clock of their signal, the spec, its fits with the delay of each."""

    rate_Hz: float
    spec: MechanoreceptorSpec
    copies: list[_Copy]
    delays: list[int]
    neuron: Mechanoreceptor


def _encode_piece(
    signal: np.ndarray, how: _Encoder, state: _MechanoreceptorEncoderState, out: np.ndarray
) -> _MechanoreceptorEncoderState:
    """Write the spikes of a piece to `out`, `(trial, time, afferent)`; returns the state after it."""
    rate_Hz, spec, copies, delays, neuron = how
    signal, n_taxels = signal.astype(np.float64), signal.shape[2]
    step_of, share, first_fine = _fitted_clock(signal.shape[1], rate_Hz, state.step)
    earlier = signal[:, :1] if state.last is None else state.last[:, None]
    known = np.concatenate([earlier, signal], axis=1)  # one sample later than `signal`
    low, high = known[:, step_of], known[:, step_of + 1]
    fine = low + share[:, None] * (high - low)
    before = state.before if state.last is not None else np.repeat(signal[:, :1], DERIVED_LATE, axis=1)
    depth = np.concatenate([before, fine], axis=1)
    current = np.empty((len(signal), len(step_of), len(copies) * n_taxels))
    filters = []
    for index, copy in enumerate(copies):
        mine = current[:, :, index * n_taxels : (index + 1) * n_taxels]
        static = depth[:, 1:-1] * (copy.gain * STATIC[copy.part])
        dynamic = (depth[:, 2:] - depth[:, :-2]) * (copy.gain * DYNAMIC[copy.part] * FITTED_Hz / 2)
        mine[...], following = currents(copy.fit, static, dynamic, state.filters[index])
        filters.append(following)
    digest, after = digests(signal, state.step, state.digest)
    if spec.noise:
        _add_noise(current, spec.seed, between(digest, step_of, first_fine), [copy.fit.noise for copy in copies])
    fired = np.empty(current.shape, bool)
    neurons = state.neurons
    for k in range(len(step_of)):
        fired[:, k], neurons = mechanoreceptor_step(neuron, current[:, k], neurons)
    on_the_way = np.concatenate([state.under_way, fired], axis=1)
    longest = state.under_way.shape[1]
    for index, delay in enumerate(delays):
        block = slice(index * n_taxels, (index + 1) * n_taxels)
        arrived = on_the_way[:, longest - delay : longest - delay + len(step_of), block]
        trial, k, taxel = np.nonzero(arrived)
        out[trial, step_of[k], block.start + taxel] = 1
    return _MechanoreceptorEncoderState(
        after, state.step + signal.shape[1], signal[:, -1], depth[:, len(step_of) :], tuple(filters), neurons,
        on_the_way[:, len(step_of) :],
    )  # fmt: skip


def _compiled_piece(
    signal: np.ndarray, how: _Encoder, state: _MechanoreceptorEncoderState, out: np.ndarray
) -> _MechanoreceptorEncoderState:
    """`_encode_piece` with the kernel."""
    rate_Hz, spec, copies, delays, neuron = how
    n_trials, n_steps, n_taxels = signal.shape
    n_copies, longest = len(copies), state.under_way.shape[1]
    step_of, share, first_fine = _fitted_clock(n_steps, rate_Hz, state.step)
    signals = Signals(signal, n_copies, lanes=LANES)
    begins = state.last is None and n_steps > 0
    before = padded(np.repeat(signal[:, :1], DERIVED_LATE, axis=1) if begins else state.before, np.float64)
    last = before[:, 0].copy() if state.last is None else padded(state.last, np.float64)
    digest = padded(state.digest, np.uint64)
    kept = padded(_kept(state, n_copies), np.float64)
    fired = np.empty((n_trials, longest + len(step_of), n_copies, signals.pitch), np.uint8)
    fired[:, :longest] = padded(state.under_way.reshape(n_trials, longest, n_copies, n_taxels), bool, lanes=LANES)
    fits = np.array([copy.constants(rate_Hz, delay) for copy, delay in zip(copies, delays, strict=True)])
    of_noise = np.array([places(spec.seed, copy, signals.pitch) for copy in range(n_copies * spec.noise)], np.uint64)
    native.mechanoreceptors(  # pyright: ignore[reportOptionalMemberAccess]
        **signals.given, first_step=state.step, first_fine=first_fine, n_fine=len(step_of), step_of=address(step_of),
        share=address(share), copies=n_copies, fits=address(fits), post_spike=address(neuron.post_spike),
        post_spike_steps=POST_SPIKE_STEPS, longest_since=neuron.longest, places=address(of_noise), last=address(last),
        before=address(before), digest=address(digest), kept=address(kept), under_way=longest, fired=address(fired),
    )  # fmt: skip
    out[...] = signals.spikes
    of = signals.of_taxels
    return _MechanoreceptorEncoderState(
        of(digest), state.step + n_steps, of(last) if n_steps else state.last, of(before),
        *_unpacked(of(kept)), of(fired[:, len(step_of) :]).reshape(state.under_way.shape).astype(bool),
    )  # fmt: skip


def _kept(state: _MechanoreceptorEncoderState, n_copies: int) -> np.ndarray:
    """What the kernel keeps of each fit, `(trial, copy, value, taxel)`: the low passes, V, the steps since a spike."""
    neurons = [values.reshape(len(values), n_copies, 1, state.digest.shape[1]) for values in state.neurons]
    parts = [[f.dynamic, f.rate[:, None], f.static, f.pressed[:, None]] for f in state.filters]
    return np.concatenate([np.stack([np.concatenate(of, axis=1) for of in parts], axis=1), *neurons], axis=2)


def _unpacked(kept: np.ndarray) -> tuple[tuple[FilterState, ...], MechanoreceptorState]:
    """The filters and neurons of `_kept`."""
    static, (n_trials, n_copies, _, n_taxels) = ORDER + 1, kept.shape
    filters = (
        FilterState(of[:, static : static + ORDER], of[:, :ORDER], of[:, static + ORDER], of[:, ORDER])
        for of in kept.swapaxes(0, 1)
    )
    membrane, since = (kept[:, :, value].reshape(n_trials, n_copies * n_taxels) for value in (-2, -1))
    return tuple(filters), MechanoreceptorState(membrane, since.astype(np.int64))


def _fitted_clock(n_steps: int, rate_Hz: float, first_step: int) -> tuple[np.ndarray, np.ndarray, int]:
    """The clock of the fits in a piece: step of each value, its share of the way to it, and the first one's number.

    The step is counted from the piece's first. A value lies on the straight line between the sample before that step
    and its own. Sample k of that clock lies at k / FITTED_Hz, and belongs to the first step of the signal's clock that
    is not before it: both are counted in whole numbers from the trial's start, so that pieces do not move them.
    """
    ratio = Fraction(FITTED_Hz) / Fraction(rate_Hz)
    up, down = ratio.numerator, ratio.denominator
    # Steps up to t contain the fine samples 0 to t * up / down.
    before = (first_step - 1) * up // down + 1 if first_step else 0
    end = (first_step + n_steps - 1) * up // down + 1
    fits = (first_step + n_steps) * up < EXACT and end * down < EXACT
    number = np.arange(before, end, dtype=np.int64 if fits else object)
    step = -(-number * down // up)
    share = np.array((number * down - (step - 1) * up) / up, np.float64)
    return np.array(step - first_step, np.int64), share, before


def currents(fit: _Fit, static: np.ndarray, dynamic: np.ndarray, state: FilterState) -> tuple[np.ndarray, FilterState]:
    """The current of a fit from its two drives on the clock of the fits, each `(trial, time, taxel)`.

    It comes a step late: the value at k is the current of step k - 1, since the acceleration of a step is the change of
    the dynamic drive to the next one.
    """
    b, a = butter(ORDER, fit.lowpass_Hz / (FITTED_Hz / 2))
    rate, rates, of_rate = _filtered(b, a, dynamic, state.dynamic, state.rate)
    current = _two_sided(rate, fit.velocity_up, fit.velocity_down)
    if fit.acceleration_up or fit.acceleration_down:
        current += _two_sided(np.diff(rates, axis=1), fit.acceleration_up, fit.acceleration_down)
    of_static = state.static, state.pressed
    if fit.static_up or fit.static_down:
        pressed, _, of_static = _filtered(b, a, static, *of_static)
        current += _two_sided(pressed, fit.static_up, fit.static_down)
    if fit.saturation > 0:
        current = fit.saturation * current / (fit.saturation + np.abs(current))
    return current, FilterState(of_static[0], of_rate[0], of_static[1], of_rate[1])


def _filtered(
    b: np.ndarray, a: np.ndarray, drive: np.ndarray, memory: np.ndarray, last: np.ndarray
) -> tuple[np.ndarray, np.ndarray, tuple[np.ndarray, np.ndarray]]:
    """A drive after the low pass: a step late, with one value more at the end, and what to keep.

    memory: of the filter, `(trial, ORDER, taxel)`. last: its last value, `(trial, taxel)`.
    """
    filtered: Any = lfilter(b, a, drive, axis=1, zi=memory) if drive.size else (drive, memory)
    values = np.concatenate([last[:, None], filtered[0]], axis=1)
    return values[:, :-1], values, (filtered[1], values[:, -1])


def _two_sided(drive: np.ndarray, up: float, down: float) -> np.ndarray:
    return drive * np.where(drive >= 0, up, -down)


def _add_noise(current: np.ndarray, seed: int, digest: np.ndarray, sizes: list[float]) -> None:
    """Add normal numbers of a standard deviation for each copy to the currents, in place."""
    n_taxels = digest.shape[2]
    for copy, size in enumerate(sizes):
        uniform = ((random_integers(seed, digest, copy) >> np.uint64(11)) + 0.5) * 2.0**-53
        current[:, :, copy * n_taxels : (copy + 1) * n_taxels] += size * ndtri(uniform)


def _neurons(copies: list[_Copy], n_taxels: int, rate_Hz: float) -> Mechanoreceptor:
    """All afferents."""
    fits = [copy.fit for copy in copies]
    post_spike = post_spike_currents(
        np.array([fit.post_spike_1 for fit in fits]), np.array([fit.post_spike_2 for fit in fits])
    )
    least = [copy.least_steps(rate_Hz) for copy in copies]
    return Mechanoreceptor(
        tau_steps=np.repeat([fit.tau_steps for fit in fits], n_taxels),
        post_spike=post_spike,
        fit=np.repeat(np.arange(len(copies)), n_taxels),
        least_steps=np.repeat(least, n_taxels),
    )


def _delay_steps(fit: _Fit, *, conduction: bool) -> int:
    """Steps from the sample that the current of a spike knows last to its arrival; the fits count from a step's end."""
    return round(fit.delay_ms * 1e-3 * FITTED_Hz) + 1 - DERIVED_LATE if conduction else 0


def _start(
    n_trials: int, n_taxels: int, n_copies: int, neuron: Mechanoreceptor, longest: int
) -> _MechanoreceptorEncoderState:
    filters = (FilterState.at_rest(n_trials, n_taxels),) * n_copies
    return _MechanoreceptorEncoderState(
        np.zeros((n_trials, n_taxels), np.uint64), 0, None, np.zeros((n_trials, DERIVED_LATE, n_taxels)), filters,
        mechanoreceptor_start(neuron, n_trials), np.zeros((n_trials, longest, n_copies * n_taxels), bool),
    )  # fmt: skip


def cost(spec: Mapping[str, Any], taxels: int, steps: int, step_ms: float) -> Cost:
    """The cost of an encoder, given as a table, over `steps` steps of `step_ms`.

    A step of the clock is some steps of 0.2 ms. Per taxel and such a step: the signal between two samples (a MAC) and
    its change (an AC). Per afferent and step: the change times its constant, a low pass of order 3 (7 MACs), the change
    of that (an AC), two gains, one for each sign (2 comparisons, 2 MACs), the leak (a MAC), the current and the
    post-spike current (2 ACs), the comparisons with the threshold and with the least distance of spikes, and the count
    of steps since the last spike (an AC). Where pressure drives it too: 8 MACs, a comparison and a product more. Where
    it saturates: a comparison, an AC, a product and a division. Noise is counted as that of Poisson afferents: a MAC
    for the number, and a MAC to add it.
    """
    fits = [fitted()[part, fit] for part in KINDS if spec.get(part) for fit in spec[part]["fits"]]
    n, noisy = len(fits), bool(spec.get("noise", True))
    n_pressed = sum(bool(fit.static_up or fit.static_down) for fit in fits)
    n_saturating = sum(fit.saturation > 0 for fit in fits)
    every = in_registers(macs=7 + 2 + 1 + 2 * noisy, acs=1 + 2 + 1, multiplications=1, comparisons=2 + 2)
    pressed = in_registers(macs=8, multiplications=1, comparisons=1)
    saturating = in_registers(acs=1, multiplications=1, comparisons=1, divisions=1)
    # Two samples before; of each afferent a filter, its last value, V, the steps since a spike, a random number.
    state = taxels * (2 + n * (3 + 1 + 2 + noisy) + 3 * n_pressed)
    moved = {"weights_accesses": n, **changed(state // taxels)}
    step = Cost(macs=1, acs=1, **moved) + every.times(n) + pressed.times(n_pressed) + saturating.times(n_saturating)
    return with_weights(n, state) + step.times(taxels * round(steps * step_ms * 1e-3 * FITTED_Hz))


MODEL = Model(
    "fitted mechanoreceptors", MechanoreceptorSpec, encode, _MechanoreceptorEncoderState,
    (*SA_RA, Population("PC", "pc", LEAST_PC_Hz)), cost, is_compared=False,
)  # fmt: skip
