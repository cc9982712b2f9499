"""Shared inputs of a study's cells: recordings, their split, the spike trains of every swept encoder."""

import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from neurotact.baselines import opponents
from neurotact.data import hdf5
from neurotact.data.augmentation import check_taxels, varied_copies
from neurotact.data.conditioning import conditioned_length
from neurotact.data.copies import copies_of
from neurotact.data.dataset import DatasetSpec, load_recordings, until
from neurotact.data.recordings import Recordings, class_indices, select_conditions
from neurotact.data.sources import expand
from neurotact.data.spikes import SpikeTrains
from neurotact.data.splits import Split, training_touches
from neurotact.data.windows import Windows, check_fit
from neurotact.encoders import regained
from neurotact.encoders.afferents import AfferentSpec
from neurotact.encoders.calibration import CLOCK_HZ, calibration_for
from neurotact.encoders.encoding import encode_recordings
from neurotact.encoders.gain_search import CalibrationRule
from neurotact.encoders.same_drive import same_drive_table
from neurotact.encoders.signals import signal_table
from neurotact.encoders.specs import EncoderSpec, t_ref_pair_ms, with_t_refs
from neurotact.errors import InputError
from neurotact.files import write_json
from neurotact.metrics import paired
from neurotact.networks.training import robust, tasks
from neurotact.progress import track
from neurotact.spec import digest
from neurotact.studies import encoded, store
from neurotact.studies.cell import task_of
from neurotact.studies.store import DATA
from neurotact.studies.study import (
    CHOICES,
    Cell,
    StudySpec,
    by_split,
    encoder_columns,
    reach_ms,
    split_columns,
    value_at,
)
from neurotact.tables import write_table

BASELINES = ("baselines.csv", "baselines_trials.csv")
RECONSTRUCTION = "reconstruction.csv"


def dataset_of(study: StudySpec, cell: Cell) -> DatasetSpec:
    """The data set of a cell: the study's, with the cell's swept parameters of the simulation."""
    return study.dataset.model_copy(update={"parameters": cell.source["parameters"]})


def prepare(folder: Path, study: StudySpec, cells: list[Cell]) -> None:
    """Write missing and damaged files: `folder/spikes`, its encoding tables, and the study's tables.

    A line on stderr names each damaged file. Raises InputError if the recordings changed since the study started.
    """
    dataset, target = study.dataset, folder / "spikes"
    table_flaws = store.flaws(folder, [DATA, *tables_of(study)])
    distinct = {cell.spikes_name: cell for cell in cells}
    spikes_flaws = store.flaws(target, [name for cell in distinct.values() for name in _encoded(cell)])
    store.say_flaws("", table_flaws, "written again")
    store.say_flaws(f"{target.name}/", spikes_flaws, "encoded again")
    source = _source(dataset)
    before = store.sound_json(folder, DATA)
    is_same = before is not None and (source is None or source == before.get("source"))
    if is_same and not (table_flaws or spikes_flaws):
        return
    first, *others = _by_source(cells)
    with store.timed(folder, "read"):
        recordings = load_recordings(dataset_of(study, first[0]))
    for cell in cells:
        check_taxels(cell.augmentation, recordings.n_channels)
    content = _check_unchanged(folder, recordings, before, source)
    recordings = encoded_part(recordings, first[0])
    _encode(folder, study, first, recordings, content)
    for group in others:  # only one set of recordings is in memory
        if any(name in spikes_flaws for cell in group for name in _encoded(cell)):
            of_group = encoded_part(load_recordings(dataset_of(study, group[0])), group[0])
            _encode(folder, study, group, of_group, content)
    if "signals.csv" in table_flaws:
        table = signal_table(recordings, study.encoder, dataset.stratify, study.window.start_ms)
        write_table(table, folder / "signals.csv")
    if "same_drive.csv" in table_flaws and study.same_drive is not None and isinstance(study.encoder, AfferentSpec):
        table = same_drive_table(recordings, study.encoder, study.same_drive, study.window.start_ms)
        write_table(table, folder / "same_drive.csv")
    if not table_flaws.keys().isdisjoint(BASELINES):
        with store.timed(folder, "baselines"):
            for name, table in zip(BASELINES, _baselines_tables(folder, recordings, study, cells), strict=True):
                write_table(table, folder / name)
    if RECONSTRUCTION in table_flaws:
        with store.timed(folder, "reconstruct"):
            write_table(_reconstruction_table(folder, recordings, study, cells), folder / RECONSTRUCTION)
    store.seal(folder, tables_of(study))


def _baselines_tables(
    folder: Path, recordings: Recordings, study: StudySpec, cells: Sequence[Cell]
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Classical classifiers on the windows of the networks, for each subset and split, and their single trials.

    The second table contains, for each row of the first (`baseline`) and each validation or test trial (`side`), the
    share of correctly classified windows; copies are one trial, the first of them.
    """
    groups = [list({cell.spikes_name: cell for cell in group}.values()) for group in by_split(cells)]
    fitted_rows = []
    with track("baselines", sum(map(len, groups))) as advance:
        for group in groups:
            for cell in group:
                fitted_rows += _fitted(folder, recordings, study, cell, cells, is_first=cell is group[0])
                advance(1, "")
    shares = [row.pop(opponents.RIGHT) for row in fitted_rows]
    trials = [
        (row, side, *pair)
        for row, sides in enumerate(shares)
        for side, by_trial in sides.items()
        for pair in by_trial.items()
    ]
    return pd.DataFrame(fitted_rows), pd.DataFrame(trials, columns=["baseline", "side", "trial", "right"])


def _fitted(
    folder: Path, recordings: Recordings, study: StudySpec, cell: Cell, cells: Sequence[Cell], *, is_first: bool
) -> Iterator[dict[str, Any]]:
    """Rows of `baselines.csv` on the spikes of one cell, the only spikes in memory; if `is_first`, also on signals."""
    trains, split = hdf5.load_spikes(folder / cell.given), {key: value_at(cell, key) for key in split_columns(study)}
    task = task_of(cell).model_copy(update={"subset": {}})
    parts, last = tasks.trials_of(trains, task), tasks.with_every_condition(trains, task)
    every, first = trains.with_variations(), copies_of(trains).first
    if trains.variations is not None:  # the trial of a varied copy is that of which it is one
        first = np.concatenate([first, first[trains.variations.of]])
    windows, labels = every.cut(cells[0].window), class_indices(every.conditions)
    pieces = pieces_with_copies(recordings, windows, trains, cell) if is_first and trains.variations else ()
    first_ms, second_ms = t_ref_pair_ms(cell.encoder)
    pair = second_ms, first_ms
    for name, where in {cell.dataset: cell.subset for cell in cells}.items():
        cut = partial(opponents.cuts_of, every.conditions, windows, trains.sampling_rate_Hz, subset=where)
        cuts = with_training(cut(parts), trains, cell, parts)
        if last is not None:
            known = tasks.trials_of(trains, last)
            cuts = cuts._replace(last=with_training(cut(known), trains, cell, known))
        of_signals = opponents.signal_inputs(recordings, cuts, study.baselines, pieces) if is_first else ()
        counts = {"is_first": is_first, "encoding": study.encoding_in == "processor"}
        of_spikes = opponents.spike_inputs(every, pair, cuts, study.baselines, **counts)
        of_spikes = () if study.baselines == "linear" else of_spikes
        for row in opponents.rows(chain(of_signals, of_spikes), labels[windows.trial], cuts):
            is_of_spikes = row["t_ref_ra_ms"] is not None
            encoder = {key: value_at(cell, key) if is_of_spikes else None for key in encoder_columns(study)}
            own = row[opponents.RIGHT].items()
            touches = {side: paired.by_trial(first[[*shares]], [*shares.values()]) for side, shares in own}
            yield {"dataset": name, **split, **row, **encoder, opponents.RIGHT: touches}


def _reconstruction_table(
    folder: Path, recordings: Recordings, study: StudySpec, cells: Sequence[Cell]
) -> pd.DataFrame:
    """A row for each encoding: what its spikes give back of the signals of test trials.

    Columns: the t_ref pair, swept keys of the split and of the encoder, snr_dB, bits_per_s and bits_per_spike.
    """
    distinct, keys = {cell.spikes_name: cell for cell in cells}, [*split_columns(study), *encoder_columns(study)]
    rows = []
    with track("reconstruction", len(distinct)) as advance:
        for cell in distinct.values():
            trains = hdf5.load_spikes(folder / cell.given)
            sides = tasks.trials_of(trains, task_of(cell).model_copy(update={"subset": {}}))
            measured = regained.regained(recordings, trains, sides, start_s=cell.window.start_ms * 1e-3)
            own = {key: value_at(cell, key) for key in keys}
            rows.append({**encoded.periods(cell), **own, **measured._asdict()})
            advance(1, "")
    return pd.DataFrame(rows)


def pieces_with_copies(recordings: Recordings, windows: Windows, trains: SpikeTrains, cell: Cell) -> list[np.ndarray]:
    """The samples of each window of the recorded trials, then of those of their varied copies."""
    assert cell.augmentation is not None
    of_recorded = windows.trial < len(trains)
    recorded = Windows(windows.trial[of_recorded], windows.start[of_recorded], windows.n_steps)
    pieces = [*opponents.pieces_of(recordings, recorded, trains.sampling_rate_Hz)]
    before = len(trains)
    for copies in varied_copies(copied_part(recordings, cell), cell.augmentation):
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
    for kind in robust.candidates(cell.augmentation, trains.conditions, cell.split):
        rows = trains.variations.rows(parts.train, kind)
        rows = rows[np.isin(trains.variations.of[rows], cuts.windows.trial[known])]
        made[kind] = cuts.sides[0] | np.isin(cuts.windows.trial, len(trains) + rows)
    if not robust.are_unranked([*made], trains.conditions, cell.split):
        return cuts._replace(copies=made)
    rows = trains.variations.rows(parts.validation, next(iter(made)))
    validation = cuts.sides[1] | np.isin(cuts.windows.trial, len(trains) + rows)
    return cuts._replace(copies=made, sides=(cuts.sides[0], validation, cuts.sides[2]))


def _by_source(cells: Iterable[Cell]) -> list[list[Cell]]:
    """Groups of cells with the same recordings: one group unless the study sweeps its simulation."""
    groups: dict[str, list[Cell]] = {}
    for cell in cells:
        groups.setdefault(digest(cell.source), []).append(cell)
    return list(groups.values())


def encoded_part(recordings: Recordings, cell: Cell) -> Recordings:
    """The trials as far as a cell encodes them."""
    return recordings if cell.encoded_ms is None else until(recordings, cell.encoded_ms)


def copied_part(recordings: Recordings, cell: Cell) -> Recordings:
    """The trials as far as the windows of their varied copies reach; the whole trials if these begin at an onset."""
    end_ms = reach_ms(cell)
    return recordings if end_ms is None or cell.augmentation is None else until(recordings, end_ms)


def _check_windows(recordings: Recordings, cells: Iterable[Cell]) -> None:
    """InputError if a window is longer than the shortest trial, before anything is calibrated or encoded."""
    rate_Hz, shortest = recordings.sampling_rate_Hz, int(recordings.lengths.argmin())
    for cell in cells:
        if cell.network is not None:
            own_Hz = (cell.calibrate or cell.encoder).conditioning.resample_Hz
            clock_Hz = own_Hz or (rate_Hz if cell.calibrate is None else max(rate_Hz, CLOCK_HZ))
            n_steps = conditioned_length(int(recordings.lengths[shortest]), rate_Hz, clock_Hz)
            check_fit(np.array([n_steps]), clock_Hz, cell.window, np.array([shortest]))


def _encode(folder: Path, study: StudySpec, cells: list[Cell], recordings: Recordings, content: str) -> None:
    """Write the missing spike trains of cells with the same recordings, and their tables.

    content: hash of the study's first set of recordings, which identifies the whole folder of spikes: the same code
    simulates the other sets, and they changed if and only if the first set did.
    """
    target, made_from = folder / "spikes", {"recordings": content}
    distinct = {cell.spikes_name: cell for cell in cells}
    missing = [cell for cell in distinct.values() if store.flaws(target, _encoded(cell), made_from)]
    if missing:
        _check_windows(recordings, cells)
    calibrated: dict[str, EncoderSpec] = {}
    for cell in missing:
        with store.timed(folder, "calibrate"):
            encoder = encoder_of(cell, recordings, calibrated)
        with store.timed(folder, "encode"):
            trains = encode_recordings(
                recordings, encoder, augmentation=cell.augmentation, copied=copied_part(recordings, cell)
            )
            table = encoded.encoding_table(trains, cell, study.dataset.stratify)
            write_table(table, target / f"{cell.spikes_name}.csv")
            if not study.reconstruction:  # which compares longer stretches
                trains = _used(trains, [one for one in cells if one.given == cell.given])
            hdf5.save_spikes(trains, folder / cell.given)
            store.seal(target, _encoded(cell), made_from)


def _used(trains: SpikeTrains, cells: Iterable[Cell]) -> SpikeTrains:
    """The spikes that cells use: up to the end of the last window, or all where one of them has no network.

    A recording may be much longer than its windows, and its spikes take more of the disk than it does.
    """
    if any(cell.network is None for cell in cells):
        return trains
    windows = (window for task in map(task_of, cells) for window in (task.window, task.training_window))
    return trains.until(*{window.digest(): window for window in windows}.values())


def tables_of(study: StudySpec) -> list[str]:
    """The tables of its recordings that a study requests, before any cell is run."""
    wanted = {
        **dict.fromkeys(BASELINES, study.baselines != "none"),
        RECONSTRUCTION: study.reconstruction,
        "signals.csv": study.signals,
        "same_drive.csv": study.same_drive is not None,
    }
    return [name for name, is_asked in wanted.items() if is_asked]


def check(folder: Path, study: StudySpec, cells: Iterable[Cell]) -> None:
    """Raise InputError if the encodings of a run folder or the study's tables were changed."""
    distinct = {cell.spikes_name: cell for cell in cells}
    written = [f"spikes/{name}" for cell in distinct.values() for name in _encoded(cell)]
    store.check(folder, [DATA, *tables_of(study), *written])


def _encoded(cell: Cell) -> list[str]:
    """The files of an encoding in `spikes`, which differ only in their suffix."""
    return [f"{cell.spikes_name}.csv", f"{cell.spikes_name}.h5"]


def encoder_of(
    cell: Cell,
    recordings: Recordings,
    calibrated: dict[str, EncoderSpec],
    *,
    between: bool = True,
    tell: bool = True,
) -> EncoderSpec:
    """The cell's encoder, with gains fitted on the training trials if the study calibrates.

    calibrated: what was fitted for other cells. If unknown conditions are tested, only training trials of the cell's
    own subset are used: gains must not depend on the other conditions.
    between: whether calibration chooses between the conditions that the split tests, and not within them. tell: log its
    notes.
    """
    if cell.calibrate is None:
        return cell.encoder
    known = cell.subset if cell.test_every_condition else {}
    apart = tuple(cell.split.test_where) if between else ()

    def fitted(start: EncoderSpec, spikes_per_s: float | None) -> EncoderSpec:
        key = digest([start.model_dump(mode="json"), cell.split.model_dump(), known, spikes_per_s])
        if key not in calibrated:
            train = training_touches(recordings, cell.source["stratify"], cell.split)
            train = np.intersect1d(train, np.flatnonzero(select_conditions(recordings.conditions, known)))
            training = recordings.select(train)
            if cell.split.folds:  # each fold has its own encoder, and its notes name the fold
                training = replace(training, source=f"{recordings.source}, fold {cell.split.fold}")
            fit, _ = calibration_for(start, {}, **{choice: getattr(cell, choice) for choice in CHOICES}, apart=apart)
            rule = CalibrationRule(spikes_per_s=spikes_per_s)
            calibrated[key] = fit(training, start, rule=rule, tell=tell).encoder
        return calibrated[key]

    start = cell.calibrate
    if cell.conditioned_by is not None:
        chosen = fitted(cell.conditioned_by, None).conditioning
        same = {"baseline": chosen.baseline, "ema_cutoff_Hz": chosen.ema_cutoff_Hz}
        start = start.model_copy(update={"conditioning": start.conditioning.model_copy(update=same)})
    return with_t_refs(fitted(start, cell.spikes_per_s), cell.encoder)


def _source(dataset: DatasetSpec) -> str | None:
    """The fingerprint of the file or folder that a study reads; None if it simulates, or if the file does not exist."""
    return store.fingerprint(expand(dataset.source)) if dataset.simulate is None else None


def _content(recordings: Recordings) -> str:
    """The SHA-256 of the signals and the conditions."""
    content = hashlib.sha256()
    for signal in recordings.signals:
        content.update(np.ascontiguousarray(signal).tobytes())
    content.update(json.dumps(recordings.conditions.astype(str).values.tolist()).encode())
    return content.hexdigest()


def _check_unchanged(folder: Path, recordings: Recordings, before: Mapping[str, Any] | None, source: str | None) -> str:
    """The hash of the recordings, which must be the same as at the start of the study; writes data.json.

    before: the earlier content of data.json; None if it is missing or damaged. source: of `_source`.
    """
    entry = {"sha256": _content(recordings), "trials": len(recordings), "classes": list(recordings.classes)}
    if before is not None and {key: before[key] for key in entry} != entry:
        raise InputError(f"{folder}: the recordings changed since this study began; run it in another folder")
    write_json(folder / DATA, entry | ({"source": source} if source is not None else {}))
    store.seal(folder, [DATA])
    return entry["sha256"]
