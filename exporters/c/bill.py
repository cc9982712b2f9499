"""The bill of a decision on one processor: the chain of a run and its opponents in C, on emulated Cortex-M.

Instructions are counted from the first sample of a window to the decision, features and encoding included. Flash and
RAM are those of the sections that a linker keeps, with the functions of the compiler's library.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from neurotact_parts.exporters.c import boards, proof
from neurotact_parts.exporters.c.boards import Board

from neurotact import files
from neurotact.data import encoded_from
from neurotact.data.splits import Split
from neurotact.errors import InputError
from neurotact.lazily import lazily
from neurotact.metrics import synops
from neurotact.metrics.flops import Standardise, cost
from neurotact.metrics.signal_flops import Averaging
from neurotact.networks.use.exporters import Exporter
from neurotact.progress import Tell, untold

with lazily():
    import pandas as pd
    from neurotact_parts.exporters import trials as test_trials
    from neurotact_parts.exporters.c import c_export, export, formats, opponents, proving
    from neurotact_parts.streams import chain as chains

    from neurotact.baselines import opponent as classifiers
    from neurotact.baselines import opponents as baselines
    from neurotact.networks.training import ranges, run_folder, tasks
    from neurotact.networks.use import fitted, inference, ledger
    from neurotact.report import wording


NAME = "touch"
TOOLS = ("arm-none-eabi-gcc", "arm-none-eabi-size", "qemu-system-arm")
INSTALL = (
    "install them (Debian and Ubuntu: apt install gcc-arm-none-eabi qemu-system-arm; macOS: brew install "
    "gcc-arm-embedded qemu)"
)
INTEGERS, FLOATS, ENCODING = "network, integers", "network, float", "its afferents alone, integers"
DECISIONS = 20
"""Test windows that are run, about: all of some trials, spread evenly."""
ASKED = ("kNN",)
"""Opponents of no study, which are measured, too."""
ROCKET = "MiniRocket"
SLOW, FEW = ("GRU", ROCKET), 4
"""Opponents on sequences, which take seconds to emulate, and the windows of them that are run."""
ROOM = 0.9
"""The share of the emulated machine's memory that a program may take, beside the harness and the stack."""


class Program(NamedTuple):
    """C in a folder, what it is given, `(sample, taxel)` of each trial, and what is expected of it.

    windows: the trial of each, and its samples: the first and that after the last. decided: the class of each in
    Python; none where the program decides nothing. flags: for the compiler. fits_only: it runs long, and is only run
    for a chip that has room for it.
    """

    what: str
    folder: Path
    accuracy: float
    flops: float
    trials: list[np.ndarray]
    windows: list[tuple[int, int, int]]
    decided: np.ndarray
    flags: tuple[str, ...] = ()
    fits_only: bool = False


class Windows(NamedTuple):
    """The windows of a run as samples `(window, sample, taxel)`, their classes and their trials."""

    samples: np.ndarray
    labels: np.ndarray
    trial: np.ndarray


def bill(
    run: fitted.Fitted,
    out: str | Path,
    *,
    recordings: str | Path | None = None,
    spikes: str | Path | None = None,
    force: bool = False,
    tell: Tell = untold,
) -> pd.DataFrame:
    """What a decision of a run and of its opponents takes on an emulated Cortex-M0 and M4: `bill.csv` in a folder.

    The report of a study shows the first line of `bill.txt` if it is in the folder `bill` of the run.

    run: a folder that `train` wrote. The opponents are fitted to the means in time bins of its windows, on its split.
    out: the folder, which also gets the C of each.
    recordings, spikes: that the run was trained on, where they moved since. force: replace files.
    tell: called with a line of each and with what the table shows.
    A row per program and processor: instructions, a mean over some test windows; how many were run, and how many
    decided as in Python; bytes of flash, RAM and stack (at most), and whether a chip with this processor has them;
    accuracy of the model in Python on all test windows; FLOPs of the ledger. NaN where a number is not known.
    Raises InputError where a tool is not installed, which it names, and for a network that cannot run in C.
    """
    absent = proof.missing(*TOOLS)
    if absent:
        raise InputError(f"bill: {absent}; {INSTALL}")
    fitted.check_folder(run, "bill", "whose windows and split its opponents are fitted on")
    out = Path(str(out))
    files.check_new(out / "bill.csv", force=force)
    rows = []
    for program in _programs(run, out, recordings, spikes):
        rows += [_row(program, name) for name in boards.ROOMY]
        tell(_line(rows[-len(boards.ROOMY) :]))
    table = pd.DataFrame(rows)
    with files.whole(out / "bill.csv") as draft:
        table.to_csv(draft, index=False)
    lines = [*summary(table)]
    files.write_text(out / "bill.txt", "".join(f"{line}\n" for line in lines))
    for line in lines:
        tell(line)
    return table


def _line(rows: list[dict[str, Any]]) -> str:
    """What a program takes on each processor, and how many of its decisions Python takes otherwise, if any."""
    parts = [
        f"{row['processor']} has no room"
        if np.isnan(row["instructions"])
        else f"{row['instructions']:,.0f} on {row['processor']}"
        for row in rows
    ]
    other = max(row["decisions"] - row["as_in_python"] for row in rows)
    ties = (
        f"; {other} of {rows[0]['decisions']} decisions are not those of Python: ties within rounding" if other else ""
    )
    return f"{rows[0]['what']}: instructions a decision {', '.join(parts)}{ties}"


def summary(table: pd.DataFrame) -> Iterator[str]:
    """Of each processor, the cheapest opponent beside the network in integers, and how the ledger orders them."""
    for processor, rows in table.groupby("processor", sort=False):
        counted = rows.dropna(subset=["instructions"]).set_index("what")
        others = counted.drop([INTEGERS, FLOATS, ENCODING], errors="ignore")
        if INTEGERS not in counted.index or others.empty:
            continue
        network = counted.loc[INTEGERS, "instructions"]
        cheapest = others["instructions"].idxmin()
        ratio = network / others.loc[cheapest, "instructions"]
        known = counted.drop([FLOATS, ENCODING], errors="ignore").dropna(subset=["ledger_flops"])
        order = known["instructions"].corr(known["ledger_flops"], method="spearman")
        each = known["instructions"] / known["ledger_flops"]
        yield (
            f"On an emulated {processor} the network in integers takes {wording.count(ratio)} times the instructions "
            f"of {cheapest}, the cheapest opponent; rank correlation with the ledger's FLOPs {order:.2f}, "
            f"{wording.count(each.min(), 2)} to {wording.count(each.max())} instructions per FLOP."
        )


def _programs(run: Any, out: Path, recordings: str | Path | None, spikes: str | Path | None) -> Iterator[Program]:
    restored = fitted.restore(run, spikes=spikes).of_classes("the bill in C")
    if not restored.encoder:
        raise InputError(f"{run}: was trained on the events of a sensor; a bill needs signals, which an encoder takes")
    trains = run_folder.trained_spikes_of(restored)
    split = tasks.trials_of(trains, restored.task)
    windows = trains.cut(restored.task.window, split.test)
    chosen = np.unique(windows.trial)
    chosen = ranges.evenly(chosen, -(-DECISIONS * len(chosen) // len(windows)))
    whole = export.prepared(run, recordings=recordings, spikes=spikes)
    assert whole.formats is not None  # of integers
    yield from _chains(restored, trains, whole, np.searchsorted(split.test, chosen), out, recordings)
    yield from _opponents(restored, trains, split, chosen, out, whole.formats.raw, recordings)


def _chains(
    restored: run_folder.Restored, trains: Any, whole: export.Exported, trials: np.ndarray, out: Path,
    recordings: str | Path | None,
) -> Iterator[Program]:  # fmt: skip
    """The chain in integers and in float, and its afferents alone; trials: of the test trials."""
    chain = whole.chain
    (network, encoder), accuracy = _ledger(restored, trains)
    recorded = test_trials.recorded(restored, recordings)
    signals = [recorded.test[trial] for trial in trials]
    for what, formats in ((INTEGERS, whole.formats), (FLOATS, None)):
        folder = out / what.replace(", ", "-")
        folder.mkdir(parents=True, exist_ok=True)
        c_export.write(chain, folder, formats, name=NAME, parts=c_export.HARNESS)
        twin = proving.twin_of(chain, formats, signals, recorded.labels, restored.task.window.per_trial)
        made = _of_chain(chain, twin)
        yield Program(what, folder, accuracy, network, *made)
        if formats is not None:
            alone = (f"-D{NAME.upper()}_AFFERENTS_ALONE",)
            yield Program(ENCODING, folder, np.nan, encoder, *made[:2], np.array([]), alone)


def _opponents(
    restored: run_folder.Restored, trains: Any, split: Split, chosen: np.ndarray, out: Path, raw: formats.Raw,
    recordings: str | Path | None,
) -> Iterator[Program]:  # fmt: skip
    """The opponents, fitted on the windows of the network; chosen: the trials whose windows are run."""
    cut = _windows(restored, trains, recordings)
    n_samples = cut.samples.shape[1]
    of_side = [np.isin(cut.trial, side) for side in split]
    given = [raw.samples(window) for window in cut.samples[np.isin(cut.trial, chosen)]]
    n_gru = baselines.gru_steps(restored.task.window.length_ms, n_samples)
    most = {"features": baselines.BINS, "sequences": n_gru, "signals": baselines.MOST_SAMPLES}
    for name in (*classifiers.joined("features", "quick"), *ASKED, *SLOW):
        opponent = classifiers.load(name)
        n_bins = min(most[opponent.takes], n_samples)
        if n_bins < opponent.least_steps:
            continue
        standard = opponents.Standard.of(cut.samples[of_side[0]], n_bins, is_sequence=opponent.takes != "features")
        run = given[:: -(-len(given) // FEW)] if name in SLOW else given
        inputs = (standard.input(cut.samples[side]) for side in of_side)
        sides = classifiers.Sides(*inputs, *(cut.labels[side] for side in of_side))
        best = classifiers.best_of(opponent, sides, 0)
        if type(best.fitted).__name__ not in opponents.DECISIONS:
            continue
        folder, accuracy = out / name.replace(" ", "-"), float((best.fitted.predict(sides.test) == sides.y_test).mean())
        opponents.write(best.fitted, standard, raw, restored.classes, n_samples, folder, name=NAME)
        n_taxels = standard.mean.shape[1]
        made = cost(Averaging(n_samples, n_bins, n_taxels), Standardise(n_bins * n_taxels))
        decided = best.fitted.predict(standard.input(np.stack(run) * raw.lsb + raw.zero))
        windows = [(i, 0, n_samples) for i in range(len(run))]
        spent = best.spent(made)["flops"]
        yield Program(name, folder, accuracy, spent, run, windows, decided, fits_only=name == ROCKET)


def _ledger(restored: run_folder.Restored, trains: Any) -> tuple[tuple[float, float], float]:
    """FLOPs of the whole chain and of its encoder, means over test windows, and the accuracy there."""
    means = synops.summary(inference.infer(restored, trains, early_exit=True, test_only=True))
    network, made_by = restored.network, ledger.Afferents.of(trains)
    found = ledger.decision_ledger(
        network.spec, made_by.n, network.n_classes, made_by.rate_Hz, means, encoder=made_by.encoder or None,
        recorded_Hz=made_by.recorded_Hz, synapses=network.synapses,
    ).set_index("name")["flops"]  # fmt: skip
    return (found.get("both", np.nan), found.get("encoder", np.nan)), float(means.iloc[-1]["accuracy"])


def _windows(restored: run_folder.Restored, trains: Any, recordings: str | Path | None) -> Windows:
    """The windows of the run's trials, cut to the samples of the shortest."""
    assert restored.spikes_path is not None  # of these spikes
    path, rows = encoded_from.find(restored.spikes_path, trains, np.arange(len(trains)), recordings)
    with encoded_from.opened(path, trains) as stored:
        recorded = stored.select(rows).loaded().to_unit(str((restored.encoder or {}).get("unit", "mV")))
    windows = trains.cut(restored.task.window, np.arange(len(trains)))
    pieces = [*baselines.pieces_of(recorded, windows, trains.sampling_rate_Hz)]
    shortest = min(map(len, pieces))
    known = np.array([restored.classes.index(name) for name in trains.classes])
    samples = np.stack([piece[:shortest] for piece in pieces])
    return Windows(samples, known[trains.labels[windows.trial]], windows.trial)


def _of_chain(
    chain: chains.Chain, trials: proving.Trials
) -> tuple[list[np.ndarray], list[tuple[int, int, int]], np.ndarray]:
    """Trials up to the end of the last window that was learned, the samples to each decision, and what is decided."""
    per_step = chain.sampling_rate_Hz / chain.clock_Hz
    given, windows, decided = [], [], []
    for trial, (samples, spoken) in enumerate(zip(trials.given, trials.expected, strict=True)):
        rows = spoken.decisions[: trials.learned]
        own = [_samples(row[1], chain.windows.length, per_step, len(samples)) for row in rows]
        exits = [math.ceil((row[1] + row[2] - 1) * per_step - 1e-9) + 1 for row in rows]  # after the deciding sample
        windows += [(trial, first, min(last, end)) for (first, last), end in zip(own, exits, strict=True)]
        decided += [row[-1] for row in rows]
        given.append(samples[: max(last for _, last in own) + 1] if own else samples[:1])
    return given, windows, np.array(decided)


def _samples(start: int, n_steps: int, per_step: float, most: int) -> tuple[int, int]:
    """The samples of a window of steps, as `pieces_of` cuts them."""
    first, last = (int(np.ceil(step * per_step - 1e-9)) for step in (start, start + n_steps))
    return first, min(last, most)


def _row(program: Program, name: str) -> dict[str, Any]:
    board = boards.ROOMY[name]
    board = board._replace(flags=(*board.flags, *program.flags))
    size, chip = proof.footprint(program.folder, NAME, board, optimise="-O2"), board.chip
    fits = size.flash <= chip.flash and size.ram + size.stack <= chip.ram
    counted = _counted(program, board, size, fits)
    return {
        "what": program.what, "processor": board.processor, **counted, "flash_bytes": size.flash,
        "ram_bytes": size.ram, "stack_bytes": size.stack, "chip": chip.name, "fits": fits,
        "accuracy_test": program.accuracy, "ledger_flops": program.flops,
    }  # fmt: skip


def _counted(program: Program, board: Board, size: proof.Footprint, fits: bool) -> dict[str, Any]:
    """Instructions of a decision, and how many decisions are those of Python; none where there is no room.

    fits: whether a chip has room, which is smaller than the board.
    """
    if size.flash > ROOM * board.flash or size.ram > ROOM * board.ram or (program.fits_only and not fits):
        return {"instructions": np.nan, "decisions": 0, "as_in_python": 0}
    said, ticks = proof.on_board(program.folder, NAME, program.trials, board, counting=True)
    spent = [ticks.of[trial][first:last].sum() for trial, first, last in program.windows]
    of_trial = [iter(spoken.decisions) for spoken in said]
    decided = [next(of_trial[trial])[-1] for trial, _, _ in program.windows[: len(program.decided)]]
    same = int((np.array(decided) == program.decided).sum())
    return {"instructions": float(np.mean(spent)), "decisions": len(decided), "as_in_python": same}


EXPORTER = Exporter(
    "what a decision takes on an emulated Cortex-M0 and M4, of the run and of its opponents: a folder with bill.csv",
    bill,
)
