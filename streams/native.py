"""The compiled step of a stream; its computation is defined in `stream.py` and the functions called there."""

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import torch
from neurotact_parts.streams.chain import Chain
from neurotact_parts.streams.running import Running, fans_of
from neurotact_parts.streams.windows import Opening

from neurotact.backend import native
from neurotact.data.conditioning import CAUSAL, Conditioned, Conditioner
from neurotact.encoders.afferents import EncoderState
from neurotact.networks.definition import native as networks
from neurotact.networks.exit.rule import Leader
from neurotact.neurons import CubaLIFState, LIFState, lif_start

BASELINES = {"none": 0, "start": 2, "high-pass": 4}
"""By the numbers of the compiled stream."""
Decided = tuple[int, int, int, int, int, int, int, bool] | tuple[int, int, int, int, int, int, int, bool, int]
"""A decided window: its number, start, steps, label, input spikes, hidden spikes, held, heard; and the operations of a
pruned network, as in `NUMBERS`."""
NUMBERS = ("window", "start", "steps", "input_spikes", "hidden_spikes", "held", "sops")
STANDING = ("index", "standing", "standing_since_spike")
LANES = 8
"""Number of taxels that are computed together; arrays are padded to a multiple of it."""


class Layout(NamedTuple):
    """The state of a compiled stream (`native/stream.cpp`): `stream`, then a `window` for each that is under way."""

    stream: np.dtype
    window: np.dtype

    @classmethod
    def of(cls, chain: Chain) -> "Layout":
        """The layout for a chain, whose taxels fill up whole groups of `LANES`."""
        network, groups = chain.network, -(-chain.n_taxels // LANES)
        n, n_classes, taxels = network.spec.hidden, network.n_classes, groups * LANES
        spiking = network.bias is None
        counters = ("samples", "steps", "silent", "free_at", "n_windows", "under_way")
        neurons = np.dtype([("membrane", "f4", LANES), ("silent", "i4", LANES)])
        stream = [
            *((name, "i8") for name in counters),
            *((name, "f4", taxels) for name in ("smoothed", "level", "last")),
            ("total", "f8", taxels), ("afferents", neurons, (groups, len(columns_of(chain)))),
        ]  # fmt: skip
        layer = [("current", "f4", n), ("membrane", "f4", n), ("spikes", *_words(n)), ("spikes_before", *_words(n))]
        layer += [("adaptation", "f4", n)] if network.adaptation is not None else []
        readout = [("current", "f4", n_classes), ("membrane", "f4", n_classes), ("spikes", *_words(n_classes))]
        numbers = NUMBERS if network.synapses else NUMBERS[:-1]
        window = [
            *((name, "i8") for name in numbers), ("waiting", *_words(network.n_inputs)), ("hidden", np.dtype(layer)),
            *([("readout", np.dtype(readout))] if spiking else []),
            *([("leaky", "f8", n_classes)] if network.leaks else []),
            ("counts", "i8" if spiking else "f8", n_classes),
            *((name, "i8") for name in STANDING), ("heard", "?"),
        ]  # fmt: skip
        return cls(np.dtype(stream), np.dtype(window))


def columns_of(chain: Chain) -> list[list[int]]:
    """The taxels of each kind of afferent that the chain has: a kind for each gain of SA-I, then of RA-I."""
    kinds = zip(chain.lif.columns(chain.n_taxels), (chain.lif.sa1, chain.lif.ra1), strict=True)
    return [taxels for taxels, kind in kinds if taxels for _ in kind.gains]


def numbers_of(columns: list[list[int]], n_taxels: int) -> np.ndarray:
    """The number of each afferent, `(kind, taxel)`, -1 where there is none, for the taxels of each kind.

    >>> numbers_of([[0, 1], [1]], 2).tolist()
    [[0, 1], [-1, 2]]
    """
    is_there = np.array([np.isin(np.arange(n_taxels), taxels) for taxels in columns])
    return np.where(is_there, is_there.ravel().cumsum().reshape(is_there.shape) - 1, -1)


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
        self._layout = Layout.of(chain)
        self._most_steps = math.ceil(most_samples * max(1.0, chain.clock_Hz / chain.sampling_rate_Hz)) + 1
        network, encoder, plan = chain.network, chain.lif, chain.windows
        spec, n_taxels = conditioner.how, chain.n_taxels
        sa1, ra1 = (encoder.neuron(kind, chain.clock_Hz) for kind in (encoder.sa1, encoder.ra1))
        self._columns = columns_of(chain)
        gains = [
            [*its] if taxels else []
            for its, taxels in zip(encoder.gains_at(chain.clock_Hz), encoder.columns(n_taxels), strict=True)
        ]
        is_whole = encoder.has_all_taxels  # then the place of an afferent is its number
        numbers = {} if is_whole else {"numbers": numbers_of(self._columns, n_taxels).ravel().tolist()}
        smoothing, level = conditioner.smoothing, conditioner.following or 0.0
        standard = (spec.offset or (0.0,) * n_taxels, spec.scale or (1.0,) * n_taxels)
        offset, scale = (np.array(values, np.float32) for values in standard)
        is_standard = spec.offset is not None or spec.scale is not None
        bias = None if network.bias is None else network.bias.detach().double().numpy()
        readout_weights = network.readout_weights.detach()  # the stream copies what lies at the addresses
        fans = None if (counted := fans_of(network)) is None else np.concatenate(counted).astype(np.float32)
        self._stream = native.Stream(  # pyright: ignore[reportOptionalMemberAccess]
            networks.shape_of(network), taxels=n_taxels, factor=float(conditioner.factor),
            smooth=smoothing is not None, smooth_new=smoothing or 0.0, smooth_kept=1.0 - (smoothing or 0.0),
            resampled=conditioner.clock_Hz != conditioner.rate_Hz,
            samples_per_step=conditioner.rate_Hz / conditioner.clock_Hz,
            baseline=BASELINES[spec.baseline], start_steps=conditioner.n_start,
            base_new=level, base_kept=1.0 - level,
            offset=offset.ctypes.data if is_standard else 0, scale=scale.ctypes.data if is_standard else 0,
            rectify=spec.rectify, sa_gains=gains[0], ra_gains=gains[1],
            decay=sa1.decay, v_rest=sa1.v_rest_mV, v_reset=sa1.v_reset_mV, v_threshold=sa1.v_threshold_mV,
            sa_silent=sa1.refractory_steps, ra_silent=ra1.refractory_steps, length=plan.length, start=plan.start,
            hop=plan.hop, quiet=plan.quiet, bin=network.steps_per_bin, at_once=plan.at_once,
            **networks.exits_at(chain.rule.in_bins(network.steps_per_bin)), least_lead=chain.rule.least_lead,
            **networks.addresses_of(network, readout_weights), **numbers,
            bias=0 if bias is None else bias.ctypes.data, most_samples=most_samples,
            most_decisions=self._most_steps + plan.at_once + 1, **({} if fans is None else {"fans": fans.ctypes.data}),
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
        content = self._stream.state()
        found = np.frombuffer(content, self._layout.stream, 1)[0]
        windows = np.frombuffer(content, self._layout.window, offset=self._layout.stream.itemsize)
        opening = Opening(self.chain.windows, *(int(found[name]) for name in ("steps", "silent", "free_at")))
        return Remembered(
            opening, self._conditioned(found), self._encoder(found), tuple(map(self._window, windows)),
            int(found["n_windows"]),
        )  # fmt: skip

    def remember(self, state: Remembered) -> None:
        """Continue from a state."""
        found, windows = np.zeros(1, self._layout.stream)[0], np.zeros(len(state.windows), self._layout.window)
        done, opening, n = state.conditioned, state.opening, self.chain.n_taxels
        for name, value in zip(
            found.dtype.names,
            (done.n_samples, done.n_steps, opening.silent, opening.free_at, state.n_windows, len(windows)),
            strict=False,
        ):
            found[name] = value
        carried = None if done.carried is None else done.carried[0]
        is_ema = self.conditioner.how.baseline == "high-pass"
        encoder = state.encoder
        for name, values in (
            ("smoothed", done.smoothed if done.held is None else done.held[-1]),
            ("level", carried if is_ema else None),
            ("total", None if is_ema else carried),
            ("last", None if encoder is None or encoder.last is None else encoder.last[0]),
        ):
            if values is not None:
                found[name][:n] = values
        for name, values in zip(("membrane", "silent"), self._populations(encoder), strict=True):
            lanes = np.zeros((len(values), self._n_lanes), values[0].dtype)
            for row, taxels, its in zip(lanes, self._columns, values, strict=True):
                row[taxels] = its
            found["afferents"][name] = lanes.reshape(len(values), -1, LANES).swapaxes(0, 1)
        for window, into in zip(state.windows, windows, strict=True):
            _fill(window, into)
        self._stream.restore(found.tobytes() + windows.tobytes())

    @property
    def _n_lanes(self) -> int:
        """Taxels, filled up to whole groups."""
        return -(-self.chain.n_taxels // LANES) * LANES

    def _populations(self, encoder: EncoderState | None) -> Iterator[list[np.ndarray]]:
        """Membranes and refractory steps of each kind of afferent, `(taxel,)` each."""
        ends = np.cumsum([len(taxels) for taxels in self._columns])
        if encoder is None:  # both populations start alike
            lif = self.chain.lif
            whole = lif_start(lif.neuron(lif.sa1, self.chain.clock_Hz), (1, ends[-1]), np.dtype(np.float32))
        else:
            whole = (np.concatenate(parts, axis=1) for parts in zip(encoder.sa1, encoder.ra1, strict=True))
        for values in whole:
            yield np.split(values[0], ends[:-1])

    def _taxels(self, values: np.ndarray) -> np.ndarray:
        return values[..., : self.chain.n_taxels].copy()

    def _conditioned(self, found: np.void) -> Conditioned:
        samples, steps, spec = int(found["samples"]), int(found["steps"]), self.conditioner.how
        if not samples:
            return Conditioned()
        smoothed, level, total = (self._taxels(found[name]) for name in ("smoothed", "level", "total"))
        carried = None
        if spec.baseline in CAUSAL:
            n_averaged = min(steps, self.conditioner.n_start) if spec.baseline == "start" else steps
            carried = (level if spec.baseline == "high-pass" else total, n_averaged)
        resampled = self.conditioner.clock_Hz != self.conditioner.rate_Hz
        return Conditioned(
            samples, steps,
            smoothed=None if self.conditioner.smoothing is None else smoothed,
            held=smoothed[None] if resampled else None,
            carried=carried,
        )  # fmt: skip

    def _encoder(self, found: np.void) -> EncoderState | None:
        if not found["steps"]:
            return None
        lif, parts = self.chain.lif, []
        for name in ("membrane", "silent"):
            lanes = found["afferents"][name].swapaxes(0, 1).reshape(-1, self._n_lanes)
            parts.append(np.concatenate([row[its] for row, its in zip(lanes, self._columns, strict=True)])[None])
        n_slow = len(lif.sa1.gains) * len(lif.columns(self.chain.n_taxels)[0])
        sa1, ra1 = (
            LIFState(*(part[:, block].copy() for part in parts)) for block in (slice(n_slow), slice(n_slow, None))
        )
        return EncoderState(sa1, ra1, self._taxels(found["last"])[None])

    def _window(self, found: np.void) -> Running:
        network, names = self.chain.network, found.dtype.names
        assert names is not None
        hidden = _layer(found["hidden"], network.spec.hidden)
        readout = _layer(found["readout"], network.n_classes) if "readout" in names else None
        standing = {name: torch.tensor([int(found[name])]) for name in STANDING}
        leaky = _row(found["leaky"]) if "leaky" in names else None
        leader = Leader(_row(found["counts"]), heard=torch.tensor([bool(found["heard"])]), leaky=leaky, **standing)
        waiting = _unpacked(found["waiting"], network.n_inputs).astype(bool)
        numbers = {name: int(found[name]) for name in NUMBERS if name in names}
        return Running(hidden=hidden, readout=readout, leader=leader, waiting=waiting, **numbers)


def _fill(window: Running, into: np.void) -> None:
    """Write a window into a record of `Layout.window`."""
    for name in {*NUMBERS} & {*(into.dtype.names or ())}:
        into[name] = getattr(window, name)
    into["waiting"] = _packed(window.waiting, into["waiting"])
    for name in {"hidden", "readout"} & {*(into.dtype.names or ())}:
        layer, part = getattr(window, name), into[name]
        for key in part.dtype.names:
            values = getattr(layer, key).detach().numpy().ravel()
            part[key] = _packed(values, part[key]) if key.startswith("spikes") else values
    leader = window.leader
    for name in STANDING:
        into[name] = int(getattr(leader, name))
    into["heard"], into["counts"] = bool(leader.heard), leader.counts.numpy().ravel()
    if leader.leaky is not None:
        into["leaky"] = leader.leaky.numpy().ravel()


def _layer(found: np.void, n: int) -> CubaLIFState:
    parts = {
        name: _row(_unpacked(found[name], n) if name.startswith("spikes") else found[name])
        for name in found.dtype.names or ()
    }
    absent = {name: torch.zeros(1, n) for name in CubaLIFState._fields if name not in parts}
    return CubaLIFState(**parts, **absent)


def _row(values: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(np.array(values)[None])


def _words(n: int) -> tuple[str, int]:
    """Type and length of the spikes of `n` neurons: words of 64 bits, lowest bit first."""
    return "u1", 8 * -(-n // 64)


def _packed(spikes: np.ndarray, like: np.ndarray) -> np.ndarray:
    bits = np.packbits(spikes != 0, bitorder="little")
    return np.pad(bits, (0, len(like) - len(bits)))


def _unpacked(words: np.ndarray, n: int) -> np.ndarray:
    """Spikes of `n` neurons as float32."""
    return np.unpackbits(words, count=n, bitorder="little").astype(np.float32)


def _rows(words: bytes, n: int, n_steps: int) -> np.ndarray:
    """Spikes of `n` neurons as `(step, n)` bool, from one row of words per step."""
    rows = np.frombuffer(words, np.uint8).reshape(n_steps, _words(n)[1])
    return np.unpackbits(rows, axis=1, count=n, bitorder="little").astype(bool)
