"""STEMNIST: letters and digits that 34 people wrote on a skin of 16 x 16 taxels (Tripathi et al. 2026).

arXiv 2601.01658, Zenodo 10.5281/zenodo.19469535 (CC BY 4.0). `ProcessedSpikes` has a folder per character with a file
per sample, `<person>_<character>_<n>_spikes.h5`: `spikes`, records of `timestamp` in s, `taxel_id` from 1 and
`polarity`, -1 or 1. `RawCharacters` has a file per sample, `<person>_<character>_<n>.h5`: `pressure_data`, 240 frames
of 16 x 16 bytes. Both have 120 frames in a second and last 2 s.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from neurotact_parts.readers.events.spikes import BYTES_PER_EVENT, EventSpec, trains_with_ends
from neurotact_parts.readers.events.times import EventTimes, event_times

from neurotact.data.dataset import Reader
from neurotact.data.hdf5_input import Declared, attribute, reading
from neurotact.data.recordings import LABEL, Recordings
from neurotact.data.spikes import SpikeTrains
from neurotact.errors import InputError
from neurotact.files import check_size, existing, is_hidden
from neurotact.lazily import lazily

with lazily():
    import pandas as pd


SOURCE = "STEMNIST (doi 10.5281/zenodo.19469535)"
ARCHIVE, SPIKES, PRESSURE = "STEMNIST Dataset", "ProcessedSpikes", "RawCharacters"
"""The folder in the archive, and those in it."""
NAME = re.compile(r"([A-Z]{2})_([A-Z1-9])_(\d{1,4})", re.ASCII)
SIDE, RATE_HZ, LENGTH_S = 16, 120.0, 2.0
STEP_MS = 1e3 / RATE_HZ
FIELDS = ("timestamp", "taxel_id", "polarity")
AFFERENTS = tuple(f"{polarity} taxel{taxel + 1}" for polarity in ("OFF", "ON") for taxel in range(SIDE**2))
TAXELS = tuple(f"r{row}c{column}" for row in range(SIDE) for column in range(SIDE))
AGAIN = "neurotact fetch stemnist"


def read(path: str | Path, step_ms: float = STEP_MS) -> SpikeTrains:
    """The published events of every sample, from the folder `ProcessedSpikes` or those that hold it.

    Afferents are the OFF events of each taxel, then the ON events. Conditions: label, person, repetition, file.
    Raises InputError for files that are named or filled in another way.
    """
    rate_Hz = 1e3 / EventSpec(step_ms=step_ms).step_ms
    files, conditions = _samples(path, SPIKES, "_spikes")
    events, n_bytes = [], 0
    for file in files:
        records = _events(file)
        units = (records["polarity"] > 0) * SIDE**2 + records["taxel_id"].astype(np.int64) - 1
        events.append((event_times(records["timestamp"], 1.0), units))
        n_bytes += BYTES_PER_EVENT * len(records)
        check_size(path, n_bytes)
    ends = EventTimes(np.full(len(files), LENGTH_S), np.zeros(len(files)))
    return trains_with_ends(
        events, ends, rate_Hz, AFFERENTS, conditions, str(path),
        merge_events=True, fix=f"get the files again with {AGAIN}", told=([], []), source=SOURCE,
    )  # fmt: skip


def read_pressure(path: str | Path) -> Recordings:
    """The pressure of every sample in counts, from the folder `RawCharacters` or those that hold it.

    Taxels are the rows of the skin, one after the other. Conditions and errors are those of `read`.
    """
    files, conditions = _samples(path, PRESSURE, "")
    shape = (int(RATE_HZ * LENGTH_S), SIDE, SIDE)
    check_size(path, 4 * len(files) * shape[0] * SIDE**2)
    signals = []
    for file in files:
        with _opened(file) as declared:
            frames = declared.value("pressure_data")
        if np.shape(frames) != shape or frames.dtype != np.uint8:
            raise InputError(f"{file}: pressure_data is not {shape[0]} frames of 16 x 16 bytes; {AGAIN} gets the set")
        signals.append(frames.reshape(len(frames), -1).astype(np.float32))
    return Recordings(signals, RATE_HZ, "count", conditions, TAXELS, SOURCE)


@contextmanager
def _opened(file: Path) -> Iterator[Declared]:
    """An open file of the set, of which the rate and the length are those of the set, if it says them."""
    with reading(file, "a sample of STEMNIST", AGAIN) as held:
        for name, expected in (("sampling_rate", RATE_HZ), ("duration", LENGTH_S)):
            if name in held.attrs and attribute(held, name, file) != expected:
                raise InputError(
                    f"{file}: its {name} is {attribute(held, name, file)}, not {expected:g}; {AGAIN} gets the set"
                )
        yield Declared(held, file)


def _events(file: Path) -> np.ndarray:
    """The records of a file of events."""
    with _opened(file) as declared:
        records = declared.records("spikes", FIELDS)
    time_s, taxel, polarity = (records[name] for name in FIELDS)
    fits = (time_s >= 0) & (time_s <= LENGTH_S) & (taxel >= 1) & (taxel <= SIDE**2) & np.isin(polarity, (-1, 1))
    if not fits.all():
        raise InputError(
            f"{file}: event {np.argmin(fits)} is not of taxel 1 to {SIDE**2}, polarity -1 or 1 and 0 to {LENGTH_S:g} "
            f"s; {AGAIN} gets the set"
        )
    return records


def _samples(path: str | Path, name: str, ending: str) -> tuple[list[Path], pd.DataFrame]:
    """The files of every sample, and what their names say."""
    given = existing(Path(path), "folder")
    places = (
        place
        for place in (given, given / name, given / ARCHIVE / name, given / ARCHIVE / ARCHIVE / name)
        if place.name == name
    )
    folder = next((place for place in places if place.is_dir()), None)
    if folder is None:
        raise InputError(f"{given}: holds no folder {name}; give the folder of the unpacked archive, '{ARCHIVE}'")
    files = [file for file in sorted(folder.rglob("*.h5")) if not is_hidden(file.name)]
    if not files:
        raise InputError(f"{folder}: holds no .h5 file; {AGAIN} gets the set")
    rows = []
    for file in files:
        match = NAME.fullmatch(file.stem.removesuffix(ending))
        if not match or not file.stem.endswith(ending):
            raise InputError(f"{file}: is not named <person>_<character>_<n>{ending}.h5; rename it or move it away")
        person, label, repetition = match.groups()
        if file.parent != folder and file.parent.name != label:
            raise InputError(f"{file}: lies in the folder of '{file.parent.name[:40]}'; move it to that of {label}")
        rows.append((label, person, int(repetition), file.relative_to(folder).as_posix()))
    return files, pd.DataFrame(rows, columns=[LABEL, "person", "repetition", "file"])


READER = Reader("STEMNIST: letters and digits on 16 x 16 taxels (Tripathi et al. 2026), as events.", read, STEP_MS)
PRESSURE_READER = Reader(
    "STEMNIST: letters and digits on 16 x 16 taxels (Tripathi et al. 2026), as pressure.", read_pressure
)
