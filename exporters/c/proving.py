"""The proof of an export on the test trials of its run: equality, accuracy, bytes, instructions, time and energy."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import torch
from neurotact_parts.exporters import trials as test_trials
from neurotact_parts.exporters.c import boards, c_export, integer, proof
from neurotact_parts.exporters.c.boards import Board
from neurotact_parts.exporters.c.formats import Formats, conditioner_of
from neurotact_parts.exporters.c.proof import Spoken, fired_in, spoken_of
from neurotact_parts.streams import detector
from neurotact_parts.streams.chain import Chain

from neurotact import files
from neurotact.data.recordings import Recordings
from neurotact.encoders import specs
from neurotact.errors import InputError
from neurotact.networks.training.events import DetectorSpec
from neurotact.networks.use import fitted
from neurotact.networks.use.fitted import Fitted

NAME = "touch"
COUNTED = 5
"""Number of trials on which instructions are counted; the counts are the same each time."""


ALONE = 2**32 - 1
"""In place of a channel: a time without an event."""


class Trials(NamedTuple):
    """The input of a chain in C, and its expected output.

    labels: the class of each trial, or its numbers `(trial, target)`. learned: number of windows of a trial, from the
    first, that the network was trained on; None: all. unit: of the values in `expected`.
    """

    given: list[np.ndarray]
    expected: list[Spoken]
    labels: np.ndarray
    learned: int | None
    unit: np.ndarray | float = 1.0


def prove(
    run: Fitted, chain: Chain, formats: Formats | None, n_trials: int,
    recordings: Recordings | str | Path | None = None, spikes: str | Path | None = None, *,
    say: Callable[[str], None] = print, emulate: int | None = None,
    taught: Mapping[str, Any] | None = None,
) -> pd.DataFrame:  # fmt: skip
    """Rows `what`, `value` of the proof; steps without their tools are reported and skipped.

    n_trials: number of test trials. recordings, spikes: as for `export.prepared`. emulate: how many of these trials
    also run in the emulator; None: all. taught: as for `c_export.write`.
    Raises InputError if a spike or a decision differs.
    """
    trials = trials_of(run, chain, formats, n_trials, recordings, spikes)
    what = "windows" if chain.detector is None else "changes of the label in force"
    rows = [(what, sum(len(trial.decisions) for trial in trials.expected))]
    rows += _accuracy(trials, chain.classes) if chain.detector is None else []
    with files.scratch() as folder:
        c_export.write(chain, folder, formats, name=NAME, parts=c_export.HARNESS, taught=taught)
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
    recorded = test_trials.recorded(restored, recordings)
    return twin_of(chain, formats, recorded.test[:n_trials], recorded.labels, restored.task.window.per_trial)


def twin_of(
    chain: Chain, formats: Formats | None, recorded: Sequence[np.ndarray], labels: np.ndarray, learned: int | None
) -> Trials:
    """These trials `(sample, taxel)` as input of a chain in C, and the output of its twin; the rest as of `Trials`."""
    signals = [np.asarray(signal, np.float32) for signal in recorded]
    given = signals if formats is None else [formats.raw.samples(signal) for signal in signals]
    if formats is None:
        expected = [expected_in_float(chain, signal) for signal in signals]
    else:
        expected = expected_in_integers(chain, formats, given)
    unit = 1.0 if formats is None else formats.readout.unit
    return Trials([*map(events_in, signals)] if chain.takes_events else given, expected, labels, learned, unit)


def events_in(raster: np.ndarray) -> np.ndarray:
    """The events of a trial of spikes `(step, afferent)` as the input of C: times in steps and channels, uint32.

    Each step ends with a row of its time alone.

    >>> events_in(np.array([[0, 1], [0, 0]])).tolist()
    [[0, 1], [1, 4294967295], [2, 4294967295]]
    """
    steps, units = np.nonzero(raster)
    ends = np.arange(1, len(raster) + 1)
    times, channels = np.append(steps, ends), np.append(units, np.full(len(ends), ALONE))
    order = np.lexsort((channels != ALONE, times))  # an end before the events of the step that begins there
    return np.stack([times, channels], axis=1)[order].astype(np.uint32)


def expected_in_integers(chain: Chain, formats: Formats, trials: Sequence[np.ndarray]) -> list[Spoken]:
    """The output for trials of raw samples `(sample, taxel)` int16, together: shorter ones are padded and cut."""
    lengths = np.array([len(trial) for trial in trials])
    padded = np.stack(
        [np.concatenate([trial, np.repeat(trial[-1:], lengths.max() - len(trial), axis=0)]) for trial in trials]
    )
    rasters = integer.encode(padded, formats.front, lengths)
    spikes = [
        raster[: integer.n_steps(n_samples, formats.front)]
        for raster, n_samples in zip(rasters, lengths.tolist(), strict=True)
    ]
    cut, n = [_windows(chain, raster) for raster in spikes], chain.network.steps_per_bin
    windows = np.concatenate([windows for _, windows in cut])
    made = integer.infer(windows, formats, chain.network.neuron, chain.rule, n)
    spent = _sops(chain, windows, made.hidden, made.steps)
    label, values = _told(chain, made.labels, made.readout)
    decided = np.stack([label, made.steps, made.input_spikes, made.hidden_spikes, *spent, made.heard], axis=1)
    ends = np.cumsum([len(starts) for starts, _ in cut])[:-1]
    parts = zip(spikes, cut, *(np.split(each, ends) for each in (made.hidden, decided, values)), strict=True)
    return [spoken_of(raster, starts, hidden, rows, n, told) for raster, (starts, _), hidden, rows, told in parts]


def _told(chain: Chain, labels: np.ndarray, readout: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The class of each window, 0 where numbers are told, and these, `(window, target)`."""
    return (np.zeros_like(labels), readout) if chain.tells_numbers else (labels, readout[:, :0])


@torch.no_grad()
def expected_in_float(chain: Chain, trial: np.ndarray) -> Spoken:
    """The output for a whole trial of samples `(sample, taxel)` float32, in the encoder's unit."""
    signal = conditioner_of(chain).whole(trial)
    raster = specs.encode_whole(signal[None], chain.signal_Hz, chain.lif)[0]
    if chain.detector is not None:
        return _changes(chain, chain.detector, raster)
    starts, windows = _windows(chain, raster)
    inputs = torch.from_numpy(windows)
    made, (hidden, readout) = chain.network.infer(inputs, chain.rule), chain.network.simulate(inputs)
    n = chain.network.steps_per_bin
    is_simulated = torch.arange(hidden.shape[1]) * n < made.steps[:, None]
    fired = ((readout != 0).any(dim=2) & is_simulated).any(dim=1).long()
    spent = _sops(chain, windows, hidden.numpy(), made.steps.numpy())
    label, values = _told(chain, made.labels.numpy(), made.readout.numpy())
    decided = np.stack([label, made.steps, made.input_spikes, made.hidden_spikes, *spent, fired], axis=1)
    return spoken_of(raster, starts, hidden.numpy(), decided, n, values)


def _changes(chain: Chain, rule: DetectorSpec, raster: np.ndarray) -> Spoken:
    """What a detector tells of a whole trial of spikes `(step, afferent)`: each change of the label in force."""
    n = chain.network.steps_per_bin
    hidden, values = detector.run_on(chain.network, raster)
    told, whole = [*detector.changes(values, rule)], raster[None, : len(values) * n]
    ends = np.array([0, *(step + 1 for step, _ in told)])
    spikes = chain.network.binned(torch.from_numpy(whole))[0].numpy(), hidden
    counts = [np.append(0, each.sum(axis=1, dtype=np.int64).cumsum())[ends] for each in spikes]
    repeated = [np.repeat(each, len(ends), axis=0) for each in (whole, hidden[None])]
    spent = _sops(chain, repeated[0], repeated[1], n * ends)
    rows = np.diff([n * ends, *counts, *spent], axis=1).T.tolist()
    each = enumerate(zip((n * ends).tolist(), rows, told, strict=False))
    decisions = [(number, start, *row, 1, label) for number, (start, row, (_, label)) in each]
    return Spoken(fired_in(raster), {0: fired_in(hidden)}, decisions, runs_on=True)


def _sops(chain: Chain, windows: np.ndarray, hidden: np.ndarray, steps: np.ndarray) -> list[np.ndarray]:
    """Synaptic operations of windows until their decisions, `(window,)`, of a pruned network alone."""
    if not chain.network.synapses:
        return []
    inputs, n_bins = chain.network.binned(torch.from_numpy(windows)), -(-steps // chain.network.steps_per_bin)
    spent = chain.network.sops_until(inputs, torch.from_numpy(hidden), torch.from_numpy(n_bins))
    return [spent.sum(dim=1).numpy()]


def _windows(chain: Chain, raster: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    starts, length = chain.windows.starts(raster), chain.windows.length
    shape = (0, length, raster.shape[1])
    return starts, np.stack([raster[i : i + length] for i in starts]) if len(starts) else np.zeros(shape, np.uint8)


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
    what = "windows" if chain.detector is None else "changes"
    yield f"{name}, emulated", f"every spike and decision of {windows} {what} equal"
    size = proof.footprint(folder, NAME, board)
    yield f"{name}, flash", f"{size.flash} bytes"
    yield f"{name}, RAM", f"{size.ram} bytes, and at most {size.stack} of stack"
    _, ticks = proof.on_board(folder, NAME, trials.given[:COUNTED], board, counting=True)
    each = "step" if chain.takes_events else "sample"
    n_each = sum(len(one.afferents) for one in trials.expected[:COUNTED]) if chain.takes_events else ticks.samples
    mean = ticks.total / n_each
    most = "" if chain.takes_events else f", at most {ticks.most}"
    yield f"{name}, instructions per {each}", f"{mean:.0f}{most}"
    ms = 1e3 * mean * board.cycles_per_instruction / chip.clock_Hz
    yield f"{name}, ms per {each} on {chip.name} (estimate)", f"{ms:.3f} of {1e3 / chain.sampling_rate_Hz:.3f}"
    steps, per = [row[2] for trial in trials.expected for row in trial.decisions], "decision"
    if chain.detector is not None:
        steps, per = [chain.clock_Hz], "second"
    samples = np.mean(steps) * chain.sampling_rate_Hz
    energy_uJ = 1e3 * ms * 1e-3 * chip.watts * samples / chain.clock_Hz * 1e3
    yield f"{name}, energy per {per} on {chip.name} (estimate)", f"{energy_uJ:.0f} µJ"


def _require_equal(output: list[Spoken], expected: Sequence[Spoken], where: str) -> int:
    difference = proof.first_difference(list(proof.cut_off(output, expected)), expected)
    if difference:
        raise InputError(f"{where}: differs from its twin: {difference}; report it")
    return sum(len(trial.decisions) for trial in expected)


def _accuracy(trials: Trials, names: Sequence[str]) -> list[tuple[str, float]]:
    """The share of correct decisions among the decided windows, or the root-mean-square error of each number."""
    each = zip(trials.expected, trials.labels, strict=False)
    pairs = [(row, label) for trial, label in each for row in trial.decisions[: trials.learned]]
    where = "on windows as in training"
    if trials.labels.ndim == 1:
        return [(f"accuracy {where}", float(np.mean([row[-1] == label for row, label in pairs] or np.nan)))]
    told = np.array([row[-len(names) :] for row, _ in pairs]).reshape(-1, len(names)) * trials.unit
    errors = np.square(told - [label for _, label in pairs]).mean(axis=0) ** 0.5
    said = [f"root-mean-square error of {name} {where}" for name in names]
    return [*zip(said, errors.tolist(), strict=True)]
