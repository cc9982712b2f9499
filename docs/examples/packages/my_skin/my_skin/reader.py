"""A reader: a folder of .npy files as recordings."""

from pathlib import Path

import numpy as np

import neurotact as nt


def read(folder: Path) -> nt.Recordings:
    """An array (time, taxel) of each touch, in <class>_<number>.npy, at 500 Hz in mV."""
    files = sorted(folder.glob("*_*.npy"))
    if not files:
        raise nt.InputError(f"{folder}: holds no <class>_<number>.npy file; check the path")
    signals = [np.load(file, allow_pickle=False) for file in files]
    labels = [file.stem.rpartition("_")[0] for file in files]
    return nt.Recordings(signals, 500.0, "mV", labels, source=f"my skin, {folder.name}")


READER = nt.Reader("Touches of my skin: a folder of .npy files.", read)
