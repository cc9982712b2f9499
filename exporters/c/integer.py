"""The chain in integers, for many trials or windows together: what the integer variant of the C export computes.

Arithmetic: products are divided by a power of two and rounded towards zero, as C99's `/` does, so that decaying values
reach zero. States saturate to their bits once per step. NumPy computes in 64 bits, in which nothing here overflows; the
formats are chosen so that nothing overflows in 32 bits in C.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import torch
from neurotact_parts.exporters.c.formats import (
    FRACTION,
    Afferents,
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


class Decided(NamedTuple):
    """Decisions of the integer network, `(window,)` int64 each, as `networks.definition.network.Inference`.

    heard: whether the readout changed. hidden: spikes of the hidden layer in the simulated steps,
    `(window, time, hidden)` uint8.
    """

    labels: np.ndarray
    steps: np.ndarray
    input_spikes: np.ndarray
    hidden_spikes: np.ndarray
    heard: np.ndarray
    hidden: np.ndarray


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
    rest = np.zeros((n_trials, n_taxels), np.int64)
    states = [[rest[:, kind.taxels]] * 2 for kind in front.kinds]
    rows, before = [], None
    for signal in _conditioned(raw, front, lengths):
        change = np.abs(signal - (signal if before is None else before))
        before = signal
        drives = {"signal": signal, "falling": -signal, "change": change}
        stepped = [
            _afferent(drives[kind.drive][:, kind.taxels], state, front.leak, kind)
            for state, kind in zip(states, front.kinds, strict=True)
        ]
        rows.append(np.concatenate([fired for fired, _ in stepped], axis=1))
        states = [state for _, state in stepped]
    if not rows:
        return np.zeros((n_trials, 0, sum(len(kind.taxels) for kind in front.kinds)), np.uint8)
    return np.stack(rows, axis=1).astype(np.uint8)


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
    if front.stride is None or not n_samples:
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
    leader = Leader.start(n_windows, counts.shape[1], torch.device("cpu"))._replace(counts=torch.from_numpy(counts))
    running = np.full(n_windows, n_steps > 0)
    hidden_raster = np.zeros((n_windows, n_steps, hidden.w.shape[1]), np.uint8)
    labels, steps, input_spikes, hidden_spikes, is_heard = (np.zeros(n_windows, np.int64) for _ in range(5))
    decided = Decided(labels, steps, input_spikes, hidden_spikes, is_heard, hidden_raster)
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
        leader = leader.after(torch.from_numpy(increments))
        decided.labels[running], decided.heard[running] = leader.index.numpy()[running], leader.heard.numpy()[running]
        running = running & ~leader.exits(rule).numpy()
        if not running.any():
            break
    return decided


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
