"""The chain in integers, for many trials or windows together: what the integer variant of the C export computes.

Arithmetic: products are divided by a power of two and rounded towards zero, as C99's `/` does, so that decaying values
reach zero. States saturate to their bits once per step. NumPy computes in 64 bits, in which nothing here overflows; the
formats are chosen so that nothing overflows in 32 bits in C.
"""

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import torch
from neurotact_parts.exporters.c.formats import (
    FRACTION,
    LARGEST,
    OCTAVE,
    PIECE,
    TICK,
    Afferents,
    ClosedForm,
    Formats,
    FrontEnd,
    Integrator,
    Layer,
    Layers,
    Weight,
)

from neurotact.networks.definition.clock import binned
from neurotact.networks.exit.rule import ExitRule, Leader
from neurotact.neurons import CubaLIF

_PIECES = np.arange(2**PIECE + 1) / 2**PIECE
CURVES = tuple(np.rint(values * 2.0**OCTAVE).astype(np.int64) for values in (np.log2(1 + _PIECES), 2**-_PIECES))
"""log2(1 + x) and 2^-x for x from 0 to 1, between which `log2` and `kept` take straight lines."""


class Decided(NamedTuple):
    """Decisions of the integer network, `(window,)` int64 each, as `networks.definition.network.Inference`.

    heard: whether the readout changed. hidden: spikes of the hidden layer in the simulated steps,
    `(window, time, hidden)` uint8. readout: counts or values at the decision, `(window, class)` int64.
    """

    labels: np.ndarray
    steps: np.ndarray
    input_spikes: np.ndarray
    hidden_spikes: np.ndarray
    heard: np.ndarray
    hidden: np.ndarray
    readout: np.ndarray


def over(product: np.ndarray, bits: int) -> np.ndarray:
    """A product divided by 2^bits, rounded towards zero.

    >>> over(np.array([7, -7]), 1).tolist()
    [3, -3]
    """
    return np.sign(product) * (np.abs(product) >> bits)


def follow(state: np.ndarray, target: np.ndarray, weight: Weight) -> np.ndarray:
    """A step of a leaky quantity towards its target: a moving average, or an afferent's membrane."""
    return state + over((target - state) * weight.mantissa, weight.bits)


def encode(raw: np.ndarray, front: FrontEnd, lengths: np.ndarray | None = None) -> np.ndarray:
    """Spikes of raw samples, `(trial, time, taxel)` int16 to `(trial, step, afferent)` uint8.

    Afferents: those of each of `FrontEnd.kinds`.
    lengths: samples of each trial, `(trial,)`, where shorter trials are padded; all when None. After its last sample a
    trial holds it, as resampling does until the trial ends; steps after that end are to be cut (`n_steps`).
    """
    raw = np.asarray(raw, np.int64)[..., front.columns]
    n_trials, n_samples, n_taxels = raw.shape
    lengths = np.full(n_trials, n_samples) if lengths is None else lengths
    if front.closed is not None:
        return _encode_closed(raw, front, lengths, front.closed)
    rest = np.zeros((n_trials, n_taxels), np.int64)
    states = [[rest[:, kind.taxels]] * 2 for kind in front.kinds]
    rows, before = [], None
    for signal in _conditioned(raw, front, lengths):
        drives, before = _drives(signal, before), signal
        stepped = [
            _afferent(drives[kind.drive][:, kind.taxels], state, front.leak, kind)
            for state, kind in zip(states, front.kinds, strict=True)
        ]
        rows.append(np.concatenate([fired for fired, _ in stepped], axis=1))
        states = [state for _, state in stepped]
    if not rows:
        return np.zeros((n_trials, 0, sum(len(kind.taxels) for kind in front.kinds)), np.uint8)
    return np.stack(rows, axis=1).astype(np.uint8)


def _drives(signal: np.ndarray, before: np.ndarray | None) -> dict[str, np.ndarray]:
    change = np.abs(signal - (signal if before is None else before))
    return {"signal": signal, "falling": -signal, "change": change}


def _encode_closed(raw: np.ndarray, front: FrontEnd, lengths: np.ndarray, closed: ClosedForm) -> np.ndarray:
    """`encode` of afferents in closed form: once per sample, the spikes until the next one."""
    n_trials, n_samples, n_taxels = raw.shape
    ends = np.cumsum([len(kind.taxels) for kind in front.kinds])
    rows = np.zeros((n_trials, n_steps(n_samples, front) + 1, ends[-1]), np.uint8)
    rest, before, elapsed, first = np.zeros((n_trials, n_taxels), np.int64), None, 0, 0
    states = [(rest[:, kind.taxels], rest[:, kind.taxels]) for kind in front.kinds]
    for t, signal in enumerate(_conditioned(raw, front, lengths)):
        drives, before = _drives(signal, before), signal
        carry, after = divmod(elapsed + closed.stride[1], 2**32)
        within = (elapsed >> (32 - TICK), first, first + closed.stride[0] + carry)
        for k, kind in enumerate(front.kinds):
            times, states[k] = _interval(drives[kind.drive][:, kind.taxels], states[k], closed, kind)
            _mark(rows[:, :, ends[k] - len(kind.taxels) : ends[k]], times, within, lengths > t)
        elapsed, first = after, within[2]
    return rows[:, : n_steps(n_samples, front)]


def _mark(
    rows: np.ndarray, times: tuple[np.ndarray, np.ndarray, np.ndarray], within: tuple[int, int, int], lasts: np.ndarray
) -> None:
    """Mark spikes in their steps, `(trial, step, afferent)`; lasts: the trials that have this sample.

    times: the first one of each afferent, the interval to the next, and their number. within: ticks of the step under
    way that are over, this step, and that under way at the next sample.
    """
    time, isi, n_spikes = times
    begun, first, last = within
    for nth in range(int(n_spikes.max(initial=0))):
        trial, afferent = np.nonzero((n_spikes > nth) & lasts[:, None])
        at = np.maximum(begun + (time + nth * isi)[trial, afferent] - 1, 0)
        rows[trial, np.minimum(first + (at >> TICK), last), afferent] = 1


def _interval(
    target: np.ndarray, state: tuple[np.ndarray, np.ndarray], closed: ClosedForm, kind: Afferents
) -> tuple[tuple[np.ndarray, np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]:
    """`neurons.exact_lif_interval` in integers: first spikes, intervals and numbers; membranes and refractory ticks."""
    reset, threshold = kind.reset[kind.taxels], kind.threshold[kind.taxels]
    membrane, begin = np.minimum(state[0], threshold - 1), np.minimum(state[1], closed.sample)
    left = np.where(begin > 0, kept(closed.sample - begin, closed), closed.kept)
    after = target + over((membrane - target) * left, OCTAVE)
    fires = (after >= threshold) & (target > threshold)
    room = np.where(fires, target - threshold, 1)
    charged = np.where(fires, target - membrane, 1)
    first = np.minimum(begin + _charging(charged, room, closed), closed.sample)
    isi = kind.silent + _charging(np.where(fires, target - reset, 1), room, closed)
    since = closed.sample - first
    later = since // isi
    since = since - later * isi
    awake = np.maximum(since - kind.silent, 0)
    fallen = target + over((reset - target) * kept(awake, closed), OCTAVE)
    rest = np.where(fires, np.maximum(kind.silent - since, 0), state[1] - begin)
    return (first, isi, np.where(fires, later + 1, 0)), (np.where(fires, fallen, after), rest)


def _charging(distance: np.ndarray, room: np.ndarray, closed: ClosedForm) -> np.ndarray:
    """The ticks, at most `LARGEST`, in which a distance from the target falls to another one, both above 0."""
    return np.minimum((log2(distance) - log2(room)) * closed.octave >> OCTAVE, LARGEST)


def log2(value: np.ndarray) -> np.ndarray:
    """The logarithm to the base 2 of a positive number of 31 bits, times 2^OCTAVE, by straight pieces.

    >>> (log2(np.array([1, 3, 2**30])) / 2**OCTAVE).round(4).tolist()
    [0.0, 1.585, 30.0]
    """
    octave = np.frexp(value.astype(np.float64))[1].astype(np.int64) - 1
    piece, part = np.divmod((value << (31 - octave)) - 2**31 >> 25 - 2 * PIECE, 2 ** (6 + PIECE))
    return (octave << OCTAVE) + CURVES[0][piece] + ((CURVES[0][piece + 1] - CURVES[0][piece]) * part >> 6 + PIECE)


def kept(ticks: np.ndarray, closed: ClosedForm) -> np.ndarray:
    """The share of a membrane's distance from its target that is left after some ticks, times 2^OCTAVE."""
    octave, rest = np.divmod(ticks * closed.per_tick >> TICK, 2**OCTAVE)
    piece, part = np.divmod(rest >> OCTAVE - 8 - 2 * PIECE, 2 ** (8 + PIECE))
    share = CURVES[1][piece] - ((CURVES[1][piece] - CURVES[1][piece + 1]) * part >> 8 + PIECE)
    return share >> np.minimum(octave, 31)


def _afferent(
    target: np.ndarray, state: list[np.ndarray], leak: Weight, kind: Afferents
) -> tuple[np.ndarray, list[np.ndarray]]:
    membrane, remaining = state
    reset, threshold = kind.reset[kind.taxels], kind.threshold[kind.taxels]
    is_active = remaining == 0
    membrane = np.where(is_active, follow(membrane, target, leak), reset)
    fired = is_active & (membrane >= threshold)
    return fired, [np.where(fired, reset, membrane), np.where(fired, kind.silent, np.maximum(remaining - 1, 0))]


def _conditioned(raw: np.ndarray, front: FrontEnd, lengths: np.ndarray) -> Iterator[np.ndarray]:
    """The conditioned signal, a step `(trial, taxel)` at a time."""
    level: np.ndarray | None = None
    total, count = np.zeros_like(raw.sum(axis=1)), 0
    for signal in _on_the_clock(_smoothed(raw, front, lengths), front, raw.shape[1]):
        if front.baseline_weight is not None:
            level = follow(signal if level is None else level, signal, front.baseline_weight)
        elif front.baseline == "start" and count < front.baseline_steps:
            total, count = total + signal, count + 1
            level = np.sign(total) * (np.abs(total) // count)
        signal = (signal - (0 if level is None else level) - front.offset) * front.sign
        yield np.abs(signal) if front.rectify else signal


def _smoothed(raw: np.ndarray, front: FrontEnd, lengths: np.ndarray) -> Iterator[np.ndarray]:
    """The samples of each trial, smoothed; after its last one, a trial holds it."""
    held: np.ndarray | None = None
    for t in range(raw.shape[1]):
        sample = raw[:, t] * 2**FRACTION
        if front.smoothing is not None and held is not None:
            sample = follow(held, sample, front.smoothing)
        held = sample if held is None else np.where((t < lengths)[:, None], sample, held)
        yield held


def _on_the_clock(signal: Iterator[np.ndarray], front: FrontEnd, n_samples: int) -> Iterator[np.ndarray]:
    """Linear interpolation; the next step is `wait` samples and `part` 2^-32ths after the previous sample."""
    if front.stride is None:
        yield from signal
        return
    before, wait, part, n_done = np.zeros(0), 1, 0, 0
    for now in signal:
        while wait == 0 or (wait == 1 and part == 0):
            yield now if wait else before + over((now - before) * (part >> 16), 16)
            n_done += 1
            carry, part = divmod(part + front.stride[1], 2**32)
            wait += front.stride[0] + carry
        before, wait = now, wait - 1
    for _ in range(n_done, n_steps(n_samples, front)):
        yield before


def n_steps(n_samples: int, front: FrontEnd) -> int:
    """Number of steps of a trial of `n_samples`, as `conditioning.conditioned_length`, by the stride of the integers.

    >>> from types import SimpleNamespace
    >>> n_steps(4, SimpleNamespace(stride=(0, 2**31)))  # twice as many steps as samples
    8
    """
    if not n_samples:
        return 0
    if front.stride is None and front.closed is not None:
        return ((n_samples * (front.closed.stride[0] * 2**32 + front.closed.stride[1])) + 2**31) >> 32
    if front.stride is None:
        return n_samples
    stride, sample = front.stride[0] * 2**32 + front.stride[1], 2**32
    return max((n_samples - 1) * sample // stride + 1, (2 * n_samples * sample + stride) // (2 * stride))


def infer(
    windows: np.ndarray, formats: Formats | Layers, neuron: CubaLIF, rule: ExitRule, steps_per_bin: int = 1
) -> Decided:
    """Decide windows of spikes `(window, time, afferent)`.

    steps_per_bin: steps of the encoder's clock in one of the network's. The steps of the decisions are the encoder's.
    """
    n_windows, length, _ = windows.shape
    windows, rule = binned(torch.from_numpy(windows), steps_per_bin).numpy(), rule.in_bins(steps_per_bin)
    n_steps = windows.shape[1]
    hidden, readout = formats.hidden, formats.readout
    state = _Neurons.start(n_windows, hidden.w)
    out, counts = _Neurons.start(n_windows, readout.w), np.zeros((n_windows, readout.w.shape[-1]), np.int64)
    if isinstance(readout, Integrator):
        counts = counts + readout.bias
    band, first = whole_band(readout, rule), torch.from_numpy(counts)
    leader = Leader.start(n_windows, counts.shape[1], torch.device("cpu"))
    leader = leader._replace(counts=first, stood=first if band else None)
    running = np.full(n_windows, n_steps > 0)
    hidden_raster = np.zeros((n_windows, n_steps, hidden.w.shape[1]), np.uint8)
    labels, steps, input_spikes, hidden_spikes, is_heard = (np.zeros(n_windows, np.int64) for _ in range(5))
    decided = Decided(labels, steps, input_spikes, hidden_spikes, is_heard, hidden_raster, counts.copy())
    refusing = ExitRule(least_lead=least_lead(readout, rule))
    for t in range(n_steps):
        inputs = windows[:, t].astype(np.int64)
        spikes, state = _step(hidden, neuron, inputs, state)
        if isinstance(readout, Integrator):
            heard = np.concatenate([spikes, inputs], axis=1)  # the afferents, too, where there are weights for them
            increments = heard[:, : readout.w.shape[-2]] @ readout.at(t)
        else:
            increments, out = _step(readout, neuron, spikes, out)
        decided.steps[running] = min((t + 1) * steps_per_bin, length)
        decided.input_spikes[running] += inputs[running].sum(axis=1)
        decided.hidden_spikes[running] += spikes[running].sum(axis=1)
        hidden_raster[running, t] = spikes[running]
        leader = leader.after(torch.from_numpy(increments), band=band)
        told = refusing.told(leader.index, leader.counts)
        decided.labels[running], decided.heard[running] = told.numpy()[running], leader.heard.numpy()[running]
        decided.readout[running] = leader.counts.numpy()[running]
        running = running & ~leader.exits(rule).numpy()
        if not running.any():
            break
    return decided


def least_lead(readout: Integrator | Layer, rule: ExitRule) -> int:
    """The least lead of a rule in the unit of a readout; a lead in whole units is less if and only if it is less."""
    if not rule.least_lead:
        return 0  # also where each number has a unit of its own
    return math.ceil(rule.least_lead / (readout.unit if isinstance(readout, Integrator) else 1))


def whole_band(readout: Integrator | Layer, rule: ExitRule) -> tuple[int, ...]:
    """The band of a rule in the unit of each number; whole numbers are within it if and only if they were before."""
    if not rule.band:
        return ()
    return tuple(np.floor(np.divide(rule.band, getattr(readout, "unit", 1))).astype(int).tolist())


class _Neurons(NamedTuple):
    """Current, membrane, spikes and the spikes of the step before, `(window, neuron)` int64 each."""

    current: np.ndarray
    membrane: np.ndarray
    spikes: np.ndarray
    spikes_before: np.ndarray

    @staticmethod
    def start(n_windows: int, w: np.ndarray) -> "_Neurons":
        return _Neurons(*(np.zeros((n_windows, w.shape[1]), np.int64) for _ in range(4)))


def _step(layer: Layer, neuron: CubaLIF, inputs: np.ndarray, state: _Neurons) -> tuple[np.ndarray, _Neurons]:
    """`neurons.cuba_lif_step` in integers."""
    current = over(state.current * layer.alpha, layer.decay_bits) + (inputs @ layer.w) * 2**layer.shift
    if layer.v is not None:
        recurrent = state.spikes_before if neuron.recurrent_delay_steps else state.spikes
        current = current + (recurrent @ layer.v) * 2**layer.shift_rec
    current = _saturated(current, layer.state_bits)
    fired = state.membrane > layer.threshold
    carried = np.where(fired, 0, state.membrane) if neuron.reset == "hard" else state.membrane
    if neuron.membrane == "eq4":
        membrane = over((carried + state.current) * layer.beta, layer.decay_bits)
    else:
        added = state.current if neuron.membrane == "delayed" else current
        membrane = over(carried * layer.beta, layer.decay_bits) + added
    if neuron.reset == "zero":
        membrane = np.where(fired, 0, membrane)
    elif neuron.reset == "subtract":
        membrane = membrane - layer.threshold * fired
    membrane = _saturated(membrane, layer.state_bits)
    after = _Neurons(current, membrane, (membrane > layer.threshold).astype(np.int64), state.spikes)
    return (after if neuron.membrane == "immediate" else state).spikes, after


def _saturated(state: np.ndarray, bits: int) -> np.ndarray:
    most = 2 ** (bits - 1) - 1
    return np.clip(state, -most, most)
