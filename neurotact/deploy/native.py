"""The compiled step of a stream; its computation is defined in `stream.py` and the functions called there."""

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import torch

from neurotact.backend import native
from neurotact.data.conditioning import CAUSAL, Conditioned, Conditioner
from neurotact.deploy.chain import Chain
from neurotact.deploy.running import Running
from neurotact.deploy.windows import Opening
from neurotact.encoders.afferents import EncoderState
from neurotact.networks.definition import native as networks
from neurotact.networks.exit.early_exit import Leader
from neurotact.neurons import CubaLIFState, LIFState, lif_start

BASELINES = {"none": 0, "start": 2, "high-pass": 4}
"""By the numbers of the compiled stream."""
COUNTERS = ("samples", "steps", "silent", "free_at", "n_windows", "under_way")
Decided = tuple[int, int, int, int, int, int, int, bool]
"""A decided window: its number, start, steps, label, input spikes, hidden spikes, held, heard."""
LANES = 8
"""Number of taxels that are computed together; arrays are padded to a multiple of it."""


class Remembered(NamedTuple):
    """The state of the compiled step, in the format of the reference."""

    opening: Opening
    conditioned: Conditioned
    encoder: EncoderState | None
    windows: tuple[Running, ...]
    n_windows: int


class CompiledStream:
    """Conditioning, afferents, windows, network and exit of a chain, one sample after the other.

    most_samples: maximum number of samples of one `push`.
    """

    def __init__(self, chain: Chain, conditioner: Conditioner, most_samples: int) -> None:
        self.chain, self.conditioner = chain, conditioner
        self._most_steps = math.ceil(most_samples * max(1.0, chain.clock_Hz / chain.sampling_rate_Hz)) + 1
        network, encoder, plan = chain.network, chain.lif, chain.windows
        spec, n_taxels = conditioner.how, chain.n_taxels
        sa1, ra1 = (encoder.neuron(kind, chain.clock_Hz) for kind in (encoder.sa1, encoder.ra1))
        gains = encoder.gains_at(chain.clock_Hz)
        smoothing, level = conditioner.smoothing, conditioner.following or 0.0
        standard = (spec.offset or (0.0,) * n_taxels, spec.scale or (1.0,) * n_taxels)
        offset, scale = (np.array(values, np.float32) for values in standard)
        is_standard = spec.offset is not None or spec.scale is not None
        bias = None if network.bias is None else network.bias.detach().double().numpy()
        readout_weights = network.readout_weights.detach()  # the stream copies what lies at the addresses
        self._stream = native.Stream(  # pyright: ignore[reportOptionalMemberAccess]
            networks.shape_of(network), taxels=n_taxels, factor=float(conditioner.factor),
            smooth=smoothing is not None, smooth_new=smoothing or 0.0, smooth_kept=1.0 - (smoothing or 0.0),
            resampled=conditioner.clock_Hz != conditioner.rate_Hz,
            samples_per_step=conditioner.rate_Hz / conditioner.clock_Hz,
            baseline=BASELINES[spec.baseline], start_steps=conditioner.n_start,
            base_new=level, base_kept=1.0 - level,
            offset=offset.ctypes.data if is_standard else 0, scale=scale.ctypes.data if is_standard else 0,
            rectify=spec.rectify, sa_gains=[*gains[0]], ra_gains=[*gains[1]],
            decay=sa1.decay, v_rest=sa1.v_rest_mV, v_reset=sa1.v_reset_mV, v_threshold=sa1.v_threshold_mV,
            sa_silent=sa1.refractory_steps, ra_silent=ra1.refractory_steps, length=plan.length, start=plan.start,
            hop=plan.hop, quiet=plan.quiet, bin=network.steps_per_bin, at_once=plan.at_once,
            **networks.exits_at(chain.rule.in_bins(network.steps_per_bin)),
            **networks.addresses_of(network, readout_weights),
            bias=0 if bias is None else bias.ctypes.data, most_samples=most_samples,
            most_decisions=self._most_steps + plan.at_once + 1,
        )  # fmt: skip
        self.push = self._stream.push
        """The decisions of samples `(sample, taxel)` float32; None, without any effect, if one is not valid."""
        self.take = self._stream.take
        """The same for the samples of a caller, which are counted; None if they are not contiguous float32."""

    def counted(self) -> tuple[int, np.ndarray]:
        """Number of samples that `take` processed since the last call, and the values of the last sample."""
        n_samples, last = self._stream.counted()
        return n_samples, np.frombuffer(last, np.float32)

    def watch(self) -> None:
        """From now on, each push records the spikes of its steps."""
        self._stream.watch(self._most_steps)

    def watched(self) -> tuple[int, np.ndarray, np.ndarray, np.ndarray]:
        """Of the last push: its first step, and `afferents`, `hidden` and `window` of a `Trace`."""
        first, *rows = self._stream.watched()
        window = np.frombuffer(rows[2], np.int64)
        sizes = (self.chain.network.n_inputs, self.chain.network.spec.hidden)
        afferents, hidden = (_rows(bits, n, len(window)) for bits, n in zip(rows, sizes, strict=False))
        return first, afferents, hidden, window

    def remembered(self) -> Remembered:
        """The state, in the format of the reference."""
        parts = list(self._stream.state())
        counters: dict[str, int] = dict(zip(COUNTERS, np.frombuffer(parts[0][1], np.int64).tolist(), strict=True))
        taxels = dict(parts[1:5])
        n_states = 2 * self._n_groups * self._n_kinds
        states = [content for _, content in parts[5 : 5 + n_states]]
        rest = iter(parts[5 + n_states :])
        values = {
            name: self._taxels(content, np.float64 if name == "total" else np.float32)
            for name, content in taxels.items()
        }
        opening = Opening(self.chain.windows, counters["steps"], counters["silent"], counters["free_at"])
        windows = tuple(self._window(rest) for _ in range(counters["under_way"]))
        return Remembered(
            opening, self._conditioned(counters, values), self._encoder(counters, values, states), windows,
            counters["n_windows"],
        )  # fmt: skip

    def remember(self, state: Remembered) -> None:
        """Continue from a state."""
        spec = self.conditioner.how
        done, opening = state.conditioned, state.opening
        counters = (done.n_samples, done.n_steps, opening.silent, opening.free_at, state.n_windows, len(state.windows))
        smoothed = done.smoothed if done.held is None else done.held[-1]
        carried = (None, 0) if done.carried is None else done.carried
        total = carried[0] if spec.baseline == "start" else None
        level = carried[0] if spec.baseline == "high-pass" else None
        encoder = state.encoder
        last = None if encoder is None or encoder.last is None else encoder.last[0]
        parts = [np.array(counters, np.int64).tobytes()]
        parts += [self._lanes(values, np.float32) for values in (smoothed, level, last)]
        parts.append(self._lanes(total, np.float64))
        parts += self._states_of(encoder)
        for window in state.windows:
            parts += _parts_of(window, adapts=self.chain.network.adaptation is not None)
        self._stream.restore(parts)

    @property
    def _n_kinds(self) -> int:
        """Afferents under a taxel."""
        return self.chain.network.n_inputs // self.chain.n_taxels

    @property
    def _n_groups(self) -> int:
        """Groups of taxels that are computed together."""
        return -(-self.chain.n_taxels // LANES)

    def _states_of(self, encoder: EncoderState | None) -> list[bytes]:
        """Membranes and refractory steps of each kind of afferent of each group of taxels."""
        n, lif = self.chain.n_taxels, self.chain.lif
        if encoder is None:
            populations = [
                lif_start(lif.neuron(kind, self.chain.clock_Hz), (1, n * len(kind.gains)), np.dtype(np.float32))
                for kind in (lif.sa1, lif.ra1)
            ]
        else:
            populations = [encoder.sa1, encoder.ra1]
        lanes: list[tuple[bytes, bytes]] = []
        for population in populations:
            membranes, silent = (values[0].reshape(-1, n) for values in population)
            lanes += [
                (self._lanes(of_kind, np.float32), self._lanes(left, np.int32))
                for of_kind, left in zip(membranes, silent, strict=True)
            ]
        width = 4 * LANES
        places = [slice(width * group, width * (group + 1)) for group in range(self._n_groups)]
        return [part[index] for index in places for kind in lanes for part in kind]

    def _taxels(self, content: bytes, kind: Any) -> np.ndarray:
        return np.frombuffer(content, kind)[: self.chain.n_taxels].copy()

    def _lanes(self, values: np.ndarray | None, kind: Any) -> bytes:
        filled = np.zeros(-(-self.chain.n_taxels // LANES) * LANES, kind)
        if values is not None:
            filled[: self.chain.n_taxels] = values
        return filled.tobytes()

    def _conditioned(self, counters: dict[str, int], values: dict[str, np.ndarray]) -> Conditioned:
        samples, steps, spec = counters["samples"], counters["steps"], self.conditioner.how
        if not samples:
            return Conditioned()
        carried = None
        if spec.baseline in CAUSAL:
            is_ema = spec.baseline == "high-pass"
            n_averaged = steps if is_ema else min(steps, self.conditioner.n_start)
            carried = (values["level" if is_ema else "total"], n_averaged)
        resampled = self.conditioner.clock_Hz != self.conditioner.rate_Hz
        return Conditioned(
            samples, steps,
            smoothed=None if self.conditioner.smoothing is None else values["smoothed"],
            held=values["smoothed"][None] if resampled else None,
            carried=carried,
        )  # fmt: skip

    def _encoder(
        self, counters: dict[str, int], values: dict[str, np.ndarray], states: list[bytes]
    ) -> EncoderState | None:
        """states: as `_states_of` gives them."""
        if not counters["steps"]:
            return None
        every = [
            (
                self._taxels(b"".join(states[2 * kind :: 2 * self._n_kinds]), np.float32),
                self._taxels(b"".join(states[2 * kind + 1 :: 2 * self._n_kinds]), np.int32),
            )
            for kind in range(self._n_kinds)
        ]
        n_slow = len(self.chain.lif.sa1.gains)
        sa1, ra1 = (
            LIFState(*(np.concatenate(parts)[None] for parts in zip(*kinds, strict=True)))
            for kinds in (every[:n_slow], every[n_slow:])
        )
        return EncoderState(sa1, ra1, values["last"][None])

    def _window(self, parts: Iterator[tuple[str, bytes]]) -> Running:
        network = self.chain.network
        n_hidden, n_classes, spiking = network.spec.hidden, network.n_classes, network.bias is None

        def read(kind: Any) -> np.ndarray:
            return np.frombuffer(next(parts)[1], kind).copy()

        def row(values: np.ndarray) -> torch.Tensor:
            return torch.from_numpy(values[None])

        window, start, steps, input_spikes, hidden_spikes, held = read(np.int64).tolist()
        waiting = _bits(read(np.uint64), network.n_inputs).astype(bool)
        current, membrane = (row(read(np.float32)) for _ in range(2))
        spikes, before = (row(_bits(read(np.uint64), n_hidden)) for _ in range(2))
        adaptation = torch.zeros(1, n_hidden) if network.adaptation is None else row(read(np.float32))
        hidden = CubaLIFState(current, membrane, spikes, before, adaptation)
        readout = None
        if spiking:
            current, membrane = (row(read(np.float32)) for _ in range(2))
            spikes = row(_bits(read(np.uint64), n_classes))
            zeros = torch.zeros_like(spikes)
            readout = CubaLIFState(current, membrane, spikes, zeros, zeros)
        leaky = row(read(np.float64)) if network.leaks else None
        counts = row(read(np.int64 if spiking else np.float64))
        index, standing, since = (torch.tensor([value]) for value in read(np.int64).tolist())
        leader = Leader(counts, index, standing, since, torch.tensor([bool(next(parts)[1][0])]), leaky)
        return Running(window, start, steps, hidden, readout, leader, waiting, input_spikes, hidden_spikes, held)


def _parts_of(window: Running, *, adapts: bool) -> list[bytes]:
    numbers = (window.window, window.start, window.steps, window.input_spikes, window.hidden_spikes, window.held)
    hidden, readout, leader = window.hidden, window.readout, window.leader
    parts = [np.array(numbers, np.int64).tobytes(), _words(window.waiting)]
    parts += [_bytes(hidden.current), _bytes(hidden.membrane), _words(hidden.spikes), _words(hidden.spikes_before)]
    if adapts:
        parts.append(_bytes(hidden.adaptation))
    if readout is not None:
        parts += [_bytes(readout.current), _bytes(readout.membrane), _words(readout.spikes)]
    if leader.leaky is not None:
        parts.append(_bytes(leader.leaky))
    standing = np.array([int(leader.index), int(leader.standing), int(leader.standing_since_spike)], np.int64)
    return [*parts, _bytes(leader.counts), standing.tobytes(), bytes([bool(leader.heard)])]


def _bytes(values: torch.Tensor) -> bytes:
    return values.detach().numpy().tobytes()


def _bits(words: np.ndarray, n: int) -> np.ndarray:
    """Spikes of `n` neurons as float32, from words of 64 bits, lowest bit first."""
    return np.unpackbits(words.view(np.uint8), bitorder="little")[:n].astype(np.float32)


def _rows(words: bytes, n: int, n_steps: int) -> np.ndarray:
    """Spikes of `n` neurons as `(step, n)` bool, from one row of words per step."""
    rows = np.frombuffer(words, np.uint8).reshape(n_steps, -(-n // 64) * 8)
    return np.unpackbits(rows, axis=1, count=n, bitorder="little").astype(bool)


def _words(spikes: torch.Tensor | np.ndarray) -> bytes:
    bits = np.packbits(np.asarray(spikes).ravel() != 0, bitorder="little").tobytes()
    return bits.ljust(-(-len(bits) // 8) * 8, b"\0")
