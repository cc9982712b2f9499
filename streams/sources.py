"""Sources of samples: a pipe, a device, a table or a file of recordings, as blocks and with counts of errors.

A pipe is read as data arrive: samples that a chain does not read in time wait in the pipe, and then the writer waits.
Rows that are not samples (too few values, text, a time that does not advance) are counted, and each is one missing
sample.
"""

import os
import re
import select
import socket
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from decimal import Decimal
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from neurotact_parts.streams import lab_streaming
from neurotact_parts.streams.events import LEFT_OUT, Channels, EventClock, Moment, Origin
from neurotact_parts.streams.lab_streaming import LSL
from neurotact_parts.streams.stamped_rows import Faults, Placed, StampedRows
from neurotact_parts.streams.stream import Decision, Stream
from neurotact_parts.streams.stream_state import Tally
from neurotact_parts.streams.streamed import SampleSpec

from neurotact.data import hdf5
from neurotact.data.readers.clock.units import UNIT_S, Unit, unit_in, without_unit
from neurotact.data.readers.columns import called
from neurotact.data.readers.formats.contents import content_of_bytes
from neurotact.data.readers.table.cells import (
    COMMAS,
    COMMENT,
    FLOAT32_MAX,
    NOT_FINITE,
    NUMBER,
    cells,
    has_decimal_commas,
)
from neurotact.data.readers.table.headings import SEPARATOR_LINE, is_unit, separator_of
from neurotact.data.recordings import order_by_name
from neurotact.errors import InputError, number_of, optional
from neurotact.progress import say

READ_BYTES = 1 << 16
LONGEST_ROW = 1 << 20
DATAGRAM_BYTES = 1 << 20
"""Of datagrams that wait until they are read."""
SERIAL, TCP, UDP = "serial:", "tcp:", "udp:"
"""Prefixes of the device of a serial port; of the address of a server, as in tcp:localhost:5000; of a port for
datagrams, on this machine or, as in udp:0.0.0.0:9000, of another address."""
LATE_S = 0.01
"""A block is late if its delay exceeds this and its own duration."""
HOPELESS_S = 0.5
"""A replay with a longer delay does not catch up, but continues at its rate."""
LONGEST_WAIT_S = 3600.0
"""Of one call of the system, which takes no longer times than some 68 years."""
MARK = "\ufeff"
"""The byte-order mark that some programs write before UTF-8 text."""
SEPARATOR = re.compile(r"\s*[,;\t]\s*|\s+")


class Arrived(NamedTuple):
    """A block of samples `(sample, taxel)` float32, a number of missing ones, a stall, the end of a trial, or nothing.

    stalled: an unknown number of samples is missing: none came for long, or the clock of their stamps started again.
    trial: number of the trial in its file; None if the source is not a file of recordings.
    events: of a sensor that sends them, in place of samples.
    """

    samples: np.ndarray | None = None
    missing: int = 0
    stalled: bool = False
    end: bool = False
    trial: int | None = None
    events: "Events | None" = None


class Events(NamedTuple):
    """Events of a sensor: of each its time in s, and the number of its afferent, or why it has none."""

    time_s: list[float]
    units: list[int]


class Lines:
    """Bytes to lines of text, without blank ones and comments.

    joins: the source was already running; text before the first end of a line may be incomplete, and is ignored.
    """

    def __init__(self, where: str, faults: Faults, *, joins: bool = False) -> None:
        self.where, self.faults, self.joins = where, faults, joins
        self.left, self.line, self.has_names = b"", 0, False
        self.n_good, self.has_commas = 0, False

    def lines(self, text: bytes) -> Iterator[str]:
        """The lines that these bytes complete."""
        if not self.line and not self.left and not self.joins:
            _check_begins_as_text(text, self.where)
        if self.joins:
            _, ended, text = text.partition(b"\n")
            self.joins = not ended
        *lines, self.left = (self.left + text).split(b"\n")
        if len(self.left) > LONGEST_ROW:
            raise InputError(
                f"{self.where}: line {self.line + 1} does not end within {LONGEST_ROW:,} bytes; give rows of text"
            )
        for whole in lines:
            self.line += 1
            line = whole.decode("utf-8", errors="replace").removeprefix(MARK if self.line == 1 else "").strip()
            if line and not COMMENT.match(line) and (self.has_names or not SEPARATOR_LINE.fullmatch(line)):
                yield line

    def split(self, text: str, n_cells: int | None = None) -> list[str]:
        """The cells of a line; commas that are surely decimal, as at import, become points, which is said once.

        n_cells: as many as there must be, if that is known.
        """
        row = _fitting(SEPARATOR.split(text.replace(",", ".") if self.has_commas else text), n_cells)
        if "," not in text or self.has_commas or (mark := separator_of(text)) == ",":
            return row
        own = _fitting(cells(text, mark), n_cells)
        self.has_commas = len(own) == (n_cells or len(own)) and has_decimal_commas([[cell] for cell in own], mark)
        if not self.has_commas:
            return row
        say(f"{self.where}: {COMMAS}")
        return self.split(text, n_cells)


def _fitting(row: list[str], n_cells: int | None) -> list[str]:
    """The cells of a row, as at import without the one that a separator at its end adds."""
    return row[:-1] if len(row) - 1 == n_cells and not row[-1] else row


class Rows(Lines):
    """Text to samples, one row each: values separated by commas, semicolons, tabs or spaces.

    time_unit_s: of a first column that contains the time, for instance 0.001; None without one. With it, lost and
    repeated rows are found, by the rule of `stamped_rows`.
    taxels: names of the taxels, in the order of the samples to give. A first line with these names in another order
        tells that of the columns; one with other names is refused. None: the columns are in order.
    joins: as of `Lines`.

    >>> rows = Rows("-", 2, 1000.0, Faults())
    >>> [arrived.samples.tolist() for arrived in rows.take(b"left,right\\n1,2\\n3,nan\\n")]
    [[[1.0, 2.0], [3.0, nan]]]
    """

    def __init__(
        self,
        where: str,
        n_taxels: int,
        rate_Hz: float,
        faults: Faults,
        time_unit_s: float | None = None,
        *,
        taxels: tuple[str, ...] | None = None,
        joins: bool = False,
    ) -> None:
        super().__init__(where, faults, joins=joins)
        self.n_taxels, self.taxels, self.order = n_taxels, taxels, None
        self.stamped = None if time_unit_s is None else StampedRows(where, rate_Hz, time_unit_s, faults)

    def take(self, text: bytes) -> Iterator[Arrived]:
        """The samples that these bytes complete."""
        yield from _blocks(placed for line in self.lines(text) for placed in self._row(line))

    def rest(self) -> Iterator[Arrived]:
        """When the source has ended: the samples that were held back because of their time stamps."""
        if self.stamped is not None:
            yield from _blocks(self.stamped.rest())

    def finish(self) -> None:
        """The source has ended: a row without its end may lack digits, and is ignored."""
        self.faults.cut_off += bool(self.left.strip())
        if not self.n_good:
            raise InputError(f"{self.where}: has no sample; give {self.n_taxels} values per row")

    def _row(self, text: str) -> Iterator[Placed]:
        """The rows that a line completes; a line that is not a sample stands for a missing one."""
        expected = self.n_taxels + (self.stamped is not None)
        row = self.split(text, expected)
        values = [_value(cell) for cell in row]
        numbers = [value for value in values if value is not None]
        if len(row) == len(numbers) == expected:
            self.n_good += 1
            signal = numbers if self.stamped is None else numbers[1:]
            if self.order is not None:
                signal = [signal[index] for index in self.order]
            if self.stamped is None:
                yield Placed(signal)
            else:
                yield from self.stamped.take(numbers[0], signal)
            return
        if not self.n_good:
            is_first, self.has_names = not self.has_names, True
            if is_first and not any(map(NUMBER.fullmatch, row)):
                self._take_names([cell.strip("\"'") for cell in row[expected - self.n_taxels :]])
                return
            if all(map(is_unit, row)):
                return  # below the names
            raise InputError(
                f"{self.where}: line {self.line} has {number_of(len(row), 'value')}, {text[:40]!r}, where "
                f"{number_of(expected, 'number')} should be; give one row per sample and one column per taxel"
            )
        self.faults.bad_rows += 1
        if self.stamped is None:  # else the next valid row shows how many were lost
            yield Placed(None, lost=1)

    def _take_names(self, names: list[str]) -> None:
        """The columns in the order of the chain's taxels, by name; a line of another length names no columns."""
        if len(names) == self.n_taxels and not all(map(is_unit, names)):
            self.order = order_by_name(names, self.taxels, f"{self.where}: line {self.line}")


def _check_begins_as_text(data: bytes, where: str) -> None:
    """Refuse a source that begins with something else than text of one byte per sign."""
    kind = content_of_bytes(data)
    if kind is not None:
        raise kind.refusal(where, "rows of text", "import it (neurotact import), and stream the file of recordings")
    if b"\0" in data[:READ_BYTES]:
        raise InputError(f"{where}: begins with zeros or UTF-16 text, not with rows of UTF-8 text; write UTF-8")


def _blocks(rows: Iterable[Placed]) -> Iterator[Arrived]:
    """Successive rows together, with what is missing between them."""
    block: list[list[float]] = []
    for row in rows:
        if block and (row.lost or row.restarts):
            yield Arrived(_samples(block))
            block = []
        if row.lost or row.restarts:
            yield Arrived(missing=row.lost, stalled=row.restarts)
        if row.values is not None:
            block.append(row.values)
    if block:
        yield Arrived(_samples(block))


def _samples(block: list[list[float]]) -> np.ndarray:
    with np.errstate(over="ignore"):  # a value beyond float32 is infinite, and counts as missing
        return np.array(block, np.float32)


class EventRows(Lines):
    """Text to events, one row each: time, channel and, where there is one, polarity; a time alone advances the clock.

    channels: of the network. unit: of the times; that of the column's name, as in `time_us`, or seconds when None.
    origin: as at import. Columns are in this order, or as a first line names them.

    >>> rows = EventRows("-", Channels(["a", "b"]), Faults())
    >>> [arrived.events for arrived in rows.take(b"time_ms,channel\\n1,a\\n2.5,1\\n4\\n")]
    [Events(time_s=[0.001, 0.0025, 0.004], units=[0, 1, -2])]
    """

    def __init__(
        self,
        where: str,
        channels: Channels,
        faults: Faults,
        unit: Unit | None = None,
        origin: Origin = "zero",
        *,
        joins: bool = False,
    ) -> None:
        super().__init__(where, faults, joins=joins)
        self.channels, self.from_first = channels, origin == "first"
        self.unit: Unit | None = unit
        self.places: list[int | None] = [0, 1, 2]
        self.clock: EventClock | None = None

    def take(self, text: bytes) -> Iterator[Arrived]:
        """The events that these bytes complete."""
        events = Events([], [])
        for line in self.lines(text):
            found = self._event(line)
            if found is None:
                continue
            placed, unit = found
            if placed.restarts:
                yield Arrived(events=events)
                yield Arrived(stalled=True)
                events = Events([], [])
            if placed.time_s is not None:
                events.time_s.append(placed.time_s)
                events.units.append(unit)
        if events.time_s:
            yield Arrived(events=events)

    def rest(self) -> Iterator[Arrived]:
        """No event is held back."""
        yield from ()

    def finish(self) -> None:
        """The source has ended: a row without its end may lack digits, and is ignored."""
        self.faults.cut_off += bool(self.left.strip())
        if not self.n_good:
            raise InputError(
                f"{self.where}: has no event; give rows of time, channel and, where there is one, polarity"
            )

    def _event(self, text: str) -> tuple[Moment, int] | None:
        row = [cell.strip("\"'") for cell in self.split(text)]
        if not self.n_good and not self.has_names and not NUMBER.fullmatch(row[0]):
            self.has_names = True
            self._take_names(row)
            return None
        time, channel, polarity = (row[i] if i is not None and i < len(row) else "" for i in self.places)
        if not NUMBER.fullmatch(time) or (len(row) > 1 and not channel) or len(row) > max(3, self.n_columns):
            self.faults.bad_rows += 1
            return None
        self.n_good += 1
        if self.clock is None:
            self.clock = EventClock(
                self.where, 1.0 if self.unit is None else UNIT_S[self.unit], self.from_first, self.faults
            )
        unit = self.channels.number(channel, polarity or None) if channel else LEFT_OUT
        return self.clock.at(Decimal(time)), unit

    n_columns = 3

    def _take_names(self, names: list[str]) -> None:
        """The columns of time, channel and polarity by their names, as at import."""
        plain = [without_unit(name.lower()) for name in names]
        found = {what: called(plain, f"event {what}") for what in ("time", "channel", "population")}
        if found["time"] is None or found["channel"] is None:
            raise InputError(
                f"{self.where}: line {self.line} names no column of time and channel ({', '.join(names)[:60]}); give "
                "rows of time, channel and, where there is one, polarity"
            )
        self.places = [None if name is None else plain.index(name) for name in found.values()]
        self.n_columns = len(names)
        self.unit = self.unit or unit_in(names[plain.index(found["time"])])


class Frames:
    """Bytes to samples: little-endian `float32` or `int16`, one value per taxel; an int16 x means `zero + lsb x`."""

    def __init__(
        self, where: str, n_taxels: int, kind: str, faults: Faults, lsb: float = 1.0, zero: float = 0.0
    ) -> None:
        self.where, self.n_taxels, self.faults, self.lsb, self.zero = where, n_taxels, faults, lsb, zero
        self.kind = np.dtype({"float32": "<f4", "int16": "<i2"}[kind])
        self.left, self.n_good = b"", 0

    def take(self, data: bytes) -> Iterator[Arrived]:
        """The samples that these bytes complete."""
        if not self.n_good and data and not self.left and _is_text(data):
            raise InputError(f"{self.where}: has text where {self.kind.name} frames are expected; pass `format='csv'`")
        data = self.left + data
        size = self.kind.itemsize * self.n_taxels
        whole = len(data) // size * size
        self.left = data[whole:]
        self.n_good += whole // size
        if whole:
            values = np.frombuffer(data[:whole], self.kind).reshape(-1, self.n_taxels)
            if self.kind.kind == "i":
                values = self.zero + self.lsb * values
            yield Arrived(values.astype(np.float32))

    def rest(self) -> Iterator[Arrived]:
        """No frame is held back."""
        yield from ()

    def finish(self) -> None:
        """The source has ended: an incomplete frame is ignored."""
        self.faults.cut_off += bool(self.left)
        if not self.n_good:
            raise InputError(f"{self.where}: has no sample; give frames of {self.n_taxels} {self.kind.name} values")


class Received(Frames):
    """Frames of float32 that a library receives. rate_Hz, taxels: what is expected of the stream."""

    def __init__(
        self, where: str, n_taxels: int, rate_Hz: float, faults: Faults, taxels: tuple[str, ...] | None = None
    ) -> None:
        super().__init__(where, n_taxels, "float32", faults)
        self.rate_Hz, self.taxels = rate_Hz, taxels


def _is_recorded(path: str) -> bool:
    """Whether a source is a file of recordings, by its name.

    >>> _is_recorded("touches.h5"), _is_recorded("-")
    (True, False)
    """
    return path.endswith((".h5", ".hdf5"))


def kind_of(path: str) -> str:
    """What a source is, by its name: recordings, a serial port, an LSL stream, a file, or a pipe (also a socket).

    >>> kind_of("touches.h5"), kind_of("-"), kind_of("serial:/dev/ttyUSB0"), kind_of("lsl:Skin"), kind_of("udp:9000")
    ('recordings', 'pipe', 'serial port', 'LSL stream', 'pipe')
    """
    if _is_recorded(path):
        return "recordings"
    if path.startswith(SERIAL):
        return "serial port"
    if path.startswith(LSL):
        return "LSL stream"
    if path.startswith(TCP):
        return "pipe"
    return "file" if os.path.isfile(path) else "pipe"


def trouble_of(tally: Tally, faults: Faults) -> str:
    """The errors in the samples, in words, of a stream and of its source; empty without errors."""
    return ", ".join(filter(None, (tally.trouble(), faults.trouble())))


def parser_of(
    samples: SampleSpec,
    where: str,
    n_taxels: int,
    rate_Hz: float,
    faults: Faults,
    taxels: tuple[str, ...] | None = None,
) -> Rows | Frames:
    """The parser of text or bytes, or of what a library receives. taxels: as for `Rows`.

    Raises InputError for digits of which a signal is not finite.
    """
    if not abs(samples.lsb) * 2**15 + abs(samples.zero) <= FLOAT32_MAX:
        raise InputError(
            f"`lsb={samples.lsb:g}`, `zero={samples.zero:g}`: zero + lsb * x is beyond float32; give smaller numbers"
        )
    if where.startswith(LSL):
        return Received(where, n_taxels, rate_Hz, faults, taxels)
    if samples.format != "csv":
        return Frames(where, n_taxels, samples.format, faults, samples.lsb, samples.zero)
    unit_s = None if samples.time_column is None else UNIT_S[samples.time_column]
    return Rows(where, n_taxels, rate_Hz, faults, unit_s, taxels=taxels, joins=where.startswith(SERIAL))


def live(
    path: str,
    parser: Rows | Frames | EventRows,
    faults: Faults,
    stall_s: float,
    *,
    tick_s: float | None = None,
    baud: int = SampleSpec().baud,
) -> Iterator[Arrived]:
    """A pipe, a device file or a file, read as data arrive; `-` is standard input, `serial:/dev/...` a serial port,
    `tcp:HOST:PORT` a server, `udp:PORT` a port for datagrams, `lsl:NAME` a stream of the Lab Streaming Layer.

    stall_s: seconds without a byte after which the source stalls; later samples follow a gap of unknown length.
    tick_s: after this time without data, `Arrived()` is yielded, so that the caller can do other work.
    baud: of a serial port.
    """
    if not stall_s > 0:
        raise InputError(f"stall_s: must be a time above 0 s; got {stall_s:g}")
    with _receiving(path, parser, faults, baud) as receive:
        is_stalled, received_s = False, time.monotonic()
        while True:
            left_s = None if is_stalled else max(0.0, received_s + stall_s - time.monotonic())
            wait_s = min(limit_s for limit_s in (left_s, tick_s, LONGEST_WAIT_S) if limit_s is not None)
            data = receive(wait_s)
            if data is None:
                stalls = not is_stalled and time.monotonic() - received_s >= stall_s
                is_stalled |= stalls
                faults.stalls += stalls
                if stalls or tick_s is not None:
                    yield Arrived(stalled=stalls)
                continue
            is_stalled, received_s = False, time.monotonic()
            if not data:
                break
            yield from parser.take(data)
    yield from parser.rest()
    parser.finish()
    yield Arrived(end=True)


def recorded(
    path: Path,
    n_taxels: int,
    block: int,
    ordered: Callable[[int], Iterable[int]] = range,
    taxels: tuple[str, ...] | None = None,
) -> Iterator[Arrived]:
    """The trials of an HDF5 file of recordings, one after the other.

    ordered: their order, from how many there are. taxels: names, in the order of the samples to give; None: as stored.
    """
    with hdf5.open_recordings(path) as stored:
        if stored.n_channels != n_taxels:
            raise InputError(
                f"{path}: has {stored.n_channels} taxels but the chain receives {n_taxels}; record with the same taxels"
            )
        stored = stored.in_order(taxels)
        lengths = stored.lengths.tolist()
        for trial in ordered(len(lengths)):
            length = lengths[trial]
            for start in range(0, length, block):
                yield Arrived(stored.piece(trial, start, min(start + block, length)), trial=trial)
            yield Arrived(end=True, trial=trial)


def at_its_rate(
    source: Iterator[Arrived],
    rate_Hz: float,
    faults: Faults,
    block: int,
    *,
    speed: Callable[[], float] = lambda: 1.0,
    tick_s: float | None = None,
) -> Iterator[Arrived]:
    """A source replayed at its own rate: a block is yielded at the time at which its last sample would be recorded.

    speed: called before each block; 2 replays it twice as fast.
    tick_s: interval at which `Arrived()` is yielded before a block is due, so that the caller can do other work.
    """
    due = time.monotonic()
    for arrived in source:
        parts = [arrived]
        if arrived.samples is not None:
            samples = arrived.samples
            parts = [arrived._replace(samples=samples[i : i + block]) for i in range(0, len(samples), block)]
        for part in parts:
            lasts_s = (part.missing if part.samples is None else len(part.samples)) / (rate_Hz * speed())
            due += lasts_s
            yield from waiting(due - time.monotonic(), tick_s)
            late_s = time.monotonic() - due
            if late_s > max(LATE_S, lasts_s):
                faults.late_blocks += 1
                faults.late_ms = max(faults.late_ms, 1e3 * late_s)
            if late_s > HOPELESS_S:
                due = time.monotonic()
            yield part


def waiting(wait_s: float, tick_s: float | None) -> Iterator[Arrived]:
    """Wait for `wait_s`, and yield an empty `Arrived()` every `tick_s`."""
    due = time.monotonic() + wait_s
    while (left_s := due - time.monotonic()) > 0:
        time.sleep(left_s if tick_s is None else min(left_s, tick_s))
        if tick_s is not None and time.monotonic() < due:
            yield Arrived()


def decide(stream: Stream, source: Iterable[Arrived]) -> Iterator[Decision]:
    """The decisions of a source."""
    for arrived in source:
        if arrived.samples is not None:
            yield from stream.push(arrived.samples)
        if arrived.missing:
            yield from stream.missing(arrived.missing)
        if arrived.stalled:
            stream.gap()
        if arrived.events is not None:
            yield from stream.push_numbered(*arrived.events)
        if arrived.end:
            yield from stream.flush() if stream.chain.takes_events else ()
            yield from stream.finish()


@contextmanager
def _receiving(path: str, parser: Any, faults: Faults, baud: int) -> Iterator[Callable[[float], bytes | None]]:
    """A function that waits for so many seconds at most: what arrived, None if nothing did, no bytes at the end."""
    if path.startswith(LSL):
        if not isinstance(parser, Received):
            raise InputError(f"{path}: sends samples, not rows of text; give a source of these, such as udp:9000")
        with lab_streaming.inlet(path, parser.n_taxels, parser.rate_Hz, parser.taxels) as received:
            yield received
        return
    with _opened(path, baud) as descriptor:

        def receive(wait_s: float) -> bytes | None:
            if not select.select([descriptor], [], [], wait_s)[0]:
                return None
            data = _read(path, descriptor)
            return _of_datagram(data, parser, faults) if path.startswith(UDP) else data

        yield receive


def _of_datagram(data: bytes, parser: Any, faults: Faults) -> bytes | None:
    """Whole rows or frames: what one datagram lacks is not in the next. An empty datagram ends the source."""
    if not isinstance(parser, Frames):
        return data + b"\n" if data else data
    n_over = len(data) % (parser.kind.itemsize * parser.n_taxels)
    faults.bad_rows += bool(n_over)
    return None if data and len(data) == n_over else data[: len(data) - n_over]


@contextmanager
def _opened(path: str, baud: int) -> Iterator[int]:
    if path == "-":
        yield sys.stdin.fileno()
        return
    if path.startswith(SERIAL):
        with _serial_port(path, baud) as port:
            yield port.fileno()
        return
    if path.startswith(UDP):
        with _datagram_port(path) as port:
            yield port.fileno()
        return
    if path.startswith(TCP):
        with _connection(path) as connection:
            yield connection.fileno()
        return
    try:
        descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NOCTTY", 0))
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); check the path") from error
    try:
        yield descriptor
    finally:
        os.close(descriptor)


def _datagram_port(path: str) -> socket.socket:
    host, _, number = path.removeprefix(UDP).rpartition(":")
    if not (number.isdecimal() and number.isascii() and int(number) < 2**16):
        raise InputError(f"{path}: is no port for datagrams; give its number, as in udp:9000")
    port = socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET, socket.SOCK_DGRAM)
    try:
        port.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, DATAGRAM_BYTES)
        port.bind((host.strip("[]") or "127.0.0.1", int(number)))
    except OSError as error:
        port.close()
        raise InputError(f"{path}: cannot be opened ({error.strerror or error}); give another port") from error
    return port


def _connection(path: str) -> socket.socket:
    host, _, port = path.removeprefix(TCP).rpartition(":")
    if not (host and port.isdecimal() and port.isascii() and int(port) < 2**16):
        raise InputError(f"{path}: is no address; give a host and a port, as in tcp:localhost:5000")
    try:
        return socket.create_connection((host.strip("[]"), int(port)))
    except OSError as error:
        raise InputError(
            f"{path}: cannot be reached ({error.strerror or error}); check the server and its port"
        ) from error


def _serial_port(path: str, baud: int) -> Any:
    """An open serial port in raw mode and exclusive use; data that arrived before are dropped."""
    serial = optional("serial", f"{path}: needs pyserial; pip install 'neurotact[serial]'")
    try:
        port = serial.Serial(path.removeprefix(SERIAL), baud, exclusive=True)
        port.reset_input_buffer()
    except (serial.SerialException, OSError, ValueError) as error:
        number = getattr(error, "errno", None)
        reason = error if number is None else os.strerror(number)
        raise InputError(f"{path}: cannot be read ({reason}); check the port, its rights and `baud`") from error
    return port


def _read(path: str, descriptor: int) -> bytes:
    try:
        return os.read(descriptor, READ_BYTES)
    except OSError as error:
        raise InputError(f"{path}: was lost ({error.strerror}); reconnect it and start again") from error


def _value(cell: str) -> float | None:
    """The number in a cell; NaN if it is empty or not finite; None if it contains other text."""
    if NUMBER.fullmatch(cell):
        return float(cell)
    return float("nan") if not cell or NOT_FINITE.fullmatch(cell) else None


def _is_text(data: bytes) -> bool:
    return not data[:4096].translate(None, b"0123456789+-.,;eEnaNiInfF\t\r\n ")
