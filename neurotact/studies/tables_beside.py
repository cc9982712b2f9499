"""The tables of a study beside its cells: what its recordings, encoders and classical classifiers give.

Each is made before any cell runs, from the recordings of the first cell and the spikes of all.
"""

import sys
from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from neurotact import plugins
from neurotact.baselines import opponents
from neurotact.data import hdf5
from neurotact.data.augmentation import varied_copies
from neurotact.data.copies import copies_of
from neurotact.data.dataset import until
from neurotact.data.recordings import Recordings
from neurotact.data.spikes import SpikeTrains
from neurotact.data.splits import Split
from neurotact.data.windows import Windows, WindowSpec
from neurotact.encoders.specs import t_ref_pair_ms
from neurotact.metrics import paired
from neurotact.networks.training import model_selection, tasks
from neurotact.studies import measures, store
from neurotact.studies.cell import task_of
from neurotact.studies.study import COPIES, Cell, StudySpec, encoder_columns, reach_ms, split_columns, value_at
from neurotact.studies.study import cells as cells_of
from neurotact.tables import write_table


def names(study: StudySpec) -> list[str]:
    """The files of the tables that a study asks for."""
    of_study = [f"{one.table}.csv" for one in measures.requested(study.measures).values() if one.of_study is not None]
    return [*(store.BASELINES if study.baselines != "none" else ()), *of_study]


def write(
    folder: Path, study: StudySpec, cells: Sequence[Cell], recordings: Recordings, missing: Container[str]
) -> None:
    """Write the tables of the study's measures that are missing."""
    for name, one in measures.requested(study.measures).items():
        if one.of_study is not None and (table := f"{one.table}.csv") in missing:
            with store.timed(folder, name.replace("_", " ")):
                write_table(one.of_study(folder, study, cells, recordings), folder / table)
            store.seal(folder, [table])


def rows_of(
    folder: Path, recordings: Recordings, study: StudySpec, cell: Cell, cells: Sequence[Cell], *, is_first: bool
) -> list[dict[str, Any]]:
    """The rows of classifiers on the spikes of one cell; if `is_first`, also on the signals.

    cells: the first of the study's cells, and one of each data set.
    """
    detects = task_of(cell).detects
    fitted = plugins.load_function("tools", "rivals_of_detectors") if detects else _fitted
    return [*fitted(folder, recordings, study, cell, cells, is_first=is_first)]


def _fitted(
    folder: Path, recordings: Recordings, study: StudySpec, cell: Cell, cells: Sequence[Cell], *, is_first: bool
) -> Iterator[dict[str, Any]]:
    """Rows of `baselines.csv` on the spikes of one cell, the only spikes in memory; if `is_first`, also on signals."""
    trains, split = hdf5.load_spikes(folder / cell.given), {key: value_at(cell, key) for key in split_columns(study)}
    task = task_of(cell).model_copy(update={"subset": {}})
    parts, last = tasks.trials_of(trains, task), tasks.with_every_condition(trains, task)
    trains = with_used_copies(trains, cell, parts, *([] if last is None else [tasks.trials_of(trains, last)]))
    window, of_sides = windows_of(cells[0])
    every, first = trains.with_variations(window), copies_of(trains).first
    if trains.variations is not None:  # the trial of a varied copy is that of which it is one
        first = np.concatenate([first, first[trains.variations.of]])
    windows = every.cut(window)
    labels = tasks.labels_of(every, windows, task).numpy()
    pieces = ()
    if is_first and trains.variations:
        pieces = pieces_with_copies(recordings, windows, trains, cell, cells_of(study))
    first_ms, second_ms = t_ref_pair_ms(cell.encoder)
    pair = second_ms, first_ms
    for name, where in {cell.dataset: cell.subset for cell in cells}.items():
        cut = partial(opponents.cuts_of, every.conditions, windows, trains.sampling_rate_Hz, subset=where)
        cuts = of_sides(with_training(cut(parts), trains, cell, parts))
        cuts = cuts._replace(tells="numbers" if task.target else "classes")
        if last is not None:
            known = tasks.trials_of(trains, last)
            cuts = cuts._replace(last=of_sides(with_training(cut(known), trains, cell, known)))
        of_signals = opponents.signal_inputs(recordings, cuts, study.baselines, pieces) if is_first else ()
        counts = {"is_first": is_first, "encoding": study.encoding_in == "processor"}
        of_spikes = opponents.spike_inputs(every, pair, cuts, study.baselines, **counts)
        is_of_another = cell.calibrate is not None and cell.test_every_condition and where != cell.subset
        of_spikes = () if study.baselines == "linear" or is_of_another else of_spikes  # an encoder of other trials
        for row in opponents.rows(chain(of_signals, of_spikes), labels, cuts):
            own = row[opponents.RIGHT].items()
            touches = {side: paired.by_trial(first[[*shares]], [*shares.values()]) for side, shares in own}
            wrong = row.pop(opponents.ERRORS, ())
            errors = {f"rmse_{target}": rmse for target, rmse in zip(task.numbers, wrong, strict=True)}
            yield {"dataset": name, **split, **row, **errors, **encoder_of(row, study, cell), opponents.RIGHT: touches}


def encoder_of(row: Mapping[str, Any], study: StudySpec, cell: Cell) -> dict[str, Any]:
    """The columns of a classifier's row that tell encoders of a sweep apart; signals have copies, and no encoder."""
    of_it = "" if row["t_ref_ra_ms"] is not None else COPIES
    return {key: value_at(cell, key) if key.startswith(of_it) else None for key in encoder_columns(study)}


def windows_of(cell: Cell) -> tuple[WindowSpec, Callable[[opponents.Cuts], opponents.Cuts]]:
    """The windows of a trial for training or for a test, whichever are more, and what leaves each side its own."""
    task = task_of(cell)
    trained, tested = (one.per_trial or sys.maxsize for one in (task.training_window, task.window))

    def of_sides(cuts: opponents.Cuts) -> opponents.Cuts:
        trial = cuts.windows.trial
        rank = np.arange(len(trial)) - np.searchsorted(trial, trial)
        mine, its = rank < trained, rank < tested
        train, validation, test = cuts.sides
        copies = {kind: side & mine for kind, side in cuts.copies.items()}
        return cuts._replace(sides=(train & mine, validation & mine, test & its), copies=copies)

    return (task.training_window if trained > tested else task.window), of_sides


def with_used_copies(trains: SpikeTrains, cell: Cell, *parts: Split) -> SpikeTrains:
    """The spike trains with the varied copies alone that some trainings use."""
    if cell.augmentation is None or trains.variations is None:
        return trains
    kinds = model_selection.candidates(cell.augmentation, trains.conditions, cell.split)
    varied = model_selection.are_unranked(kinds, trains.conditions, cell.split)
    copied = np.concatenate([trials for part in parts for trials in (part.train, part.validation)[: 1 + varied]])
    used = np.isin(trains.variations.of, copied) & np.isin(trains.variations.kind, kinds)
    return replace(trains, variations=trains.variations.only(np.flatnonzero(used)))


def pieces_with_copies(
    recordings: Recordings, windows: Windows, trains: SpikeTrains, cell: Cell, cells: Iterable[Cell] = ()
) -> list[np.ndarray]:
    """The samples of each window of the recorded trials, then of those of their varied copies.

    cells: as of `copied_part`.
    """
    assert cell.augmentation is not None
    assert trains.variations is not None
    of_recorded = windows.trial < len(trains)
    recorded = Windows(windows.trial[of_recorded], windows.start[of_recorded], windows.n_steps)
    pieces = [*opponents.pieces_of(recordings, recorded, trains.sampling_rate_Hz)]
    before = len(trains)
    for copies in varied_copies(copied_part(recordings, cell, *cells), cell.augmentation, trains.variations.places):
        inside = (windows.trial >= before) & (windows.trial < before + len(copies.of))
        own = Windows(windows.trial[inside] - before, windows.start[inside], windows.n_steps)
        pieces += [piece.copy() for piece in opponents.pieces_of(copies.recordings, own, trains.sampling_rate_Hz)]
        before += len(copies.of)
    return pieces


def with_training(cuts: opponents.Cuts, trains: SpikeTrains, cell: Cell, parts: Split) -> opponents.Cuts:
    """The cuts with a choice of varied copies to train on, as the networks have it."""
    if cell.augmentation is None or trains.variations is None:
        return cuts
    made, known = {}, np.isin(cuts.windows.trial, cuts.windows.trial[cuts.sides[0]])
    for kind in model_selection.candidates(cell.augmentation, trains.conditions, cell.split):
        rows = trains.variations.rows(parts.train, kind)
        rows = rows[np.isin(trains.variations.of[rows], cuts.windows.trial[known])]
        made[kind] = cuts.sides[0] | np.isin(cuts.windows.trial, len(trains) + rows)
    if not model_selection.are_unranked([*made], trains.conditions, cell.split):
        return cuts._replace(copies=made)
    rows = trains.variations.rows(parts.validation, next(iter(made)))
    validation = cuts.sides[1] | np.isin(cuts.windows.trial, len(trains) + rows)
    return cuts._replace(copies=made, sides=(cuts.sides[0], validation, cuts.sides[2]))


def copied_part(recordings: Recordings, *cells: Cell) -> Recordings:
    """The trials as far as the windows of the cells' copies reach; whole trials if these begin at an onset."""
    return until(recordings, reach_ms(*cells, recorded_Hz=recordings.sampling_rate_Hz))
