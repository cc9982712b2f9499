"""VT-SNN: containers lifted, and an object that rotates or not, by two NeuTouch fingers (Taunyazov et al. 2020).

Event-Driven Visual-Tactile Sensing and Learning for Robots, Robotics: Science and Systems 2020; the layout is that of
the authors' scripts in github.com/clear-nus/VT_SNN. Recorded: `aces_recordings/<name>_<n>.tact`, a row per event of
polarity (1 is ON), cell, seconds and nanoseconds, and `traj_start_ends/<name>_<n>.startend`, the times of the robot's
motions in s. Prepared: `tact.pt`, a tensor (sample, taxel, ON and OFF, step) of 0 and 1, and `train_80_20_1.txt` and
`test_80_20_1.txt`, rows of sample and class. The images of the set are not read.
"""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
from neurotact_parts.readers.events.spikes import EventSpec, TrialEvents, trains_of
from neurotact_parts.readers.events.times import EventTimes, event_times

from neurotact.data.dataset import Reader
from neurotact.data.readers.formats import arrays_in
from neurotact.data.readers.table.cells import numbers
from neurotact.data.readers.table.texts import read_text
from neurotact.data.recordings import LABEL
from neurotact.data.spikes import SpikeTrains, from_rasters
from neurotact.errors import InputError
from neurotact.files import check_size, existing, is_hidden
from neurotact.lazily import lazily

with lazily():
    import pandas as pd


log = logging.getLogger("neurotact")

SOURCE = "VT-SNN (github.com/clear-nus/VT_SNN)"
OBJECTS = ("107 pepsi_bottle", "108 tuna_fish_can", "109 soymilk", "110 coffee_can")
CONTAINERS = tuple(f"{word.split()[0]}-{weight}_{word.split()[1]}" for word in OBJECTS for weight in "abcde")
"""Four containers of five weights each, in the order of their numbers in the prepared files."""
SLIPS = ("stable", "rotate")
LENGTH_S = {CONTAINERS: 8.5, SLIPS: 0.15}
"""Of a trial, from when the robot begins to reach for the object."""
REACHES = 1
"""Place of that time among those of the robot's motions, of which there are six, of slips four."""
CELLS = tuple(cell for cell in range(1, 81) if cell not in (17, 49))
"""Of two fingers, without two cells that the study leaves out."""
AFFERENTS = tuple(f"{polarity} cell{cell}" for polarity in ("OFF", "ON") for cell in CELLS)
STEP_MS = 20.0
"""The clock of the published study of containers; that of slips is 1 ms."""
RECORDED, MOTIONS, PREPARED = "aces_recordings", "traj_start_ends", "tact.pt"


def read(path: str | Path, step_ms: float = STEP_MS) -> SpikeTrains:
    """The tactile events of every trial in the published folder; of a prepared folder `step_ms` is the step it has.

    Afferents are the OFF events of each cell, then the ON events. Conditions of recorded trials: label, repetition,
    file, and of containers object and weight; of prepared ones: label, split.
    Raises InputError for files that are named or filled in another way.
    """
    folder = existing(Path(path), "folder")
    if (folder / PREPARED).is_file():
        return _prepared(folder, step_ms)
    files = [file for file in sorted((folder / RECORDED).glob("*.tact")) if not is_hidden(file.name)]
    if not files:
        raise InputError(f"{folder}: holds neither {PREPARED} nor {RECORDED}/*.tact; give the published folder")
    names = [file.stem.rpartition("_") for file in files]
    classes = next((kind for kind in LENGTH_S if names[0][0] in kind), CONTAINERS)
    for file, (label, _, repetition) in zip(files, names, strict=True):
        if label not in classes or not (repetition.isascii() and repetition.isdigit()):
            raise InputError(
                f"{file}: is not named <name>_<n>.tact, where a name is one of {classes[0]} ... {classes[-1]}"
            )
    trials, n_bytes, n_outside, n_events = [], 0, 0, 0
    for file in files:
        times, units, is_inside = _events(file, LENGTH_S[classes])
        trials.append(TrialEvents(lambda times=times: times, units))
        n_outside, n_events = n_outside + int((~is_inside).sum()), n_events + len(is_inside)
        n_bytes += times.time_s.nbytes + units.nbytes
        check_size(folder, n_bytes)
    if n_outside:
        log.warning(
            "%s: %d of %d events are left out: of cells 17 and 49, or not in the %g s from reaching for the object",
            folder, n_outside, n_events, LENGTH_S[classes],
        )  # fmt: skip
    conditions = pd.DataFrame({LABEL: [label for label, _, _ in names]})
    if classes is CONTAINERS:
        conditions["object"] = [label.partition("_")[2] for label, _, _ in names]
        conditions["weight"] = [label.partition("_")[0][-1] for label, _, _ in names]
    conditions["repetition"] = [int(repetition) for _, _, repetition in names]
    conditions["file"] = [file.name for file in files]
    spec = EventSpec(step_ms=step_ms, duration_ms=1e3 * LENGTH_S[classes], merge_events=True)
    return trains_of(trials, [], spec, AFFERENTS, conditions, str(folder))


def _events(file: Path, length_s: float) -> tuple[EventTimes, np.ndarray, np.ndarray]:
    """Times since reaching and afferents of the events of a trial, and of all in the file which are among them."""
    columns = ("polarity", "cell", "seconds", "nanoseconds")
    rows = numbers(read_text(file), file, separator=" ", names=columns)
    fits = (rows >= (0, 1, 0, 0)) & (rows <= (1, CELLS[-1], 2**32, 10**9 - 1)) & (rows == np.floor(rows))
    if not fits.all():
        raise InputError(f"{file}: a row is not polarity 0 or 1, cell 1 to 80, seconds and nanoseconds; get it again")
    polarity, cell, seconds, rest = rows.astype(np.int64).T
    motions = file.parent.parent / MOTIONS / f"{file.stem}.startend"
    times = numbers(read_text(existing(motions, "file")), motions, separator=" ")
    if len(times) != 1 or times.shape[1] <= REACHES:
        raise InputError(f"{motions}: holds {times.shape} numbers, not one row of the times of motions; get it again")
    since_ns = seconds * 10**9 + rest - round(times[0, REACHES] * 1e9)
    is_inside = (since_ns >= 0) & (since_ns < round(length_s * 1e9)) & np.isin(cell, CELLS)
    units = polarity[is_inside] * len(CELLS) + np.searchsorted(CELLS, cell[is_inside])
    return event_times(since_ns[is_inside], 1e-9), units, is_inside


def _prepared(folder: Path, step_ms: float) -> SpikeTrains:
    """The spikes of the prepared tensor, and the classes and sides of the first published split."""
    file, rate_Hz = folder / PREPARED, 1e3 / EventSpec(step_ms=step_ms).step_ms
    held = arrays_in(file).arrays
    values = next(iter(held.values()))
    if (
        len(held) != 1
        or values.ndim != 4
        or not values.size
        or values.shape[1:3] != (len(CELLS), 2)
        or not np.isin(values, (0, 1)).all()
    ):
        shown = ", ".join(f"{name} {array.shape}" for name, array in held.items())[:80]
        raise InputError(
            f"{file}: holds {shown}, not one tensor of 0 and 1, (sample, {len(CELLS)}, 2, step); get it again"
        )
    sides = []
    for split in ("train", "test"):
        listed = folder / f"{split}_80_20_1.txt"
        rows = numbers(read_text(existing(listed, "file")), listed, separator="\t", names=("sample", "class"))
        sides.append(pd.DataFrame({"sample": rows[:, 0], LABEL: rows[:, 1], "split": split}))
    samples = pd.concat(sides, ignore_index=True).sort_values("sample", ignore_index=True)
    classes = next((kind for kind in LENGTH_S if [*range(len(kind))] == sorted({*samples[LABEL]})), None)
    if classes is None or samples["sample"].tolist() != [*range(len(values))]:
        raise InputError(
            f"{folder}: train_80_20_1.txt and test_80_20_1.txt name no class of {len(SLIPS)} or {len(CONTAINERS)} for "
            f"each of the {len(values)} samples of {PREPARED}; get them again"
        )
    conditions = pd.DataFrame({LABEL: [classes[int(number)] for number in samples[LABEL]], "split": samples["split"]})
    rasters = [np.concatenate([sample[:, 1], sample[:, 0]]).T for sample in values]
    return from_rasters(rasters, rate_Hz, AFFERENTS, conditions, source=SOURCE)


READER = Reader(
    "VT-SNN: containers, or slip, felt by two event-based fingers (Taunyazov et al. 2020), its folder.", read, STEP_MS
)
