"""Cluster Haptic Texture: 118 textures under a rubber fingertip at five speeds and in eight directions (Eguchi 2026).

Scientific Data 13:756 (doi 10.1038/s41597-026-06760-z), figshare 10.6084/m9.figshare.29438288 (CC BY 4.0):
`sensor_data/accel` and `sensor_data/force` hold `<texture>_<direction>_<speed>_<force>_<n>.csv`, with the columns time
in s and X, Y, Z in g, or force in N. The authors' copy at Hugging Face holds Parquet tables, with time_ns for time.
"""

from dataclasses import replace
from pathlib import Path

from neurotact_parts.readers import folder

from neurotact.data.dataset import Reader
from neurotact.data.recordings import Recordings
from neurotact.errors import InputError
from neurotact.files import existing

SOURCE = "Cluster Haptic Texture (doi 10.6084/m9.figshare.29438288)"
PATTERN = "{label}_{direction_deg}_{speed_mm_per_s}_{force_mN}_{repetition}"
UNITS = {("X", "Y", "Z"): "g", ("force",): "N"}
"""By the columns of a table."""
VALUES = {
    "direction_deg": {*range(0, 360, 45)}, "speed_mm_per_s": {20, 30, 40, 50, 60}, "force_mN": {500, 1000},
    "repetition": {0, 1},
}  # fmt: skip
ACCELERATION = ("", "accel", "sensor_data/accel", "texture_dataset/sensor_data/accel")
"""Where the folder of accelerations may be."""


def read(path: str | Path) -> Recordings:
    """The accelerations in `path`, or in the `sensor_data/accel` inside it; the forces, if `path` is their folder.

    The stamps of the set are uneven: the samples are interpolated onto their median rate, which a warning says.
    Conditions: label (the number of the texture), direction_deg, speed_mm_per_s, force_mN, repetition, file.
    Raises InputError for files that are named or filled in another way. A folder of some textures may be read.
    """
    given = existing(Path(path), "folder")
    place = next(given / inside for inside in reversed(ACCELERATION) if (given / inside).is_dir())
    read = folder.read(place, unit="g", naming={"pattern": PATTERN})
    unit = UNITS.get(read.channels)
    if unit is None:
        raise InputError(
            f"{place}: its columns are {', '.join(read.channels)[:40]}, not X, Y, Z of accelerations or force; give "
            "the folder accel or force"
        )
    for name, expected in VALUES.items():
        odd = ~read.conditions[name].isin(expected)
        if odd.any():
            file, value = read.conditions.loc[odd.idxmax(), ["file", name]]
            raise InputError(
                f"{place / file}: {name} is {value}, not one of {sorted(expected)}; rename it or move it away"
            )
    return replace(read, unit=unit, source=SOURCE)


READER = Reader(
    "Cluster Haptic Texture: accelerations of a fingertip on 118 textures (Eguchi et al. 2026), its folder.", read
)
