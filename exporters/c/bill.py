"""The bill of a decision on one processor: the chain of a run and its opponents in C, on emulated Cortex-M.

Instructions are counted from the first sample of a window to the decision, features and encoding included. Flash and RAM
are those of the sections that a linker keeps, with the functions of the compiler's library.
"""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from neurotact_parts.exporters.c import boards, c_export, export, opponents, proof, proving
from neurotact_parts.exporters.c.boards import Board
from neurotact_parts.exporters.c.formats import Raw
from sklearn.preprocessing import StandardScaler

from neurotact import files
from neurotact.baselines.features import averaged
from neurotact.baselines.opponent import Candidate, Sides, best_of, joined, load
from neurotact.baselines.opponents import BINS, pieces_of
from neurotact.data import encoded_from
from neurotact.deploy.chain import Chain
from neurotact.deploy.exporters import Exporter
from neurotact.errors import InputError
from neurotact.metrics import synops
from neurotact.metrics.flops import Standardise, cost
from neurotact.metrics.signal_flops import Averaging
from neurotact.networks.training import tasks, trained
from neurotact.networks.use import fitted, inference, ledger
from neurotact.networks.use.fitted import Fitted
from neurotact.networks.use.ledger import Afferents
from neurotact.progress import Tell, untold

NAME = "touch"
TOOLS = ("arm-none-eabi-gcc", "arm-none-eabi-size", "qemu-system-arm")
INSTALL = (
    "install them (Debian and Ubuntu: `apt install gcc-arm-none-eabi qemu-system-arm`; macOS: "
    "`brew install --cask gcc-arm-embedded` and `brew install qemu`)"
)
INTEGERS, FLOATS = "network, integers", "network, float"


class Program(NamedTuple):
    """C in a folder, what it is given, `(sample, taxel)` of each trial, and what is expected of it.

    decided: the class of each window, as Python decides it. windows: of these, the trial and its samples, from the
    first to that after the last.
    """

    what: str
    folder: Path
    trials: list[np.ndarray]
    decided: np.ndarray
    windows: list[tuple[int, int, int]]
    accuracy: float
    flops: float


class Windows(NamedTuple):
    """The windows of a run as samples `(window, sample, taxel)`, their classes, and the windows of each side."""

    samples: np.ndarray
    labels: np.ndarray
    sides: tuple[np.ndarray, np.ndarray, np.ndarray]


def bill(
    run: Fitted,
    out: str | Path,
    *,
    decisions: int = 20,
    recordings: str | Path | None = None,
    spikes: str | Path | None = None,
    force: bool = False,
    tell: Tell = untold,
) -> pd.DataFrame:
    """What a decision of a run and of its opponents takes on an emulated Cortex-M0 and M4: `bill.csv` in a folder.

    run: a folder that `train` wrote. The opponents are fitted to the means in time bins of its windows, on its split.
    out: the folder, which also gets the C of each. decisions: test windows that are run; costs are means over them.
    recordings, spikes: that the run was trained on, where they moved since. force: replace files.
    tell: called with the table and what it shows.
    A row per program and processor: instructions, bytes of flash, RAM and stack (at most), whether they fit the chip of
    `boards`, how many decisions are Python's, test accuracy, and the operations of the ledger (NaN if not counted).
    Raises InputError where a tool is not installed, which it names, and for a network that cannot run in C.
    """
    absent = proof.missing(*TOOLS)
    if absent:
        raise InputError(f"bill: {absent}; {INSTALL}")
    fitted.check_folder(run, "bill", "whose windows and split its opponents are fitted on")
    out = Path(str(out))
    files.check_new(out / "bill.csv", force=force)
    rows = []
    for program in _programs(run, out, decisions, recordings, spikes):
        rows += [_row(program, name) for name in boards.ROOMY]
        tell(
            f"{program.what}: {rows[-2]['instructions']:,.0f} instructions on Cortex-M0, {rows[-1]['instructions']:,.0f} on M4"
        )
    table = pd.DataFrame(rows)
    with files.whole(out / "bill.csv") as draft:
        table.to_csv(draft, index=False)
    for line in summary(table):
        tell(line)
    return table


def summary(table: pd.DataFrame) -> Iterator[str]:
    """Of each processor, the cheapest opponent beside the network in integers, and how the ledger orders them."""
    for processor, rows in table.groupby("processor", sort=False):
        counted = rows.dropna(subset=["instructions"]).set_index("what")
        others = counted.drop([INTEGERS, FLOATS], errors="ignore")
        network = counted.loc[INTEGERS, "instructions"]
        cheapest = others["instructions"].idxmin()
        ratio = network / others.loc[cheapest, "instructions"]
        known = counted.drop(FLOATS, errors="ignore").dropna(subset=["ledger_flops"])
        order = known["instructions"].corr(known["ledger_flops"], method="spearman")
        each = known["instructions"] / known["ledger_flops"]
        yield (
            f"{processor}: the network in integers takes {ratio:.2g} times the instructions of {cheapest}, the cheapest "
            f"opponent; rank correlation with the ledger's FLOPs {order:.2f}, {each.min():.2g} to {each.max():.2g} "
            "instructions per FLOP"
        )


def _programs(
    run: Any, out: Path, decisions: int, recordings: str | Path | None, spikes: str | Path | None
) -> Iterator[Program]:
    restored = fitted.restore(run, spikes=spikes)
    trains = trained.load_spikes_of(restored)
    trained.check_trials(restored, trains)
    flops, accuracy = _ledger(restored, trains)
    raw = None
    for what, integer in ((INTEGERS, True), (FLOATS, False)):
        made = export.prepared(run, integer=integer, recordings=recordings, spikes=spikes)
        raw = made.formats.raw if made.formats is not None else raw
        folder = out / what.replace(", ", "-")
        c_export.write(made.chain, folder, made.formats, name=NAME, parts=c_export.HARNESS)
        trials = proving.trials_of(run, made.chain, made.formats, decisions, recordings, spikes)
        yield _of_chain(Program(what, folder, [], np.array([]), [], accuracy, flops), made.chain, trials, decisions)
    assert raw is not None
    cut = _windows(restored, trains, recordings)
    features = _features(cut.samples)
    scaler = StandardScaler().fit(features[cut.sides[0]])
    scaled = scaler.transform(features)
    sides = Sides(*(scaled[side] for side in cut.sides), *(cut.labels[side] for side in cut.sides))
    test = cut.samples[cut.sides[2]][:decisions]
    given = [raw.samples(window) for window in test]
    seen = scaler.transform(_features(np.stack(given) * raw.lsb + raw.zero))
    for name in [*joined("features", "quick"), "kNN"]:
        best = best_of(load(name), sides, 0)
        if type(best.fitted).__name__ not in opponents.DECISIONS:
            continue
        folder, (n_samples, n_taxels) = out / name.replace(" ", "-"), cut.samples.shape[1:]
        opponents.write(best.fitted, scaler, raw, restored.classes, n_samples, n_taxels, folder, name=NAME)
        yield Program(
            name, folder, given, best.fitted.predict(seen), [(i, 0, n_samples) for i in range(len(given))],
            float((best.fitted.predict(sides.test) == sides.y_test).mean()), _flops(best, n_samples, n_taxels, scaler),
        )  # fmt: skip


def _features(samples: np.ndarray) -> np.ndarray:
    return averaged(samples, min(BINS, samples.shape[1])).reshape(len(samples), -1)


def _flops(best: Candidate, n_samples: int, n_taxels: int, scaler: StandardScaler) -> float:
    n = scaler.n_features_in_
    made = cost(Averaging(n_samples, n // n_taxels, n_taxels), Standardise(n))
    return best.spent(made)["flops"]


def _ledger(restored: trained.Restored, trains: Any) -> tuple[float, float]:
    """FLOPs of the encoder and the network, a mean over test windows, and the accuracy there."""
    means = synops.summary(inference.infer(restored, trains, early_exit=True, test_only=True))
    network, made_by = restored.network, Afferents.of(trains)
    table = ledger.decision_ledger(
        network.spec, made_by.n, network.n_classes, made_by.rate_Hz, means, encoder=made_by.encoder or None,
        recorded_Hz=made_by.recorded_Hz,
    ).set_index("name")  # fmt: skip
    return float(table["flops"].get("both", np.nan)), float(means.iloc[-1]["accuracy"])


def _windows(restored: trained.Restored, trains: Any, recordings: str | Path | None) -> Windows:
    """The windows of the run's trials, cut to the samples of the shortest."""
    assert restored.spikes_path is not None  # of these spikes
    path, rows = encoded_from.find(restored.spikes_path, trains, np.arange(len(trains)), recordings)
    with encoded_from.opened(path, trains) as stored:
        recorded = stored.select(rows).loaded().to_unit(str((restored.encoder or {}).get("unit", "mV")))
    windows = trains.cut(restored.task.window, np.arange(len(trains)))
    pieces = [*pieces_of(recorded, windows, trains.sampling_rate_Hz)]
    shortest = min(map(len, pieces))
    split = tasks.trials_of(trains, restored.task)
    train, validation, test = (np.flatnonzero(np.isin(windows.trial, side)) for side in split)
    known = np.array([restored.classes.index(name) for name in trains.classes])
    samples = np.stack([piece[:shortest] for piece in pieces])
    return Windows(samples, known[trains.labels[windows.trial]], (train, validation, test))


def _of_chain(program: Program, chain: Chain, trials: proving.Trials, decisions: int) -> Program:
    """A program with the input of a chain, up to the end of the last window that counts."""
    per_step = chain.sampling_rate_Hz / chain.clock_Hz
    given, decided, windows = [], [], []
    for trial, spoken in zip(trials.given, trials.expected, strict=True):
        rows = spoken.decisions[: trials.learned][: decisions - len(decided)]
        ends = [_samples(row[1], chain.windows.length, per_step, len(trial)) for row in rows]
        decided += [row[-1] for row in rows]
        windows += [(len(given), *one) for one in ends]
        given.append(trial[: ends[-1][1] + 1] if ends else trial[:1])
        if len(decided) == decisions:
            break
    return program._replace(trials=given, decided=np.array(decided), windows=windows)


def _samples(start: int, n_steps: int, per_step: float, most: int) -> tuple[int, int]:
    """The samples of a window of steps, as `pieces_of` cuts them."""
    first, last = (int(np.ceil(step * per_step - 1e-9)) for step in (start, start + n_steps))
    return first, min(last, most)


def _row(program: Program, name: str) -> dict[str, Any]:
    board = boards.ROOMY[name]
    size = proof.footprint(program.folder, NAME, board, optimise="-O2")
    instructions, same = float("nan"), 0
    if size.flash < board.flash * 0.9 and size.ram < board.ram * 0.9:
        said, ticks = proof.on_board(program.folder, NAME, program.trials, board, counting=True)
        first = {trial: [] for trial in range(len(said))}
        for trial, begin, end in program.windows:
            first[trial].append(ticks.of[trial][begin:end].sum())
        instructions = float(np.mean(np.concatenate([*first.values()])))
        labels = [row[-1] for trial, spoken in enumerate(said) for row in spoken.decisions[: len(first[trial])]]
        same = int((np.array(labels) == program.decided).sum())
    chip = board.chip
    return {
        "what": program.what, "processor": board.processor, "instructions": instructions, "flash_bytes": size.flash,
        "ram_bytes": size.ram, "stack_bytes": size.stack, "fits": f"{chip.name}: " + (
            "yes" if size.flash <= chip.flash and size.ram + size.stack <= chip.ram else "no"
        ), "as_in_python": f"{same} of {len(program.decided)}", "accuracy_test": program.accuracy,
        "ledger_flops": program.flops,
    }  # fmt: skip


EXPORTER = Exporter(
    "what a decision takes on an emulated Cortex-M0 and M4, of the run and of its opponents: a folder with bill.csv",
    bill,
    {"decisions": "test windows that are run."},
)
