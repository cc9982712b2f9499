"""The sources of samples of a live session: recordings, a simulated finger, or a device.

A feed yields pieces at their own rate, and an empty piece after each wait of `TICK_S`, so that the session can handle
requests. `label` is the touched class while a piece is read; None if unknown.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from neurotact_parts.exporters.live.finger import Control
from neurotact_parts.streams import sources
from neurotact_parts.streams.sources import Arrived, Faults
from neurotact_parts.streams.streamed import SampleSpec

from neurotact.data import hdf5
from neurotact.data.dataset import Simulator
from neurotact.data.recordings import LABEL, order_by_name
from neurotact.errors import InputError

TICK_S = 0.02
BLOCK_S = 0.008
"""Length of a piece: half of the interval between two frames at 60 per second."""
LIFTED_S = 0.25
"""Time without contact between two touches."""


class Feed(Protocol):
    """A source of samples.

    kind: recordings, finger or device. name: as the user gave it. taxels: their names.
    label, note: the touched class, and the position of the piece in the source, in words.
    """

    kind: str
    name: str
    sampling_rate_Hz: float
    unit: str
    taxels: tuple[str, ...]
    label: str | None
    note: str

    def pieces(self, faults: Faults) -> Iterator[Arrived]: ...


class Paced:
    """The common part of feeds with their own rate: the speed, as a multiple of that rate."""

    speed: float = 1.0
    sampling_rate_Hz: float

    def _at_its_rate(self, pieces: Iterator[Arrived], faults: Faults) -> Iterator[Arrived]:
        block = max(1, round(BLOCK_S * self.sampling_rate_Hz))
        return sources.at_its_rate(
            pieces, self.sampling_rate_Hz, faults, block, speed=lambda: self.speed, tick_s=TICK_S
        )


class Replay(Paced):
    """The trials of a file of recordings, one after the other.

    loops: repeat them. shuffled: in a random order, another one in each repetition; the same in each session.
    """

    kind = "recordings"

    def __init__(self, path: str, speed: float, *, loops: bool, shuffled: bool = False) -> None:
        self.name, self.speed, self._loops = path, speed, loops
        self._ordered: Callable[[int], Iterable[int]] = range
        if shuffled:
            generator = np.random.default_rng(0)
            self._ordered = lambda n: generator.permutation(n).tolist()
        with hdf5.open_recordings(path) as stored:
            self.sampling_rate_Hz, self.unit, self.taxels = stored.sampling_rate_Hz, stored.unit, stored.channels
            self._labels = stored.conditions[LABEL].astype(str).tolist()
        self.label: str | None = None
        self.note = ""

    def give_in_order(self, taxels: tuple[str, ...] | None) -> None:
        """Give the taxels in the order of these names, where they have them; InputError for other names."""
        if order_by_name(self.taxels, taxels, self.name) is not None:
            self.taxels = taxels or self.taxels

    def pieces(self, faults: Faults) -> Iterator[Arrived]:
        block = max(1, round(BLOCK_S * self.sampling_rate_Hz))
        while True:
            for piece in self._at_its_rate(self._stored(block), faults):
                if piece.trial is not None:
                    self.label = self._labels[piece.trial]
                    self.note = f"trial {piece.trial + 1} of {len(self._labels)}"
                yield piece
            if not self._loops:
                return

    def _stored(self, block: int) -> Iterator[Arrived]:
        return sources.recorded(Path(self.name), len(self.taxels), block, self._ordered, self.taxels)


class ByHand(Paced):
    """A simulated finger: one touch after the other with the current controls; a change starts a new touch."""

    kind = "finger"

    def __init__(self, name: str, simulator: Simulator, changes: Mapping[str, Any], speed: float) -> None:
        if simulator.by_hand is None:
            raise InputError(f"`source={name!r}`: this simulator has no finger to control; choose gratings")
        self.name, self.speed = name, speed
        self._finger, self._spec = simulator.by_hand, simulator.build(changes, f"live {name}")
        self.values = self._finger.checked(self._spec, {})
        first = self._touch(0)
        self.sampling_rate_Hz, self.unit, self.taxels = first.sampling_rate_Hz, first.unit, first.channels
        self.label: str | None = None
        self.note = ""

    @property
    def controls(self) -> tuple[Control, ...]:
        return self._finger.controls(self._spec)

    def move(self, values: Mapping[str, Any]) -> None:
        """Set controls; InputError for an unknown control or an invalid value."""
        self.values = self._finger.checked(self._spec, {**self.values, **values})

    def _touch(self, number: int) -> Any:
        return self._finger.touch(self._spec, self.values, number)

    def pieces(self, faults: Faults) -> Iterator[Arrived]:
        number = 0
        while True:
            values, touch = self.values, self._touch(number)
            self.label, self.note = str(touch.conditions[LABEL].iloc[0]), f"touch {number + 1}"
            for piece in self._at_its_rate(iter((Arrived(touch.signals[0]),)), faults):
                if self.values is not values:
                    break
                yield piece
            yield Arrived(end=True)
            yield from sources.waiting(LIFTED_S / self.speed, TICK_S)
            number += 1


class Device:
    """A pipe, a device file, a file of rows or a serial port, read as data arrives; the page may set the label."""

    kind = "device"

    def __init__(
        self, path: str, samples: SampleSpec, taxels: tuple[str, ...], sampling_rate_Hz: float, unit: str
    ) -> None:
        self.name, self.taxels, self.sampling_rate_Hz, self.unit = path, taxels, sampling_rate_Hz, unit

        def opened(faults: Faults) -> Iterator[Arrived]:
            parser = sources.parser_of(samples, path, len(taxels), sampling_rate_Hz, faults, taxels)
            return sources.live(path, parser, faults, samples.stall_s, tick_s=TICK_S, baud=samples.baud)

        self._open = opened
        sources.parser_of(samples, path, len(taxels), sampling_rate_Hz, Faults())  # refuse wrong digits now
        self.label: str | None = None
        self.note = ""

    def pieces(self, faults: Faults) -> Iterator[Arrived]:
        return self._open(faults)
