"""
From your own CSV files to an answer
====================================

A folder with one file per touch becomes recordings, an encoder for that sensor, a network, and an accuracy with its
interval. The files are made up here; yours are read in the same way.
"""

import tempfile
from pathlib import Path

import numpy as np

import neurotact as nt

# %%
# Forty touches of two fabrics: a folder for each, a row per sample, a time stamp and three taxels in counts.

folder, rng = Path(tempfile.mkdtemp()), np.random.default_rng(0)
time_s = np.arange(1200) / 1000.0
for fabric, frequency_Hz in {"felt": 6.0, "twill": 17.0}.items():
    (folder / "data" / fabric).mkdir(parents=True)
    for number in range(20):
        ridges = np.sin(2 * np.pi * frequency_Hz * time_s[:, None] + rng.uniform(0, 6, 3))
        counts = 500 + 90 * ridges + rng.normal(0, 25, (len(time_s), 3))
        rows = np.column_stack([time_s, counts])
        path = folder / "data" / fabric / f"{number}.csv"
        np.savetxt(path, rows, "%.4f", ",", header="time,t1,t2,t3", comments="")

touches = nt.read_folder(folder / "data", unit="count")
print(touches)

# %%
# Scales and gains are chosen on training trials alone, then everything is encoded.

encoder = nt.calibrate(touches)
spikes = nt.encode(touches, encoder)
figure = nt.plot_raster(spikes, trial=0, recordings=touches)

# %%
# `train` keeps the network in a folder, compares it with eight classifiers on the same spikes, and says what may be
# wrong with the answer.

nt.save(spikes, folder / "spikes.h5")
found = nt.train(
    folder / "spikes.h5",
    folder / "run",
    settings={"training.epochs": 10},
    window=nt.Window(length_ms=400, start_ms=100),
)
print(f"accuracy {found['accuracy_test']:.0%} (95 %: {found['low']:.0%} to {found['high']:.0%})")
print(f"best of eight others, {found['baseline']}: {found['baseline_accuracy']:.0%}")
for caution in found["cautions"]:
    print("-", caution)
