"""FabricSlide: seven fabrics slid under a finger of 16 capacitive taxels.

Wang, Maiti, Cuadrado et al., Frontiers in Neurorobotics 16:808222 (2022), doi 10.3389/fnbot.2022.808222;
published at github.com/wngfra/FabricSlide, folder `data/fabric`, MIT licence.
"""

from __future__ import annotations

import logging
import re
from pathlib import Path

import numpy as np

from neurotact.data.dataset import Reader
from neurotact.data.readers.table.cells import cells, numbers
from neurotact.data.readers.table.texts import read_text, split_header
from neurotact.data.recordings import Recordings
from neurotact.errors import InputError
from neurotact.files import check_size, existing
from neurotact.lazily import lazily

with lazily():
    import pandas as pd


SOURCE = "FabricSlide (doi 10.3389/fnbot.2022.808222)"
PATTERN = "<Fabric>_F<set-point>_V<speed>mmps_<repetition>.csv"
NAME = re.compile(r"(.+)_F(\d{1,6})_V([+-]?\d{1,6}(?:\.\d+)?)mmps_(\d{1,6})\.csv", re.ASCII)
CHANNELS = tuple(f"channel{i + 1}" for i in range(16))
COLUMNS = ("timestamp", "proximity1", "proximity2", *CHANNELS)
RATE_TOLERANCE = 0.01

log = logging.getLogger("neurotact")


def read(folder: str | Path) -> Recordings:
    """Every slide in `folder`, or in the `fabric` or `data/fabric` inside it, in the order of the file names.

    The signals are channel1..16 in counts (the proximity columns are left out). Conditions: label (the fabric),
    pressure_setpoint, speed_mm_per_s (the sign is the direction), repetition, file. Files other than .csv are
    ignored; a .csv with another name or header than the published one is refused.

    Time. The timestamps are whole milliseconds about 28.08 ms apart. A row that repeats the timestamp of the
    row before it is dropped, with a logged warning (two published files end with one). After that, any interval
    outside 0.5 to 1.5 times the file's median interval is refused: a row is missing, or time runs back. A
    file's mean interval is (last - first) / (rows - 1), which is finer than the rounding of single stamps; the
    sampling rate is 1000 / (median of the files' mean intervals), rounded to the 0.01 Hz that the stamps
    resolve (35.61 Hz), and a file more than 1 % and one stamp away from it is refused.

    Raises InputError, which names the file, the line and the fix.

    >>> import tempfile
    >>> folder = Path(tempfile.mkdtemp())
    >>> rows = [[28 * i, 0, 65535, *range(16)] for i in range(3)]
    >>> lines = [", ".join(COLUMNS), *(",".join(map(str, row)) for row in rows)]
    >>> _ = (folder / "Linen_F120_V-50mmps_0.csv").write_text("\\n".join(lines) + "\\n")
    >>> slides = read(folder)
    >>> slides.signals[0].shape, slides.sampling_rate_Hz, slides.conditions.speed_mm_per_s[0]
    ((3, 16), 35.71, np.float64(-50.0))
    """
    paths = _slides(existing(folder, "folder"))
    conditions = pd.DataFrame([_conditions(path) for path in paths])
    times_ms, signals = [], []
    n_bytes = 0
    for path in paths:
        time_ms, signal = _read_slide(path)
        times_ms.append(time_ms)
        signals.append(signal)
        n_bytes += signal.nbytes
        check_size(folder, n_bytes)
    return Recordings(signals, _sampling_rate(times_ms, paths), "count", conditions, CHANNELS, SOURCE)


def _slides(folder: Path) -> list[Path]:
    for candidate in (folder, folder / "fabric", folder / "data" / "fabric"):
        paths = sorted(path for path in candidate.glob("*.csv") if not path.name.startswith("."))
        if paths:
            return paths
    raise InputError(f"{folder}: holds no .csv file; give the folder of the {PATTERN} files (data/fabric)")


def _conditions(path: Path) -> dict[str, object]:
    match = NAME.fullmatch(path.name)
    if not match:
        raise InputError(f"{path}: is not named {PATTERN}; rename the file or move it away")
    fabric, setpoint, speed, repetition = match.groups()
    return {
        "label": fabric,
        "pressure_setpoint": int(setpoint),
        "speed_mm_per_s": float(speed),
        "repetition": int(repetition),
        "file": path.name,
    }


def _read_slide(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Timestamps `(time,)` in ms, each once, and the taxels `(time, 16)`."""
    head, body = split_header(read_text(path), path)
    names = tuple(cells(head))
    if names != COLUMNS:
        raise InputError(
            f"{path}: line 1 must name the columns timestamp, proximity1, proximity2, channel1..channel16; "
            f"got {len(names)} columns, {_first_difference(names)}; restore the published file"
        )
    table = numbers(body, path, first_line=2, names=COLUMNS)
    time_ms = table[:, 0]
    lines = np.arange(len(table)) + 2
    keep = np.diff(time_ms, prepend=-np.inf) != 0
    for line in lines[~keep]:
        log.warning("%s: line %d repeats the timestamp of the line before it; the row is dropped", path, line)
    _check_regular(time_ms[keep], lines[keep], path)
    return time_ms[keep], table[keep, -len(CHANNELS) :].astype(np.float32)


def _first_difference(names: tuple[str, ...]) -> str:
    pairs = zip(names, COLUMNS, strict=False)
    different = (f"column {i} is {got[:20]!r}" for i, (got, wanted) in enumerate(pairs, 1) if got != wanted)
    return next(different, f"not {len(COLUMNS)}")


def _check_regular(time_ms: np.ndarray, lines: np.ndarray, path: Path) -> None:
    if len(time_ms) < 2:
        raise InputError(f"{path}: holds a single time, and a sampling rate needs two; restore the published file")
    steps = np.diff(time_ms)
    usual = np.median(steps[steps > 0]) if (steps > 0).any() else 0.0
    irregular = np.flatnonzero((steps <= 0.5 * usual) | (steps >= 1.5 * usual))
    if irregular.size:
        i = irregular[0]
        raise InputError(
            f"{path}: line {lines[i + 1]} comes {steps[i]:g} ms after the line before it where {usual:g} ms is "
            "usual; rows are missing or out of order, so restore the published file"
        )


def _sampling_rate(times_ms: list[np.ndarray], paths: list[Path]) -> float:
    intervals_ms = np.array([(time[-1] - time[0]) / (len(time) - 1) for time in times_ms])
    stamps_ms = np.array([1 / (len(time) - 1) for time in times_ms])
    interval_ms = float(np.median(intervals_ms))
    odd = np.flatnonzero(np.abs(intervals_ms - interval_ms) > RATE_TOLERANCE * interval_ms + stamps_ms)
    if odd.size:
        raise InputError(
            f"{paths[odd[0]]}: has a row every {intervals_ms[odd[0]]:.2f} ms, the other files one every "
            f"{interval_ms:.2f} ms; import files of one sampling rate together"
        )
    return round(1000 / interval_ms, 2)


READER = Reader(
    "FabricSlide: 7 fabrics under a 16-taxel finger (Wang et al. 2022), a folder of CSV files.",
    read,
)
