"""Writes a folder of touches as the reader of this package takes them: 60 of three fabrics, two taxels at 500 Hz."""

import sys
from pathlib import Path

import numpy as np

VIBRATION_Hz = {"felt": 8, "mesh": 20, "silk": 45}

folder = Path(sys.argv[1])
folder.mkdir(parents=True, exist_ok=True)
rng, time_s = np.random.default_rng(0), np.arange(150)[:, None] / 500
for number in range(60):
    name, frequency_Hz = [*VIBRATION_Hz.items()][number % 3]
    wave = 5 * np.sin(2 * np.pi * frequency_Hz * time_s + rng.uniform(0, 6, 2))
    np.save(folder / f"{name}_{number}.npy", wave)
