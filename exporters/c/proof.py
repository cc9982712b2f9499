"""Proof of an export: compiled here and for a Cortex-M, run, and compared with its twin spike by spike.

QEMU emulates the processor. It also counts instructions: with `-icount`, its clock advances by a fixed time for each.
If a tool is not installed, the step is skipped, and the reason names the tool.
"""

import re
import shutil
import struct
import subprocess
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from neurotact_parts.exporters.c import boards
from neurotact_parts.exporters.c.boards import Board

from neurotact import files
from neurotact.errors import InputError

WARNINGS = ("-std=c99", "-Wall", "-Wextra", "-Wconversion", "-pedantic", "-Werror")
SANITIZERS = (
    "-O1", "-g", "-fsanitize=address,undefined,float-cast-overflow,float-divide-by-zero", "-fno-sanitize-recover=all",
)  # fmt: skip
LONGEST_S = 600


class Spoken(NamedTuple):
    """The output of a chain for one trial.

    afferents: numbers of the afferents that spiked, one tuple per step. hidden: the same for the hidden neurons of each
    window. decisions: window, start step, steps, input spikes, hidden spikes, of a pruned network synaptic operations,
    whether the readout changed, and label, in the order of windows; where numbers are told, then their values.
    runs_on: of a detector, whose decisions are changes of the label in force, and which has no window but number 0.
    """

    afferents: list[tuple[int, ...]]
    hidden: dict[int, list[tuple[int, ...]]]
    decisions: list[tuple[int, ...]]
    runs_on: bool = False


class Ticks(NamedTuple):
    """The ticks of every sample, `(sample,)` of each trial."""

    of: list[np.ndarray]

    @property
    def samples(self) -> int:
        return sum(map(len, self.of))

    @property
    def most(self) -> int:
        """The maximum of a sample."""
        return round(max(one.max(initial=0) for one in self.of))

    @property
    def total(self) -> int:
        return round(sum(one.sum() for one in self.of))


class Footprint(NamedTuple):
    """Bytes of the chain without start-up code: code and tables, state, and the sum of the stack frames."""

    flash: int
    ram: int
    stack: int


def missing(*tools: str) -> str | None:
    """Why a step cannot run: the tools that are not on the path; None if all are.

    >>> missing("a-compiler-of-nobody")
    'a-compiler-of-nobody is not installed'
    """
    absent = [tool for tool in tools if shutil.which(tool) is None]
    return f"{', '.join(absent)} is not installed" if absent else None


def on_host(folder: Path, name: str, trials: Sequence[np.ndarray], *, flags: Sequence[str] = ("-O2",)) -> list[Spoken]:
    """Compile the export in `folder` with the host's C compiler and run trials `(sample, taxel)` through it."""
    output = run(built_here(folder, name, flags=flags), _packed(trials))
    return _parsed(output, name, folder)[0]


def built_here(folder: Path, name: str, *, flags: Sequence[str]) -> Path:
    """Compile a program for this machine."""
    program = folder / "harness"
    _call(
        ["cc", *WARNINGS, *flags, *_watched(name), f"{name}.c", "harness.c", str(boards.HOST), "-o", str(program)],
        folder,
    )
    return program


def run(program: Path, data: bytes) -> bytes:
    """The output of a program on this machine."""
    return _call([str(program)], program.parent, data=data)


def on_board(
    folder: Path, name: str, trials: Sequence[np.ndarray], board: Board, *, counting: bool = False
) -> tuple[list[Spoken], Ticks]:
    """Compile the export for a board and run trials on QEMU's emulation of it.

    counting: without recording spikes, and with a clock that counts instructions; ticks are then instructions.
    """
    image = build(folder, name, board, watched=not counting)
    outputs, ticks = _parsed(emulate(image, _packed(trials), board, counting=counting), name, folder)
    if counting:
        scale = 1e9 / board.clock_Hz / 2**board.shift
        ticks = Ticks([one * scale for one in ticks.of])
    return outputs, ticks


def emulate(image: Path, data: bytes, board: Board, *, counting: bool = False) -> bytes:
    """The output of an image on QEMU's emulation of a board."""
    folder = image.parent
    with files.whole(folder / "input.bin") as draft:
        draft.write_bytes(data)
    counted = ["-icount", f"shift={board.shift}"] if counting else []
    _call(
        ["qemu-system-arm", "-M", board.machine, "-nographic", "-monitor", "none", "-serial", "none", *counted,
         "-semihosting-config", "enable=on,target=native", "-kernel", image.name], folder,
    )  # fmt: skip
    return (folder / "output.bin").read_bytes()


def build(folder: Path, name: str, board: Board, *, watched: bool) -> Path:
    """Compile an image for a board."""
    image = folder / f"{board.machine}.elf"
    _call(
        ["arm-none-eabi-gcc", *WARNINGS[:-1], *board.flags, "-O2", "-ffreestanding", "-nostdlib",
         "-T", str(boards.SCRIPT), f"-Wl,--defsym=FLASH_SIZE={board.flash},--defsym=RAM_SIZE={board.ram}",
         f"-Wl,-Map={board.machine}.map", *(_watched(name) if watched else ()),
         f"{name}.c", "harness.c", str(boards.CORTEX_M), "-lgcc", "-o", image.name],
        folder,
    )  # fmt: skip
    return image


def footprint(folder: Path, name: str, board: Board, *, optimise: str = "-Os") -> Footprint:
    """Memory of the chain on a processor: sections of its object, with the functions of the compiler's library."""
    chain, whole = folder / f"{name}.o", folder / f"{name}-whole.o"
    flags = [*WARNINGS, *board.flags, optimise, "-ffreestanding"]
    _call(["arm-none-eabi-gcc", *flags, "-fstack-usage", "-c", f"{name}.c", "-o", chain.name], folder)
    takes_events = f"{name}_advance(" in (folder / f"{name}.h").read_text()
    entries = [f"{name}_event", f"{name}_advance"] if takes_events else [f"{name}_push"]
    kept = ",".join(f"-u,{entry}" for entry in (*entries, f"{name}_reset", "state"))
    roots = [f"-Wl,{kept},-e,{entries[0]}", "-Wl,--gc-sections"]
    stub = folder / "stub.c"
    files.write_text(
        stub,
        f'#include "{name}.h"\n{name}_chain state;\n'
        "void *memcpy(void *to, const void *from, unsigned int n);\n"
        "void *memset(void *to, int value, unsigned int n);\n"
        "void *memcpy(void *to, const void *from, unsigned int n)\n{ (void)from; (void)n; return to; }\n"
        "void *memset(void *to, int value, unsigned int n)\n{ (void)value; (void)n; return to; }\n",
    )
    _call(
        [
            "arm-none-eabi-gcc",
            *flags[:-1],
            "-fno-builtin",
            "-nostdlib",
            *roots,
            chain.name,
            "stub.c",
            "-lgcc",
            "-o",
            whole.name,
        ],
        folder,
    )
    sizes = _call(["arm-none-eabi-size", whole.name], folder).decode().splitlines()[1].split()
    frames = [int(line.split("\t")[1]) for line in (folder / f"{name}.su").read_text().splitlines()]
    return Footprint(int(sizes[0]) + int(sizes[1]), int(sizes[1]) + int(sizes[2]), sum(frames))


def first_difference(said: Sequence[Spoken], expected: Sequence[Spoken]) -> str | None:
    """Where two chains first differ: trial, step and neuron; None if every spike and decision is equal."""
    if len(said) != len(expected):
        return f"{len(said)} trials where {len(expected)} are expected"
    for trial, (one, other) in enumerate(zip(said, expected, strict=True)):
        difference = _first(one.afferents, other.afferents)
        if difference:
            return f"trial {trial}, afferents, {difference}"
        for window in sorted({*one.hidden, *other.hidden}):
            difference = _first(one.hidden.get(window, []), other.hidden.get(window, []))
            if difference:
                return f"trial {trial}, window {window}, hidden neurons, {difference}"
        for mine, theirs in zip(one.decisions, other.decisions, strict=False):
            if mine != theirs:
                return f"trial {trial}, decision {mine} where {theirs} is expected"
        if len(one.decisions) != len(other.decisions):
            return f"trial {trial}: {len(one.decisions)} decisions where {len(other.decisions)} are expected"
    return None


def _first(one: list[tuple[int, ...]], other: list[tuple[int, ...]]) -> str | None:
    if one == other:
        return None
    for step, (mine, theirs) in enumerate(zip(one, other, strict=False)):
        if mine != theirs:
            return f"step {step}: {mine} where {theirs} is expected"
    return f"{len(one)} steps where {len(other)} are expected"


def _watched(name: str) -> list[str]:
    return [f"-D{name.upper()}_ON_SPIKES={name}_on_spikes", f"-D{name.upper()}_ON_HIDDEN={name}_on_hidden"]


def _packed(trials: Sequence[np.ndarray]) -> bytes:
    parts = [struct.pack("<I", len(trials))]
    for trial in trials:
        if trial.dtype not in (np.int16, np.float32, np.uint32):
            raise InputError(f"trials: must be int16 or float32, or uint32 of events; got {trial.dtype}")
        parts += [struct.pack("<I", len(trial)), np.ascontiguousarray(trial).tobytes()]
    return b"".join(parts)


def _parsed(output: bytes, name: str, folder: Path) -> tuple[list[Spoken], Ticks]:
    afferent, neuron = (_size_of(kind, name, folder) for kind in ("afferents", "neurons"))
    row = struct.Struct(("<8I" if _counts_sops(name, folder) else "<7I") + _values(name, folder))
    trials, offset = [], 0
    ticks: list[list[int]] = [[]]
    afferents: list[tuple[int, ...]] = []
    hidden: dict[int, list[tuple[int, ...]]] = {}
    decisions: list[tuple[int, ...]] = []
    while offset < len(output):
        tag, offset = output[offset : offset + 1], offset + 1
        if tag == b"S":
            numbers, offset = _numbers(output, offset, afferent)
            afferents.append(numbers)
        elif tag == b"H":
            window = int.from_bytes(output[offset : offset + 4], "little")
            numbers, offset = _numbers(output, offset + 4, neuron)
            hidden.setdefault(window, []).append(numbers)
        elif tag == b"D":
            decisions.append(row.unpack_from(output, offset))
            offset += row.size
        elif tag == b"E":
            trials.append(Spoken(afferents, hidden, sorted(decisions)))
            afferents, hidden, decisions = [], {}, []
            ticks.append([])
        elif tag == b"K":
            ticks[-1].append(int.from_bytes(output[offset : offset + 4], "little"))
            offset += 4
        elif tag == b"T":
            return trials, Ticks([np.array(one) for one in ticks[:-1]])
        else:
            break
    raise InputError(f"{folder}: the harness stopped in the middle; compile and run it by hand")


def _numbers(output: bytes, offset: int, size: int) -> tuple[tuple[int, ...], int]:
    n = int.from_bytes(output[offset : offset + 4], "little")
    end = offset + 4 + n * size
    return tuple(np.frombuffer(output[offset + 4 : end], f"<u{size}").tolist()), end


def _size_of(what: str, name: str, folder: Path) -> int:
    """Bytes of a neuron's number, from the header; 1 where it has no neurons."""
    header = (folder / f"{name}.h").read_text()
    kinds = ((1, "uint8_t"), (2, "uint16_t"), (4, "uint32_t"))
    return next((size for size, kind in kinds if f"const {kind} *{what}," in header), 1)


def _counts_sops(name: str, folder: Path) -> bool:
    """Whether a decision has its synaptic operations, by the header: that of a pruned network."""
    return "uint32_t sops;" in (folder / f"{name}.h").read_text()


def _values(name: str, folder: Path) -> str:
    """The format of the numbers that a decision tells, by the header; empty where it tells a class."""
    header = (folder / f"{name}.h").read_text()
    kind = re.search(r"(double|int32_t) values\[", header)
    n = re.search(r"_CLASSES (\d+)", header)
    return f"{n[1]}{'d' if kind[1] == 'double' else 'i'}" if kind and n else ""


def _call(command: list[str], folder: Path, data: bytes = b"") -> bytes:
    try:
        done = subprocess.run(command, cwd=folder, input=data, capture_output=True, timeout=LONGEST_S, check=False)
    except subprocess.TimeoutExpired as error:
        raise InputError(f"{command[0]}: ran for more than {LONGEST_S} s; use fewer trials") from error
    if done.returncode:
        last = done.stderr.decode(errors="replace").strip().splitlines() or ["no message"]
        raise InputError(f"{command[0]}: failed with code {done.returncode}: {last[0][:300]}")
    return done.stdout


def fired_in(raster: np.ndarray) -> list[tuple[int, ...]]:
    """The numbers of the neurons that spike in each step of `(step, neuron)`."""
    return [tuple(np.flatnonzero(row).tolist()) for row in raster]


def spoken_of(
    rasters: np.ndarray, starts: np.ndarray, hidden: np.ndarray, decided: np.ndarray, steps_per_bin: int = 1,
    values: np.ndarray | None = None,
) -> Spoken:  # fmt: skip
    """The output of a twin for a trial, in the format of a chain in C.

    rasters: afferents `(step, afferent)`; starts: of windows; hidden: `(window, bin, hidden)`; decided: label, steps,
    input spikes, hidden spikes, of a pruned network operations, and whether the readout changed, of each window.
    steps_per_bin: steps in a bin. values: numbers that are told, `(window, target)`.
    """
    told = np.empty((len(decided), 0)) if values is None else values
    rows = fired_in(rasters)
    windows = {}
    decisions = []
    each = zip(starts.tolist(), hidden, decided.tolist(), told.tolist(), strict=True)
    for window, (start, raster, row, numbers) in enumerate(each):
        label, steps, *counted = row
        windows[window] = fired_in(raster[: -(-steps // steps_per_bin)])
        decisions.append((window, start, steps, *counted, label, *numbers))
    return Spoken(rows, windows, decisions)


def cut_off(said: list[Spoken], expected: Sequence[Spoken]) -> Iterator[Spoken]:
    """The output without the windows that the trial's end cuts off, which twins do not have."""
    for one, other in zip(said, expected, strict=True):
        if other.runs_on:
            yield one
            continue
        n = len(other.decisions)
        hidden = {window: steps for window, steps in one.hidden.items() if window < n}
        yield Spoken(one.afferents, hidden, [row for row in one.decisions if row[0] < n])
