"""A patch of eight P(VDF-TrFE) taxels pressed on cubes of different hardness (University of Genoa, COSMIC lab).

Published at github.com/cosmiclabunige/Tactile_Heatmaps, folder `dataset`.
"""

from __future__ import annotations

import logging
import re
from pathlib import Path, PurePosixPath
from typing import NamedTuple

import numpy as np
from neurotact_parts.readers.numpy_files import read_arrays

from neurotact.data.dataset import Reader
from neurotact.data.readers.table.cells import as_signal, numbers
from neurotact.data.readers.table.texts import read_text, split_header
from neurotact.data.recordings import Recordings
from neurotact.errors import InputError
from neurotact.files import check_size, existing
from neurotact.lazily import lazily

with lazily():
    import pandas as pd


SOURCE = "P(VDF-TrFE) hardness (github.com/cosmiclabunige/Tactile_Heatmaps)"
SAMPLING_RATE_HZ = 2000.0  # inferred from the electronics; the authors do not state it
VOLTS_PER_ADC_COUNT = 6.2409399555e-5
TAXELS = tuple(f"taxel{i + 1}" for i in range(8))

LVM_LAYOUT = "Hardness_<Voltage or Force>_Seq<s>_Sp<speed>_Cube<c>_t<trial>.lvm"
LVM_NAME = re.compile(
    r"Hardness_(?P<kind>Voltage|Force)_Seq(?P<sequence>\d{1,6})_Sp(?P<speed>\d{1,6})"
    r"_Cube(?P<cube>\d{1,6})_t(?P<trial>\d{1,6})\.lvm",
    re.ASCII,
)
KEY_LAYOUT = "c<cube>_s<sequence>_v<speed>_t<trial>_<adc or force>"
KEY = re.compile(
    r"c(?P<cube>\d{1,6})_s(?P<sequence>\d{1,6})_v(?P<speed>\d{1,6})_t(?P<trial>\d{1,6})_(?P<kind>adc|force)",
    re.ASCII,
)

log = logging.getLogger("neurotact")


class Press(NamedTuple):
    """The fields that identify a trial; trials are ordered by them."""

    cube: int
    sequence: int
    speed: int
    trial: int


class Trial(NamedTuple):
    """The taxels in V `(time, 8)`, the highest force (NaN if none was recorded), and the file."""

    signal: np.ndarray
    force_max_N: float
    file: str


def read(folder: str | Path) -> Recordings:
    """Every press in `folder`, ordered by cube, sequence, speed and trial; signals in V at 2000 Hz.

    A folder with `cube<N>.npz` is read as the repack (keys `c03_s1_v300_t01_adc`, uint16, and `..._force`);
    any other as the published layout, `Hardness_{Voltage,Force}_..._t<trial>.lvm` at any depth. Conditions:
    label ("cube3"), cube, sequence (of robot heights), speed, trial, force_max_N, file. force_max_N is the highest
    reading of the load cell, including its offset (some 0.2 to 0.6 N), and NaN if no force was recorded; the
    load cell's own samples, 4 % more than the taxels', are not returned.

    Raises InputError, which names the file, the place and the fix.

    >>> import tempfile
    >>> folder = Path(tempfile.mkdtemp())
    >>> np.savez(folder / "cube03.npz", c03_s1_v300_t01_adc=np.full((5, 8), 29000, np.uint16))
    >>> presses = read(folder)
    >>> presses.signals[0][0, 0].round(3), presses.conditions.label[0]
    (np.float32(1.81), 'cube3')
    """
    folder = existing(folder, "folder")
    archives = sorted(folder.glob("cube*.npz"))
    texts = [] if archives else sorted(path for path in folder.rglob("*.lvm") if not path.name.startswith("."))
    if not archives and not texts:
        raise InputError(
            f"{folder}: holds neither cube<N>.npz nor {LVM_LAYOUT}; give the folder 'dataset' of Tactile_Heatmaps"
        )
    trials = _read_archives(archives) if archives else _read_texts(texts, folder)
    if not trials:
        raise InputError(f"{folder}: holds force recordings only; add the voltages of the same trials")
    order = sorted(trials)
    conditions = pd.DataFrame([{"label": f"cube{press.cube}", **press._asdict()} for press in order])
    conditions["force_max_N"] = [trials[press].force_max_N for press in order]
    conditions["file"] = [trials[press].file for press in order]
    return Recordings([trials[press].signal for press in order], SAMPLING_RATE_HZ, "V", conditions, TAXELS, SOURCE)


def _read_texts(paths: list[Path], folder: Path) -> dict[Press, Trial]:
    trials = {}
    n_bytes = 0
    files = [path.relative_to(folder).as_posix() for path in paths]
    for press, file in _pair(files, LVM_NAME, LVM_LAYOUT, folder, "Voltage").items():
        signal = _read_lvm(folder / file["Voltage"], TAXELS).astype(np.float32)
        force_N = _read_lvm(folder / file["Force"], ("force",)) if "Force" in file else np.array(np.nan)
        trials[press] = Trial(signal, float(force_N.max()), file["Voltage"])
        n_bytes += signal.nbytes
        check_size(folder, n_bytes)
    return trials


def _read_lvm(path: Path, names: tuple[str, ...]) -> np.ndarray:
    head, body = split_header(read_text(path), path)
    if any(character.isdigit() for character in head):
        raise InputError(f"{path}: line 1 holds numbers instead of the header; restore the published file")
    return numbers(body, path, separator="\t", first_line=2, names=names)


def _read_archives(paths: list[Path]) -> dict[Press, Trial]:
    trials: dict[Press, Trial] = {}
    n_bytes = 0
    for path in paths:
        arrays = read_arrays(path)
        for press, key in _pair(list(arrays), KEY, KEY_LAYOUT, path, "adc").items():
            if press in trials:
                raise InputError(f"{path}: '{key['adc']}' is also {trials[press].file}; keep one of the two")
            signal = _volts(arrays[key["adc"]], f"{path}, key '{key['adc']}'")
            force_N = _force(arrays[key["force"]], f"{path}, key '{key['force']}'") if "force" in key else np.nan
            trials[press] = Trial(signal, float(np.max(force_N)), f"{path.name}:{key['adc']}")
            n_bytes += signal.nbytes
            check_size(path.parent, n_bytes)
    return trials


def _volts(adc: np.ndarray, where: str) -> np.ndarray:
    if adc.dtype != np.uint16 or adc.shape[1:] != (len(TAXELS),):
        raise InputError(f"{where}: holds {adc.dtype} {adc.shape}, not uint16 (time, 8); restore the array")
    return as_signal(adc * VOLTS_PER_ADC_COUNT, where)


def _force(force_N: np.ndarray, where: str) -> np.ndarray:
    if force_N.ndim != 1:
        raise InputError(f"{where}: has shape {force_N.shape}, not (time,); restore the array")
    return as_signal(force_N[:, None], where)


def _pair(
    names: list[str], pattern: re.Pattern[str], layout: str, where: Path, voltage: str
) -> dict[Press, dict[str, str]]:
    """The names by press and kind of measurement; a force without its voltage is dropped, with a warning."""
    presses: dict[Press, dict[str, str]] = {}
    for name in names:
        match = pattern.fullmatch(PurePosixPath(name).name)
        if not match:
            raise InputError(f"{where}: {name[:200]!r} is not named {layout}; rename it or move it away")
        kinds = presses.setdefault(Press(*(int(match[field]) for field in Press._fields)), {})
        if match["kind"] in kinds:
            raise InputError(f"{where}: '{name}' and '{kinds[match['kind']]}' are the same trial; keep one of them")
        kinds[match["kind"]] = name
    for kinds in presses.values():
        if voltage not in kinds:
            log.warning("%s: '%s' is dropped: the voltages of its trial are missing", where, *kinds.values())
    return {press: kinds for press, kinds in presses.items() if voltage in kinds}


READER = Reader(
    "A P(VDF-TrFE) patch pressed on five cubes: the published .lvm folders, or a folder of cube*.npz.",
    read,
)
