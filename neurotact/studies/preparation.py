"""Shared inputs of a study's cells: recordings, their split, the spike trains of every swept encoder."""

import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from neurotact import plugins
from neurotact.baselines.opponents import RIGHT
from neurotact.data import hdf5
from neurotact.data.augmentation import check_taxels
from neurotact.data.conditioning import conditioned_length
from neurotact.data.dataset import DatasetSpec, expand, load_recordings
from neurotact.data.digests import content_digest
from neurotact.data.recordings import Recordings
from neurotact.data.spikes import SpikeTrains
from neurotact.data.windows import check_fit
from neurotact.encoders.calibration import calibration_for
from neurotact.encoders.encoding import encode_recordings
from neurotact.encoders.gain_search import CalibrationRule
from neurotact.encoders.model import EncoderSpec
from neurotact.encoders.specs import with_t_refs
from neurotact.errors import InputError
from neurotact.files import write_json
from neurotact.networks.training.tasks import to_calibrate
from neurotact.progress import at, counting
from neurotact.spec import digest
from neurotact.studies import encoding_tables, measures, store, tables_beside
from neurotact.studies.cell import task_of
from neurotact.studies.store import DATA
from neurotact.studies.study import (
    CHOICES,
    Cell,
    StudySpec,
)
from neurotact.studies.study import cells as cells_of
from neurotact.tables import write_table


def dataset_of(study: StudySpec, cell: Cell) -> DatasetSpec:
    """The data set of a cell: the study's, with the cell's swept parameters of the simulation."""
    return study.dataset.model_copy(update={"parameters": cell.source["parameters"]})


def recordings_of(study: StudySpec, cell: Cell) -> Recordings:
    """The recordings of a cell; few long ones are cut in time, where events are learned."""
    return _recordings(dataset_of(study, cell), task_of(cell).detects)


def _recordings(dataset: DatasetSpec, detects: bool) -> Recordings:
    recordings = load_recordings(dataset)
    return plugins.load_function("tools", "parts_of_recordings")(recordings) if detects else recordings


MOST_AT_ONCE = 2**28
"""Bytes of windows and of their features up to which several processes fit classifiers; each takes a few times more."""
MINIROCKET = 10_000
"""Features of the classifier that has most."""


def rows_beside(
    folder: Path, study: StudySpec, cell: Cell, cells: Sequence[Cell], is_first: bool
) -> list[tuple[dict[str, Any], dict[str, Any]]]:
    """The rows of classifiers, as `tables_beside.rows_of`, each with its shares of correct windows by side, trial."""
    first, detects = cells[0], task_of(cells[0]).detects
    recordings = _recordings_once(dataset_of(study, first).model_dump_json(), detects)
    recordings = encoded_part(recordings, *cells_of(study))
    rows = tables_beside.rows_of(folder, recordings, study, cell, cells, is_first=is_first)
    return [(row, row.pop(RIGHT)) for row in rows]


@lru_cache(maxsize=1)
def _recordings_once(dataset: str, detects: bool) -> Recordings:
    """The recordings, read once in a process that fits many classifiers."""
    return _recordings(DatasetSpec.model_validate_json(dataset), detects)


def _fit_at_once(recordings: Recordings, cell: Cell) -> bool:
    """Whether the windows of a cell are so few that several processes can fit classifiers on them.

    Not by `steps_of`: windows of the encoder's clock may be shorter than a sample of the recordings.
    """
    rate_Hz, (window, _) = recordings.sampling_rate_Hz, tables_beside.windows_of(cell)
    hop = (window.hop_ms or window.length_ms) * 1e-3 * rate_Hz
    n_windows = np.minimum(recordings.lengths // hop + 1, window.per_trial or np.inf).sum()
    return 8 * n_windows * (window.length_ms * 1e-3 * rate_Hz * recordings.n_channels + MINIROCKET) <= MOST_AT_ONCE


def prepare(folder: Path, study: StudySpec, cells: list[Cell]) -> bool:
    """Write missing and damaged files: `folder/spikes`, its encoding tables, and the tables of the study's measures.

    Returns whether the windows are so few that several processes can fit classifiers on them at once.
    A line on stderr names each damaged file. Raises InputError if the recordings changed since the study started.
    """
    target = folder / "spikes"
    table_flaws = store.flaws(folder, [DATA, *tables_beside.names(study)])
    spikes_flaws = store.flaws(target, _encodings(cells))
    store.say_flaws("", table_flaws, "written again")
    store.say_flaws(f"{target.name}/", spikes_flaws, "encoded again")
    at("read")
    source = _source(study.dataset)
    before = store.sound_json(folder, DATA)
    is_same = before is not None and (source is None or source == before.get("source"))
    if is_same and not (table_flaws or spikes_flaws):
        return True
    first, *others = _by_source(cells)
    with store.timed(folder, "read"):
        recordings = recordings_of(study, first[0])
    for cell in cells:
        check_taxels(cell.augmentation, recordings.n_channels)
    content = _check_unchanged(folder, recordings, before, source)
    recordings = encoded_part(recordings, *cells)
    _encode(folder, study, first, recordings, content)
    for group in others:  # only one set of recordings is in memory
        if not spikes_flaws.keys().isdisjoint(_encodings(group)):
            _encode(folder, study, group, encoded_part(recordings_of(study, group[0]), *cells), content)
    tables_beside.write(folder, study, cells, recordings, table_flaws)
    return _fit_at_once(recordings, cells[0])


def _by_source(cells: Iterable[Cell]) -> list[list[Cell]]:
    """Groups of cells with the same recordings: one group unless the study sweeps its simulation."""
    groups: dict[str, list[Cell]] = {}
    for cell in cells:
        groups.setdefault(digest(cell.source), []).append(cell)
    return list(groups.values())


def encoded_part(recordings: Recordings, *cells: Cell) -> Recordings:
    """The trials as far as the cells of a study encode them."""
    return recordings if cells[0].encoded_ms is None else tables_beside.copied_part(recordings, *cells)


def _check_windows(recordings: Recordings, cells: Iterable[Cell]) -> None:
    """InputError if a window is longer than too many trials, before anything is calibrated or encoded."""
    rate_Hz, lengths = recordings.sampling_rate_Hz, recordings.lengths.tolist()
    for cell in cells:
        if cell.network is not None:
            clock_Hz = cell.clock_Hz(rate_Hz)
            n_steps = np.array([conditioned_length(n_samples, rate_Hz, clock_Hz) for n_samples in lengths])
            check_fit(n_steps, clock_Hz, cell.window)


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
            trains = spikes_of(cell, recordings, encoder, cells)
            table = encoding_tables.encoding_table(trains, cell, study.dataset.stratify)
            write_table(table, target / f"{cell.spikes_name}.csv")
            if not any(one.needs_whole_trials for one in measures.requested(study.measures).values()):
                trains = _used(trains, [one for one in cells if one.given == cell.given])
            hdf5.save_spikes(trains, folder / cell.given)
            store.seal(target, _encoded(cell), made_from)


def _used(trains: SpikeTrains, cells: Iterable[Cell]) -> SpikeTrains:
    """The spikes that cells use: up to the end of the last window, or all where one has no network, or no windows.

    A recording may be much longer than its windows, and its spikes take more of the disk than it does.
    """
    if any(cell.network is None or task_of(cell).detects for cell in cells):
        return trains
    windows = (window for task in map(task_of, cells) for window in (task.window, task.training_window))
    return trains.until(*{window.digest(): window for window in windows}.values())


def check(folder: Path, study: StudySpec, cells: Iterable[Cell]) -> None:
    """Raise InputError if the encodings of a run folder or the study's tables were changed."""
    store.check(folder, [DATA, *tables_beside.names(study), *(f"spikes/{name}" for name in _encodings(cells))])


def _encodings(cells: Iterable[Cell]) -> list[str]:
    """The files of the encodings of cells, each once."""
    return [name for cell in {cell.spikes_name: cell for cell in cells}.values() for name in _encoded(cell)]


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
    known, task = cell.subset if cell.test_every_condition else {}, task_of(cell)
    choices: dict[str, Any] = {choice: getattr(cell, choice) for choice in CHOICES}
    choices |= {"apart": tuple(cell.split.test_where) if between else (), "group": cell.split.group}

    def fitted(start: EncoderSpec, spikes_per_s: float | None) -> EncoderSpec:
        key = digest([start.model_dump(mode="json"), cell.split.model_dump(), known, spikes_per_s, choices])
        if key not in calibrated:
            training = to_calibrate(recordings, task, known)
            if cell.split.folds:  # each fold has its own encoder, and its notes name the fold
                training = replace(training, source=f"{recordings.source}, fold {cell.split.fold}")
            fit, times = calibration_for(start, {}, **choices)
            rule = CalibrationRule(spikes_per_s=spikes_per_s)
            progress = counting("calibrate", times * rule.candidates)
            calibrated[key] = fit(training, start, rule=rule, tell=tell, progress=progress).encoder
        return calibrated[key]

    start = cell.calibrate
    if cell.conditioned_by is not None:
        chosen = fitted(cell.conditioned_by, None).conditioning
        same = {"baseline": chosen.baseline, "ema_cutoff_Hz": chosen.ema_cutoff_Hz}
        start = start.model_copy(update={"conditioning": start.conditioning.model_copy(update=same)})
    return with_t_refs(fitted(start, cell.spikes_per_s), cell.encoder)


def spikes_of(cell: Cell, recordings: Recordings, encoder: EncoderSpec, cells: Iterable[Cell] = ()) -> SpikeTrains:
    """The spikes of a cell's trials and of their varied copies. encoder: of `encoder_of`.

    cells: all of these recordings, whose windows may differ.
    """
    copied = tables_beside.copied_part(recordings, cell, *cells)
    progress = counting("encode", len(recordings))
    return encode_recordings(recordings, encoder, progress, augmentation=cell.augmentation, copied=copied)


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


def _all_of(recordings: Recordings) -> str:
    """A digest of the trials with their rate, unit, lengths and taxels, and of their marks."""
    marks = None if recordings.marks is None else recordings.marks.astype(str).to_csv(index=False)
    return digest([content_digest(recordings), marks])


def _check_unchanged(folder: Path, recordings: Recordings, before: Mapping[str, Any] | None, source: str | None) -> str:
    """The hash of the recordings, which must be the same as at the start of the study; writes data.json.

    before: the earlier content of data.json; None if it is missing or damaged. source: of `_source`.
    """
    entry = {"sha256": _content(recordings), "trials": len(recordings), "classes": list(recordings.classes)}
    entry["digest"] = _all_of(recordings)  # of a run of an earlier version it is unknown
    if before is not None and {key: before.get(key, entry["digest"]) for key in entry} != entry:
        raise InputError(f"{folder}: the recordings changed since this study began; run it in another folder")
    write_json(folder / DATA, entry | ({"source": source} if source is not None else {}))
    store.seal(folder, [DATA])
    return entry["sha256"]
