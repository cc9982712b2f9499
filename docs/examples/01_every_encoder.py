"""
One touch through every encoder
===============================

The same slide of a finger over a grating, as spikes of each encoder that ships. Gains and thresholds are the shipped
ones, of the texture paper's sensor; `nt.calibrate` chooses them for another.
"""

import matplotlib.pyplot as plt
import numpy as np

import neurotact as nt

touch = nt.simulate(
    "gratings", trials=1, pitches_mm=[2.0], forces_N=[12.0], speeds_mm_per_s=[8.6], duration_s=0.6
)
print(touch)

# %%
# Every encoder takes the signals `(time, taxel)` in mV at 2 kHz, and gives spikes of named afferents. Some of them
# also send spikes for the fall of a signal, so that a taxel has two or more afferents.

trains: dict[str, nt.SpikeTrains] = {}
for name in nt.spec_names("encoders"):
    try:
        trains[name] = nt.encode(touch, name)
    except nt.InputError as error:  # an encoder of another sensor, which calibration adapts
        print(f"{name}: {error}")
for name, train in trains.items():
    print(f"{name:24s} {len(train.afferents):3d} afferents, {len(train.steps[0]):5d} spikes")

# %%
# The taxels above, then a raster for each encoder: a line of dots is an afferent, time goes to the right.

figure, axes = plt.subplots(len(trains) + 1, 1, figsize=(8, 12), sharex=True, layout="constrained")
signal = np.asarray(touch.signals[0])
axes[0].plot(1e3 * np.arange(len(signal)) / touch.sampling_rate_Hz, signal, linewidth=0.8)
axes[0].set_ylabel("mV")
for row, (name, train) in zip(axes[1:], trains.items(), strict=True):
    time_ms = 1e3 * train.steps[0] / train.sampling_rate_Hz
    row.plot(time_ms, train.units[0], "|", markersize=2.5, color="black")
    row.set_yticks([])
    row.set_ylabel(name, rotation=0, ha="right", va="center")
axes[-1].set_xlabel("time (ms)")
plt.show()
