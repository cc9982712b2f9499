"""Recordings and spike trains as HDF5 files.

Recordings: `signals/values` (all trials end to end, `(time, channel)`), `signals/lengths`, `conditions/<column>`.
Spike trains: `spikes/steps` and `spikes/units` (all trials end to end), `spikes/lengths`, `labels`, `trial_steps`,
`conditions/<column>`. Both: `marks/<column>`, where trials have any. Everything else is in the file's attributes.

Files of spikes without a `layout` have a row of variable length for each trial, as the Spiking Heidelberg Digits
(`spikes/times` in s, `spikes/units`): several times larger and slower to read.
"""

from __future__ import annotations

import json
import logging
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Self

import h5py
import numpy as np
from numpy.typing import ArrayLike

from neurotact import plugins
from neurotact.data import marks as annotations
from neurotact.data.augmentation import AugmentationSpec, CopiesWhenRead
from neurotact.data.hdf5_input import EVENTS, Declared, attribute, names, opened, table
from neurotact.data.hdf5_output import Output, create
from neurotact.data.recordings import (
    Recordings,
    Trials,
    check_channels,
    check_conditions,
    check_finite,
    check_sampling_rate,
    check_shape,
    chosen,
    class_indices,
)
from neurotact.data.spikes import SpikeTrains, StoredCopies, TrialSpikes, Variations
from neurotact.errors import InputError
from neurotact.files import check_size, whole
from neurotact.lazily import lazily
from neurotact.spec import build

with lazily():
    import pandas as pd


log = logging.getLogger("neurotact")

PACKED: dict[str, Any] = {"chunks": True, "compression": "gzip", "compression_opts": 1, "shuffle": True}
"""How spikes are compressed, and samples of which copies are made: the fastest that is near their entropy."""
LEAST_PACKED = 4096
"""Bytes of a column that is not compressed, as the tables of a compressed one take as many."""
LAYOUT, CHUNK = 2, (2**15,)
"""Of files of spikes: the number of their form, and the spikes that are compressed together."""
FLUSHED_SPIKES, FLUSHED_TRIALS = 100_000, 1000
"""Spikes or trials that are collected before they are written."""


def save_recordings(recordings: Recordings, path: str | Path) -> None:
    """Write recordings to `path`, whole or not at all."""
    with whole(path) as draft, create(draft) as (file, output):
        file.attrs["kind"] = "recordings"
        file.attrs["source"] = recordings.source
        _write_recordings(file, recordings, output)
        _write_marks(file, recordings.marks)


def _write_recordings(group: h5py.Group, recordings: Recordings, output: Output, **packed: Any) -> None:
    """Everything of recordings but their source; packed: how their samples are compressed."""
    group.attrs["sampling_rate_Hz"] = recordings.sampling_rate_Hz
    group.attrs["unit"] = recordings.unit
    group.attrs["channels"] = json.dumps(recordings.channels)
    lengths = recordings.lengths
    values = group.create_dataset("signals/values", (lengths.sum(), recordings.n_channels), np.float32, **packed)
    start = 0
    for signal in recordings.signals:
        values[start : start + len(signal)] = signal
        start += len(signal)
        output.check()
    _write_column(group, "signals/lengths", lengths)
    _write_table(group.create_group("conditions"), recordings.conditions)


@dataclass(frozen=True, eq=False)
class StoredRecordings(Trials):
    """Recordings in an open file; signals are read on demand (`open_recordings`).

    values: all trials end to end, `(sample, channel)`.
    numbers, starts, stored_lengths: for each trial, its number in the file, its first sample in `values`, its length.
    columns: of `values`, in the order of `channels`; None: as they are stored.
    The others are as in `Recordings`. Samples are checked when they are read.
    """

    values: h5py.Dataset
    numbers: np.ndarray
    starts: np.ndarray
    stored_lengths: np.ndarray
    sampling_rate_Hz: float
    unit: str
    conditions: pd.DataFrame
    channels: tuple[str, ...]
    source: str
    columns: tuple[int, ...] | None = None
    marks: pd.DataFrame | None = None

    @property
    def lengths(self) -> np.ndarray:
        return self.stored_lengths

    def piece(self, trial: int, start: int, stop: int) -> np.ndarray:
        start, stop, _ = slice(start, stop).indices(int(self.stored_lengths[trial]))
        signal = np.empty((max(0, stop - start), self.n_channels), np.float32)
        self._read(self.starts[trial] + start, signal)
        check_finite(signal, self.numbers[trial], self.channels, self.source, start)
        return signal

    def loaded(self) -> Recordings:
        check_size(self.source, 4 * sum(self.stored_lengths.tolist()) * self.n_channels)
        signals = np.empty((self.stored_lengths.sum(), self.n_channels), np.float32)
        ends = np.cumsum(self.stored_lengths)
        for first, last in self._runs():
            begin = ends[first] - self.stored_lengths[first]
            self._read(self.starts[first], signals[begin : ends[last]])
        trials = np.split(signals, ends[:-1])
        if not np.isfinite(signals).all():
            for number, signal in zip(self.numbers, trials, strict=True):
                check_finite(signal, number, self.channels, self.source)
        is_equal = (self.stored_lengths == self.stored_lengths[0]).all()
        return Recordings(
            signals=signals.reshape(len(trials), -1, self.n_channels) if is_equal else trials,
            sampling_rate_Hz=self.sampling_rate_Hz,
            unit=self.unit,
            conditions=self.conditions,
            channels=self.channels,
            source=self.source,
            marks=self.marks,
        )

    def select(self, keep: ArrayLike) -> Self:
        index = chosen(keep, len(self))
        return replace(
            self,
            numbers=self.numbers[index],
            starts=self.starts[index],
            stored_lengths=self.stored_lengths[index],
            conditions=self.conditions.iloc[index].reset_index(drop=True),
            marks=annotations.selected(self.marks, index),
        )

    def of_taxels(self, order: Sequence[int]) -> Self:
        stored = range(self.n_channels) if self.columns is None else self.columns
        names = tuple(self.channels[index] for index in order)
        return replace(self, channels=names, columns=tuple(stored[index] for index in order))

    def _runs(self) -> Iterator[tuple[int, int]]:
        """First and last of each run of adjacent trials, which is read at once."""
        ends = self.starts + self.stored_lengths
        begins = [0, *(np.flatnonzero(self.starts[1:] != ends[:-1]) + 1).tolist(), len(self)]
        yield from ((first, after - 1) for first, after in pairwise(begins))

    def _read(self, start: int, out: np.ndarray) -> None:
        """Fill `out`, `(sample, channel)`, with the samples from number `start` on."""
        if not len(out):
            return
        try:
            self.values.read_direct(out, np.s_[int(start) : int(start) + len(out)])
        except (OSError, RuntimeError) as error:
            raise InputError(f"{self.source}: cannot be read ({error}); it is damaged, write it again") from error
        if self.columns is not None:
            out[:] = out[:, self.columns]


@contextmanager
def open_recordings(path: str | Path) -> Iterator[StoredRecordings]:
    """Recordings whose signals are read on demand, for files of any size; valid while the file is open.

    Raises InputError for a file that is truncated, not HDF5 or of another kind, or declares far more than it holds.
    """
    with opened(path, "recordings") as (file, _):
        yield _stored(Declared(file, path), str(path))


def load_recordings(path: str | Path) -> Recordings:
    """Read recordings into memory; InputError as in `open_recordings`, and above the limit on one input."""
    with opened(path, "recordings") as (file, _):
        return _recordings(Declared(file, path))


def _recordings(declared: Declared, within: str = "") -> Recordings:
    return _stored(declared, str(declared.path), within).loaded()


def _stored(declared: Declared, path: str, within: str = "") -> StoredRecordings:
    """Recordings of a file; within: of a group in it, as in `copied/`."""
    file = declared.group(within.rstrip("/")) if within else declared.file
    lengths = declared.numbers(f"{within}signals/lengths", "iu")
    if not len(lengths):
        raise InputError(f"{path}: holds no trial; give at least one")
    values = declared.streamed(f"{within}signals/values")
    n_expected = sum(lengths.tolist())
    if n_expected != len(values) or lengths.min() < 0:
        raise InputError(f"{path}: holds {len(values)} samples of {n_expected}; it is damaged, write it again")
    lengths = lengths.astype(np.int64)
    rate_Hz = float(attribute(file, "sampling_rate_Hz", path))
    check_sampling_rate(rate_Hz, path)
    channels = names(attribute(file, "channels", path))
    check_channels(channels, path)
    for trial in (0, int(lengths.argmin())):
        check_shape((int(lengths[trial]), *values.shape[1:]), trial, len(channels), path)
    conditions = _read_table(declared, f"{within}conditions", len(lengths))
    check_conditions(conditions, path)
    return StoredRecordings(
        values=values,
        numbers=np.arange(len(lengths)),
        starts=np.cumsum(lengths) - lengths,
        stored_lengths=lengths,
        sampling_rate_Hz=rate_Hz,
        unit=str(attribute(file, "unit", path)),
        conditions=conditions,
        channels=channels,
        source=path,
        marks=None if within else annotations.checked(_read_marks(declared), lengths / rate_Hz, path),
    )


class _SpikeWriter:
    """Writes a spikes file one trial after the other (`spike_writer`).

    `n_spikes` and `n_steps` count what is written, over all trials.
    """

    def __init__(self, file: h5py.File, output: Output) -> None:
        self.n_spikes = self.n_steps = 0
        self.trial_steps: list[int] = []
        self.trial_spikes: list[int] = []
        self.trial_digests: list[str] = []
        self.trial_touches: list[str] = []
        self._output = output
        self._waiting: list[TrialSpikes] = []
        self._waiting_spikes = 0
        endless = {"shape": (0,), "maxshape": (None,), **PACKED, "chunks": CHUNK}
        self._steps = file.create_dataset("spikes/steps", dtype=np.int64, **endless)
        self._units = file.create_dataset("spikes/units", dtype=np.uint16, **endless)

    def append(self, trial: TrialSpikes) -> None:
        """Write the next trial; OSError where the disk does not take it."""
        self._waiting.append(trial)
        self.trial_steps.append(trial.n_steps)
        self.trial_spikes.append(len(trial.steps))
        self.trial_digests.append(trial.digest)
        self.trial_touches.append(trial.touch or trial.digest)
        self.n_steps += trial.n_steps
        self.n_spikes += len(trial.steps)
        self._waiting_spikes += len(trial.steps)
        if self._waiting_spikes >= FLUSHED_SPIKES or len(self._waiting) >= FLUSHED_TRIALS:
            self.flush()

    def flush(self) -> None:
        """Write the collected spikes and trials."""
        if self._waiting_spikes:
            for stored, name in ((self._steps, "steps"), (self._units, "units")):
                stored.resize((self.n_spikes,))
                stored[-self._waiting_spikes :] = np.concatenate([getattr(trial, name) for trial in self._waiting])
        self._waiting, self._waiting_spikes = [], 0
        self._output.check()


@contextmanager
def spike_writer(
    path: str | Path,
    conditions: pd.DataFrame,
    sampling_rate_Hz: float,
    afferents: tuple[str, ...],
    encoder: Any,
    source: str,
    touch_s: float | None = None,
    variations: Variations | None = None,
    recorded_Hz: float | None = None,
    marks: pd.DataFrame | None = None,
    until_s: float | None = None,
) -> Iterator[_SpikeWriter]:
    """Write a spikes file to `path`, whole or not at all: the block appends one trial for each row of `conditions`.

    variations: varied copies, of which the recordings are written and not the spikes, unless these are in memory: then
    they are of the last rows. recorded_Hz: of the recordings. marks: of the trials. until_s: as of `SpikeTrains`.

    >>> import tempfile
    >>> path = Path(tempfile.mkdtemp()) / "spikes.h5"
    >>> with spike_writer(path, pd.DataFrame({"label": ["felt"]}), 1000.0, ("SA-I a", "RA-I a"), {}, "") as writer:
    ...     writer.append(TrialSpikes(np.array([1, 3]), np.array([0, 1]), 10))
    >>> load_spikes(path).steps[0].tolist()
    [1, 3]
    """
    with whole(path) as draft, create(draft) as (file, output):
        file.attrs["kind"], file.attrs["layout"] = "spikes", LAYOUT
        file.attrs["sampling_rate_Hz"] = sampling_rate_Hz
        file.attrs["dt_s"] = 1.0 / sampling_rate_Hz
        file.attrs["afferents"] = json.dumps(afferents)
        file.attrs["encoder"] = json.dumps(encoder)
        file.attrs["source"] = _beside(Path(path), source)
        if touch_s is not None:
            file.attrs["touch_s"] = touch_s
        if recorded_Hz is not None:
            file.attrs["recorded_Hz"] = recorded_Hz
        if until_s is not None:
            file.attrs["until_s"] = until_s
        writer = _SpikeWriter(file, output)
        yield writer
        writer.flush()
        if len(writer.trial_steps) != len(conditions):
            raise ValueError(f"{len(writer.trial_steps)} trials were written for {len(conditions)} rows of conditions")
        _write_column(file, "spikes/lengths", np.array(writer.trial_spikes, np.int64))
        _write_column(file, "labels", class_indices(conditions))
        if variations is not None:
            _write_column(file, "variation_of", variations.of.astype(np.int64))
            if isinstance(variations.source, CopiesWhenRead):
                _write_column(file, "variation_place", variations.places)
                file.attrs["variation"] = variations.source.spec.model_dump_json()
                _write_recordings(file.create_group("copied"), variations.source.recordings, output, **PACKED)
            else:
                _write_column(file, "variation_kind", np.array(variations.kind, dtype="S"))
        _write_column(file, "trial_steps", np.array(writer.trial_steps, np.int64))
        if all(writer.trial_digests):
            _write_column(file, "trial_digests", np.array(writer.trial_digests, dtype="S"))
            if writer.trial_touches != writer.trial_digests:
                _write_column(file, "trial_touches", np.array(writer.trial_touches, dtype="S"))
        _write_table(file.create_group("conditions"), conditions)
        _write_marks(file, marks)


def source_of(path: str | Path) -> str:
    """The recordings that a file of spikes names, as it names them: a path relative to the file; empty if none."""
    with opened(path, "spikes", EVENTS) as (file, kind):
        return str(attribute(file, "source", path)) if kind == "spikes" else ""


def _beside(path: Path, source: str) -> str:
    """A source that is a path of a file, from the current folder, as a path from the folder of the file at `path`."""
    is_path = source and not os.path.isabs(source) and os.path.isfile(source)
    return os.path.relpath(source, path.parent) if is_path else source


def _from_here(path: str | Path, source: str) -> str:
    """A source that is a path of a file, from the folder of the file at `path`, as a path from the current folder."""
    beside = Path(path).parent / source
    return str(beside) if source and os.path.isfile(beside) else source


def save_spikes(trains: SpikeTrains, path: str | Path) -> None:
    """Write spike trains to `path`, whole or not at all."""
    made = trains.variations is not None and isinstance(trains.variations.source, CopiesWhenRead)
    every = trains if made else trains.with_variations()
    about = (every.conditions, trains.sampling_rate_Hz, trains.afferents, trains.encoder, trains.source)
    more = (trains.touch_s, trains.variations, trains.recorded_Hz, trains.marks, trains.until_s)
    with spike_writer(path, *about, *more) as writer:
        for trial in (*trains.trials(), *([*every.trials()][len(trains) :])):
            writer.append(trial)


def kind_of(path: str | Path) -> str:
    """The kind of a file: "recordings", "spikes", or "events" of the Heidelberg layout; InputError as in `load`."""
    with opened(path, "recordings", "spikes", EVENTS) as (_, kind):
        return kind


def load(path: str | Path) -> Recordings | SpikeTrains:
    """Read recordings or spike trains, whichever the file declares; InputError as for either."""
    read = {"recordings": _recordings, "spikes": _spikes, EVENTS: _events}
    with opened(path, *read) as (file, kind):
        return read[kind](Declared(file, path))


def load_spikes(path: str | Path) -> SpikeTrains:
    """Read spike trains; InputError for a file that is truncated, not HDF5, of another kind or too large.

    A file in the layout of the Spiking Heidelberg Digits is read as it is published, on a clock of 1 ms.
    """
    with opened(path, "spikes", EVENTS) as (file, kind):
        return (_spikes if kind == "spikes" else _events)(Declared(file, path))


def encoded_by(path: str | Path) -> tuple[tuple[str, ...], dict[str, Any], float, float | None]:
    """What made the spikes in a file: the afferents, the table of their encoder, and the steps of its clock per second.

    Last the samples of the recordings per second; None if unknown. The spikes are not read. Raises InputError as
    `load_spikes`.
    """
    with opened(path, "spikes") as (file, _):
        afferents, encoder = (attribute(file, name, path) for name in ("afferents", "encoder"))
        rate_Hz = float(attribute(file, "sampling_rate_Hz", path))
        return names(afferents), table(encoder, dict), rate_Hz, _recorded_Hz(file, path)


def _events(declared: Declared) -> SpikeTrains:
    log.warning("%s: its events are put on a clock of 1 ms; neurotact import events chooses another", declared.path)
    return plugins.load_function("tools", "heidelberg_spikes")(declared, {"merge_events": True})


def _recorded_Hz(file: h5py.File, path: str | Path) -> float | None:  # noqa: N802
    return float(attribute(file, "recorded_Hz", path)) if "recorded_Hz" in file.attrs else None


def _spikes(declared: Declared) -> SpikeTrains:
    file, path = declared.file, declared.path
    rate_Hz = float(attribute(file, "sampling_rate_Hz", path))
    check_sampling_rate(rate_Hz, str(path))
    trial_steps = declared.numbers("trial_steps")
    conditions = _read_table(declared, "conditions", len(trial_steps))
    steps, units = _events_of_trials(declared, rate_Hz)
    try:
        trains = SpikeTrains(
            steps=steps,
            units=units,
            trial_steps=trial_steps,
            sampling_rate_Hz=rate_Hz,
            afferents=names(attribute(file, "afferents", path)),
            conditions=conditions,
            encoder=table(attribute(file, "encoder", path), dict),
            source=_from_here(path, str(attribute(file, "source", path))),
            trial_digests=tuple(declared.texts("trial_digests")) if "trial_digests" in file else (),
            touch_s=float(attribute(file, "touch_s", path)) if "touch_s" in file.attrs else None,
            trial_touches=tuple(declared.texts("trial_touches")) if "trial_touches" in file else (),
            recorded_Hz=_recorded_Hz(file, path),
            marks=_read_marks(declared),
            until_s=float(attribute(file, "until_s", path)) if "until_s" in file.attrs else None,
        )
        return _with_variations(trains, declared) if "variation_of" in file else trains
    except InputError as error:
        raise InputError(f"{path}: {error}; write it again with neurotact encode") from error


def _with_variations(trains: SpikeTrains, declared: Declared) -> SpikeTrains:
    """Trials of a file with varied copies of them; in files of earlier versions, copies are the last trials."""
    of, made = declared.numbers("variation_of"), declared.holds("copied")
    n_trials = len(trains) - (0 if made else len(of))
    kind = declared.numbers("variation_place") if made else np.array(declared.texts("variation_kind"))
    if len(kind) != len(of) or n_trials < 1 or not ((of >= 0) & (of < n_trials)).all():
        raise InputError("variation_of and variation_kind must name a trial and a kind for each varied copy")
    if not made:
        stored = StoredCopies(trains.select(np.arange(n_trials, len(trains))))
        copies = Variations(stored, of, kind, np.arange(len(of)))
        return replace(trains.select(np.arange(n_trials)), variations=copies)
    table = json.loads(attribute(declared.file, "variation", declared.path))
    spec = build(AugmentationSpec, table, source="variation")
    source = CopiesWhenRead(_recordings(declared, "copied/"), trains.encoder, spec)
    n_places = len(source.recordings) * spec.copies * len(spec.kinds)
    if not ((kind >= 0) & (kind < n_places)).all():
        raise InputError(f"variation_place must be from 0 to {n_places - 1}, the varied copies of what is in copied")
    return replace(trains, variations=source.variations(of, kind))


def _events_of_trials(declared: Declared, rate_Hz: float) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Steps and afferents of the spikes of each trial, in a file of this or an earlier layout."""
    layout = int(attribute(declared.file, "layout", declared.path)) if "layout" in declared.file.attrs else 1
    if layout > LAYOUT:
        raise InputError(f"{declared.path}: has layout {layout}, of a later neurotact; update this one")
    if layout < LAYOUT:
        return [_steps(row, rate_Hz) for row in declared.rows("spikes/times", "f")], declared.rows("spikes/units", "iu")
    lengths = declared.numbers("spikes/lengths", "iu")
    every = [declared.numbers(f"spikes/{name}", "iu") for name in ("steps", "units")]
    n_expected = sum(lengths.tolist())
    if (lengths < 0).any() or any(len(values) != n_expected for values in every):
        found = " and ".join(str(len(values)) for values in every)
        raise InputError(f"{declared.path}: holds {found} spikes of {n_expected}; it is damaged, write it again")
    bounds = [*pairwise([0, *np.cumsum(lengths.astype(np.int64)).tolist()])]
    steps, units = ([values[first:after] for first, after in bounds] for values in every)
    return [of_trial.astype(np.int64, copy=False) for of_trial in steps], units


def _steps(times_s: np.ndarray, rate_Hz: float) -> np.ndarray:
    """The steps nearest to times; an invalid time becomes -1."""
    with np.errstate(over="ignore"):
        steps = np.rint(times_s * rate_Hz)
    return np.where(np.abs(steps) < 2.0**62, steps, -1).astype(np.int64)


def _write_table(group: h5py.Group, table: pd.DataFrame) -> None:
    group.attrs["columns"] = json.dumps([str(c) for c in table.columns])
    for column in table.columns:
        if str(column) in ("", ".") or "/" in str(column) or "\0" in str(column):
            raise InputError(f"condition {str(column)!r}: HDF5 cannot name a condition so; rename the column")
        values = table[column].to_numpy()
        if not (np.issubdtype(values.dtype, np.number) or values.dtype == bool):
            texts = np.char.encode(values.astype(str), "utf-8", "surrogateescape")
            values = texts.astype(h5py.string_dtype(length=max(1, texts.itemsize)))
        _write_column(group, str(column), values)


def _write_column(group: h5py.Group, name: str, values: np.ndarray) -> None:
    """Write a value for each trial; many are compressed."""
    group.create_dataset(name, data=values, **(PACKED if values.nbytes > LEAST_PACKED else {}))


def _read_table(declared: Declared, name: str, n_rows: int) -> pd.DataFrame:
    columns = names(attribute(declared.group(name), "columns", declared.path))
    if len(set(columns)) < len(columns):
        raise ValueError("a condition occurs twice in its table")
    return pd.DataFrame({column: declared.column(f"{name}/{column}", n_rows) for column in columns})


def _write_marks(file: h5py.File, marks: pd.DataFrame | None) -> None:
    if marks is not None:
        _write_table(file.create_group("marks"), marks)


def _read_marks(declared: Declared) -> pd.DataFrame | None:
    if "marks" not in declared.file:
        return None
    return _read_table(declared, "marks", len(declared.numbers("marks/trial", "iu")))
