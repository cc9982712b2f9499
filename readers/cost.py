"""CoST: 14 social touches of 31 people on a mannequin's arm under 8 x 8 pressure sensors (Jung et al. 2014).

Doi 10.1145/2663204.2663242; 4TU.ResearchData 10.4121/uuid:5ef62345-3b3e-479c-8e1d-c922748c9b29 (CC BY-NC-SA 4.0):
`CoST.csv`, a row per frame with the columns subject, variant (1 to 3), gesture (1 to 14), frame (from 1 in each touch)
and ch1 to ch64 (0 to 1023), 135 frames in a second.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from neurotact.data.dataset import Reader
from neurotact.data.recordings import LABEL, Recordings
from neurotact.errors import InputError
from neurotact.files import check_size, existing
from neurotact.lazily import lazily

with lazily():
    import pandas as pd


SOURCE = "CoST (doi 10.4121/uuid:5ef62345-3b3e-479c-8e1d-c922748c9b29)"
FILE = "CoST.csv"
GESTURES = (
    "grab", "hit", "massage", "pat", "pinch", "poke", "press", "rub", "scratch", "slap", "squeeze", "stroke", "tap",
    "tickle",
)  # fmt: skip
"""In the order of their numbers."""
VARIANTS = ("gentle", "normal", "rough")
CHANNELS = tuple(f"ch{number}" for number in range(1, 65))
TOUCH = ("subject", "variant", "gesture")
RATE_HZ, MOST = 135.0, 1023
ROWS = 100_000
"""Rows that are read at once."""


def read(path: str | Path) -> Recordings:
    """Every touch, in the order of the file, in counts at 135 Hz.

    path: the file, or the folder that holds it. Conditions: label (the gesture), variant, subject, repetition.
    Raises InputError for other columns, values beyond their ranges, and touches that lack a frame.
    """
    given = existing(Path(path), "file or folder")
    file = existing(given / FILE, "file") if given.is_dir() else given
    parts, n_bytes = [], 0
    try:
        with pd.read_csv(file, chunksize=ROWS) as chunks:
            for chunk in chunks:
                parts.append(_whole_numbers(chunk.rename(columns=str.strip), file))
                n_bytes += 2 * parts[-1].nbytes  # these, and the signals
                check_size(file, n_bytes)
    except InputError:
        raise
    except ValueError as error:  # pandas' errors of a table, and of bytes that are no text
        raise InputError(f"{file}: is no table of numbers ({str(error)[:80]}); get the published file again") from error
    rows = np.concatenate(parts)
    if not len(rows):
        raise InputError(f"{file}: holds no frame; get the published file again")
    touch, frame = rows[:, : len(TOUCH)], rows[:, len(TOUCH)]
    is_new = (frame == 1) | (np.diff(touch, axis=0, prepend=0) != 0).any(axis=1)
    begins = np.flatnonzero(is_new)
    within = np.arange(len(rows)) - begins[np.cumsum(is_new) - 1] + 1
    if (odd := np.flatnonzero(frame != within)).size:
        raise InputError(
            f"{file}: line {odd[0] + 2} is frame {frame[odd[0]]}, not {within[odd[0]]} of its touch; get the published "
            "file again"
        )
    signals = [part.astype(np.float32) for part in np.split(rows[:, -len(CHANNELS) :], begins[1:])]
    return Recordings(signals, RATE_HZ, "count", _conditions(touch[begins]), CHANNELS, SOURCE)


def _whole_numbers(chunk: pd.DataFrame, file: Path) -> np.ndarray:
    """The columns in their order, as int16; their ranges are checked."""
    columns = (*TOUCH, "frame", *CHANNELS)
    if not isinstance(chunk.index, pd.RangeIndex):
        raise InputError(f"{file}: a row has more values than the first line names; get the published file again")
    if {*chunk.columns} != {*columns} or len(chunk.columns) != len(columns):
        other = next((name for name in chunk.columns if name not in columns), None)
        what = f"has a column '{other[:40]}'" if other else f"has {len(chunk.columns)} columns"
        raise InputError(
            f"{file}: {what} where subject, variant, gesture, frame and ch1 to ch64 are expected; give {FILE}"
        )
    values = chunk[[*columns]].to_numpy(np.float64)
    most = np.array(
        [np.iinfo(np.int16).max, len(VARIANTS), len(GESTURES), np.iinfo(np.int16).max, *[MOST] * len(CHANNELS)]
    )
    least = np.array([1, 1, 1, 1, *[0] * len(CHANNELS)])
    fits = (values >= least) & (values <= most) & (values == np.floor(values))
    if not fits.all():
        row, column = np.argwhere(~fits)[0]
        raise InputError(
            f"{file}: line {chunk.index[row] + 2}, {columns[column]} is {values[row, column]:g}, not a whole number "
            f"from {least[column]} to {most[column]}; get the published file again"
        )
    return values.astype(np.int16)


def _conditions(touches: np.ndarray) -> pd.DataFrame:
    """What each touch is, from the numbers of its subject, variant and gesture."""
    conditions = pd.DataFrame(
        {
            LABEL: [GESTURES[number - 1] for number in touches[:, 2]],
            "variant": [VARIANTS[number - 1] for number in touches[:, 1]],
            "subject": touches[:, 0].astype(np.int64),
        }
    )
    conditions["repetition"] = conditions.groupby([*conditions]).cumcount() + 1
    return conditions


READER = Reader("CoST: 14 social touches under 8 x 8 pressure sensors (Jung et al. 2014), CoST.csv.", read)
