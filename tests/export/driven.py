"""Chains in C that are driven record by record: missing values, gaps, counters at their ends; and a stream beside."""

import struct
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from neurotact_parts.exporters.c import c_export, proof
from neurotact_parts.exporters.c.boards import Board
from neurotact_parts.exporters.c.formats import Formats
from neurotact_parts.streams.chain import Chain
from neurotact_parts.streams.stream import Stream
from neurotact_parts.streams.stream_state import Decision, StreamState, Tally, Trace

DRIVER = Path(__file__).parent / "driver.c"
RECORDS = Path(__file__).parent / "records.h"
COUNTED = ("samples", "held", "missing", "gaps", "skipped", "dropped", "decisions")
"""The counts of C, in its order."""
TYPES = {"AFFERENT": "afferent_type", "NEURON": "neuron_type"}
"""Macros of the driver, and the types of a context that they stand for."""
Do = tuple[str, Any]
"""push and a sample; age and a `StreamState`; counts and seven; bad and one; missing, gap, reset, finish, tally."""


def write_program(folder: Path, source: str) -> None:
    """Write a program that reads records, as the harness of an export."""
    (folder / "harness.c").write_text(source)
    (folder / RECORDS.name).write_text(RECORDS.read_text())


class Told(NamedTuple):
    """What a chain says: a checksum of the afferents of each step, its decisions, and its counts at each `tally`."""

    steps: list[int]
    decisions: list[tuple[int, ...]]
    counts: list[tuple[int, ...]]


class Driven:
    """An export, compiled with the driver."""

    def __init__(
        self, chain: Chain, formats: Formats | None, folder: Path, board: Board | None = None,
        flags: Sequence[str] = proof.SANITIZERS,
    ) -> None:  # fmt: skip
        """board: an emulated one; None: this machine, with these flags."""
        self.chain, self.formats, self.board = chain, formats, board
        folder.mkdir(exist_ok=True, parents=True)
        c_export.write(chain, folder, formats, name="skin", parts=c_export.HARNESS)
        context = c_export.context_of(chain, formats, "skin")
        self.has_position = context["resampled"] and formats is None
        self.has_felt = context["exact"] and not context["resampled"] and formats is None
        self.averages = context["baseline"] == "start"
        defines = [f"#define {key} {context[value]}" for key, value in TYPES.items()]
        defines += ["#define HEARD"] * self.averages + ["#define POSITION"] * self.has_position
        defines += ["#define FELT"] * self.has_felt
        defines += ["#define FINISHES"] * context["finishes"]
        write_program(folder, "\n".join([*defines, DRIVER.read_text()]))
        if board is None:
            self.program = proof.built_here(folder, "skin", flags=flags)
        else:
            self.program = proof.build(folder, "skin", board, watched=True)

    def run(self, records: Iterable[Do]) -> Told:
        data = b"".join(self._record(*each) for each in records) + b"E"
        output = proof.run(self.program, data) if self.board is None else proof.emulate(self.program, data, self.board)
        told, at = Told([], [], []), 0
        while at < len(output):
            tag, at = output[at : at + 1], at + 1
            form = {b"S": "<2I", b"D": "<8I", b"T": "<7I"}[tag]
            row = struct.unpack_from(form, output, at)
            at += struct.calcsize(form)
            if tag == b"S":
                told.steps.append(row[0] + (row[1] << 32))
            else:
                (told.decisions if tag == b"D" else told.counts).append(row)
        return told

    def _record(self, what: str, given: Any) -> bytes:
        letter = {"finish": b"F", "missing": b"M", "gap": b"G", "reset": b"R", "age": b"A", "tally": b"T"}
        if what == "push":
            return b"P" + np.asarray(given, np.int16 if self.formats else np.float32).tobytes()
        if what in ("counts", "bad"):
            numbers = given if what == "counts" else [given]
            return what[0].upper().encode() + struct.pack(f"<{len(numbers)}I", *numbers)
        return letter[what] + (self._aged(given) if what == "age" else b"")

    def _aged(self, state: StreamState) -> bytes:
        done = state.conditioned
        parts = [struct.pack("<2I", state.opening.step % 2**32, state.n_windows % 2**32)]
        if self.averages:
            assert done.carried is not None
            total, n = done.carried
            parts.append(struct.pack("<I", n))
            parts.append(np.asarray(total, np.int64 if self.formats else np.float64).tobytes())
        if self.has_position:
            parts.append(struct.pack("<2d", done.n_samples, done.n_steps))
        if self.has_felt:
            parts.append(struct.pack("<d", done.n_samples))
        return b"".join(parts)


def streamed(chain: Chain, records: Sequence[Do], backend: Any = "auto") -> Told:
    """What a stream says to the same records."""
    told = Told([], [], [])

    def watch(trace: Trace) -> None:
        told.steps.extend(checksum(np.flatnonzero(row)) for row in trace.afferents)

    stream = Stream(chain, backend=backend, watch=watch)
    before = dict.fromkeys(COUNTED, 0)
    for what, given in records:
        decisions: list[Decision] = []
        if what == "push":
            decisions = stream.push(np.asarray(given, np.float32)[None])
        elif what == "missing":
            decisions = stream.missing(1)
        elif what == "finish":
            decisions = stream.finish()
        elif what == "gap":
            stream.gap()
        elif what == "reset":
            stream.reset()
            before = dict.fromkeys(COUNTED, 0)
        elif what == "age":
            stream.restore(replace(given, tally=stream.tally))
        elif what == "counts":
            before = {key: n - getattr(stream.tally, key) for key, n in zip(COUNTED, given, strict=True)}
        else:
            told.counts.append(counted(stream.tally, before))
        told.decisions.extend(row_of(each) for each in sorted(decisions, key=lambda each: each.window))
    return told


def counted(tally: Tally, before: dict[str, int]) -> tuple[int, ...]:
    """The counts of a stream, added to earlier ones, as they end at 2^32 - 1."""
    return tuple(min(before[key] + getattr(tally, key), 2**32 - 1) for key in COUNTED)


def row_of(decision: Decision) -> tuple[int, ...]:
    """A decision as C writes it: numbers of 32 bits."""
    d = decision
    numbers = (d.window, d.start_step, d.steps, d.input_spikes, d.hidden_spikes, d.held, int(d.heard), d.index)
    return tuple(number % 2**32 for number in numbers)


def checksum(numbers: Iterable[int]) -> int:
    """Of the afferents of a step, as the driver computes it."""
    total, n = 0, 0
    for number in numbers:
        total, n = (31 * total + int(number) + 1) % 2**32, n + 1
    return n + (total << 32)
