"""Seventy people who slide a finger, brush a paintbrush and roll a washer over a 4 x 4 piezoelectric array.

Published as Mendeley Data dmcdp33ctt, version 2 (University of Genoa, COSMIC lab); used by the touch-modality paper.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from neurotact.data.dataset import Reader
from neurotact.data.readers.table.cells import cells, is_value, numbers
from neurotact.data.readers.table.texts import read_text
from neurotact.data.recordings import Recordings
from neurotact.errors import InputError
from neurotact.files import check_size, existing
from neurotact.lazily import lazily

with lazily():
    import pandas as pd


SOURCE = "touch modality (Mendeley Data dmcdp33ctt)"
SAMPLING_RATE_HZ = 3000.0
CLASSES = ("brushing", "rolling", "sliding")
N_SAMPLES = 30000
"""10 s; later samples are dropped, as in the authors' public code."""
COLUMNS = ("index", *(f"taxel{i + 1}" for i in range(16)))


def read(folder: str | Path) -> Recordings:
    """Every recording in `folder/{brushing,rolling,sliding}/*.lvm`, in V at 3 kHz, `(trial, 30000, 16)`.

    Files are tab-separated without a header: at least 30,000 rows of 17 columns, of which the first is not a taxel and
    is dropped. Classes come in the order above, files in the order of their names. Conditions: label, file.
    The published layout does not name the person, so there is no condition `person`. The 840 published files take
    1.6 GB in memory: raise NEUROTACT_MAX_MB for them.

    Raises InputError, which names the file, the place and the fix.

    >>> import tempfile
    >>> folder = Path(tempfile.mkdtemp())
    >>> row = "\\t".join(["1.65"] * 17) + "\\n"
    >>> for name in CLASSES:
    ...     (folder / name).mkdir()
    ...     _ = (folder / name / "1.lvm").write_text(row * 30000)
    >>> touch = read(folder)
    >>> touch.signals.shape, touch.classes
    ((3, 30000, 16), ('brushing', 'rolling', 'sliding'))
    """
    folder = existing(folder, "folder")
    files = [(label, path) for label, inside in _class_folders(folder).items() for path in _recordings_in(inside)]
    shape = (len(files), N_SAMPLES, len(COLUMNS) - 1)
    check_size(folder, math.prod(shape) * np.dtype(np.float32).itemsize)
    signals = np.empty(shape, np.float32)
    for i, (_, path) in enumerate(files):
        signals[i] = _read_lvm(path)
    names = [path.relative_to(folder).as_posix() for _, path in files]
    conditions = pd.DataFrame({"label": [label for label, _ in files], "file": names})
    return Recordings(signals, SAMPLING_RATE_HZ, "V", conditions, COLUMNS[1:], SOURCE)


def _class_folders(folder: Path) -> dict[str, Path]:
    folders = {subfolder.name.lower(): subfolder for subfolder in sorted(folder.iterdir()) if subfolder.is_dir()}
    missing = [label for label in CLASSES if label not in folders]
    if missing:
        raise InputError(
            f"{folder}: holds no folder '{missing[0]}'; give the folder that holds brushing, rolling and sliding"
        )
    return {label: folders[label] for label in CLASSES}


def _recordings_in(class_folder: Path) -> list[Path]:
    files = sorted(p for p in class_folder.iterdir() if p.suffix.lower() == ".lvm" and not p.name.startswith("."))
    if not files:
        raise InputError(f"{class_folder}: holds no .lvm file; unpack the published archive again")
    return files


def _read_lvm(path: Path) -> np.ndarray:
    text = read_text(path)
    foreign = [cell for cell in cells(text.partition("\n")[0], "\t") if cell and not is_value(cell)]
    if foreign:
        raise InputError(f"{path}: line 1 holds {foreign[0][:40]!r} instead of a number; restore the published file")
    if text and not text.endswith("\n"):
        raise InputError(f"{path}: the last line does not end, so the file was cut off; download it again")
    table = numbers(text, path, separator="\t", names=COLUMNS)
    if len(table) < N_SAMPLES:
        raise InputError(
            f"{path}: holds {len(table)} rows where 10 s at 3 kHz have {N_SAMPLES}; "
            "download the file again or move it away"
        )
    return table[:N_SAMPLES, 1:].astype(np.float32)


READER = Reader(
    "Sliding, brushing and rolling on a 4 x 4 array (Mendeley Data dmcdp33ctt): three folders of .lvm files.",
    read,
)
