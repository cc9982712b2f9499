"""
A sensor that sends events
==========================

It needs no encoder: a file of times, channels and polarities is read as spike trains.
"""

import tempfile
from pathlib import Path

import numpy as np

import neurotact as nt

# %%
# Thirty touches of two patterns on a skin of four channels, as a CSV file: time in ms, channel, polarity, trial, label.

rng, folder = np.random.default_rng(0), Path(tempfile.mkdtemp())
lines = ["t_ms,channel,polarity,trial,label"]
for trial in range(30):
    label = ("ridge", "dots")[trial % 2]
    for channel in range(4):
        period_ms = (25, 40)[trial % 2] + 3 * channel
        for begin_ms in np.arange(rng.uniform(0, 20), 380, period_ms):
            times_ms = begin_ms + np.sort(rng.uniform(0, 12, 3))
            lines += [
                f"{t:.2f},{channel},{number % 2},{trial},{label}" for number, t in enumerate(times_ms)
            ]
(folder / "events.csv").write_text("\n".join(lines))

spikes = nt.read_events(folder / "events.csv", events=nt.Events(duration_ms=400.0))
print(spikes)

# %%
figure = nt.plot_raster(spikes, trial=0)

# %%
# From here on nothing differs from encoded signals: windows, a network, its decisions and their cost.

train, validation, test = nt.windows(spikes, nt.Window(length_ms=300, start_ms=50)).split(
    nt.Split(seed=0, test=0.3)
)
network = nt.SpikingClassifier(hidden=20, epochs=15, random_state=0)
network.fit(train.X, train.y, validation=(validation.X, validation.y))
print(f"accuracy {network.score(test.X, test.y):.0%}")
network.decide(test.X, early_exit=True)[["predicted", "ms", "input_spikes", "sops_total"]].head()
