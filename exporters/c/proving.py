"""The proof of an export on the test trials of its run: equality, accuracy, bytes, instructions, time and energy."""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from neurotact_parts.exporters.c import boards, c_export, export, proof, twin
from neurotact_parts.exporters.c.boards import Board
from neurotact_parts.exporters.c.formats import Formats
from neurotact_parts.exporters.c.proof import Spoken

from neurotact import files
from neurotact.data.recordings import Recordings
from neurotact.deploy.chain import Chain
from neurotact.errors import InputError
from neurotact.networks.use import fitted
from neurotact.networks.use.fitted import Fitted

NAME = "touch"
COUNTED = 5
"""Number of trials on which instructions are counted; the counts are the same each time."""


class Trials(NamedTuple):
    """The input of a chain in C, and its expected output.

    learned: number of windows of a trial, from the first, that the network was trained on; None: all.
    """

    given: list[np.ndarray]
    expected: list[Spoken]
    labels: np.ndarray
    learned: int | None


def prove(
    run: Fitted, chain: Chain, formats: Formats | None, n_trials: int,
    recordings: Recordings | str | Path | None = None, spikes: str | Path | None = None, *,
    say: Callable[[str], None] = print, emulate: int | None = None,
) -> pd.DataFrame:  # fmt: skip
    """Rows `what`, `value` of the proof; steps without their tools are reported and skipped.

    n_trials: number of test trials. recordings, spikes: as for `export.prepared`. emulate: how many of these trials
    also run in the emulator; None: all.
    Raises InputError if a spike or a decision differs.
    """
    trials = trials_of(run, chain, formats, n_trials, recordings, spikes)
    rows = [("windows", sum(len(trial.decisions) for trial in trials.expected))]
    rows += [("accuracy on windows as in training", _accuracy(trials))]
    with files.scratch() as folder:
        c_export.write(chain, folder, formats, name=NAME, parts=c_export.HARNESS)
        rows += [*_on_this_machine(folder, trials, say)]
        for name, board in boards.BOARDS.items():
            absent = proof.missing("arm-none-eabi-gcc", "qemu-system-arm")
            if absent:
                say(f"{name}: skipped, {absent}")
                continue
            rows += [*_emulated(folder, trials, board, chain, len(trials.given) if emulate is None else emulate)]
    return pd.DataFrame(rows, columns=["what", "value"])


def trials_of(
    run: Fitted,
    chain: Chain,
    formats: Formats | None,
    n_trials: int,
    recordings: Recordings | str | Path | None = None,
    spikes: str | Path | None = None,
) -> Trials:
    """Test trials of a run as input of a chain in C, and the output of its twin."""
    restored = fitted.restore(run, spikes=spikes)
    recorded, learned = export.recorded(restored, recordings), restored.task.window.per_trial
    signals = [np.asarray(signal, np.float32) for signal in recorded.test[:n_trials]]
    if formats is None:
        return Trials(signals, [twin.said_in_float(chain, signal) for signal in signals], recorded.labels, learned)
    given = [formats.raw.samples(signal) for signal in signals]
    return Trials(given, twin.said_in_whole_numbers(chain, formats, given), recorded.labels, learned)


def _on_this_machine(folder: Path, trials: Trials, say: Callable[[str], None]) -> Iterator[tuple[str, Any]]:
    absent = proof.missing("cc")
    if absent:
        say(f"this machine: skipped, {absent}")
        return
    for what, flags in (("-O2", ("-O2",)), ("sanitizers", proof.SANITIZERS)):
        _require_equal(proof.on_host(folder, NAME, trials.given, flags=flags), trials.expected, f"this machine, {what}")
        yield f"this machine, {what}", "every spike and decision equal"


def _emulated(folder: Path, trials: Trials, board: Board, chain: Chain, n_trials: int) -> Iterator[tuple[str, Any]]:
    name, chip = board.processor, board.chip
    output, _ = proof.on_board(folder, NAME, trials.given[:n_trials], board)
    windows = _require_equal(output, trials.expected[:n_trials], name)
    yield f"{name}, emulated", f"every spike and decision of {windows} windows equal"
    size = proof.footprint(folder, NAME, board)
    yield f"{name}, flash", f"{size.flash} bytes"
    yield f"{name}, RAM", f"{size.ram} bytes, and at most {size.stack} of stack"
    _, ticks = proof.on_board(folder, NAME, trials.given[:COUNTED], board, counting=True)
    mean = ticks.total / ticks.samples
    yield f"{name}, instructions per sample", f"{mean:.0f}, at most {ticks.most}"
    ms = 1e3 * mean * board.cycles_per_instruction / chip.clock_Hz
    yield f"{name}, ms per sample on {chip.name} (estimate)", f"{ms:.3f} of {1e3 / chain.sampling_rate_Hz:.3f}"
    samples = np.mean([row[2] for trial in trials.expected for row in trial.decisions]) * chain.sampling_rate_Hz
    energy_uJ = 1e3 * ms * 1e-3 * chip.watts * samples / chain.clock_Hz * 1e3
    yield f"{name}, energy per decision on {chip.name} (estimate)", f"{energy_uJ:.0f} µJ"


def _require_equal(output: list[Spoken], expected: Sequence[Spoken], where: str) -> int:
    difference = proof.first_difference(list(proof.cut_off(output, expected)), expected)
    if difference:
        raise InputError(f"{where}: differs from its twin: {difference}; report it")
    return sum(len(trial.decisions) for trial in expected)


def _accuracy(trials: Trials) -> float:
    """The share of correct decisions among the decided windows."""
    is_correct = [
        row[-1] == label
        for trial, label in zip(trials.expected, trials.labels, strict=False)
        for row in trial.decisions[: trials.learned]
    ]
    return float(np.mean(is_correct)) if is_correct else float("nan")
