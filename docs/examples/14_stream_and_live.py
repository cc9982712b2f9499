"""
Stream, and watch it live
=========================

A fitted pipeline decides samples as they arrive, in blocks of any size, and equals what it decides on the whole touch.
"""

import matplotlib.pyplot as plt
import numpy as np
from sklearn.pipeline import make_pipeline

import neurotact as nt

touches = nt.simulate(
    "gratings", trials=12, pitches_mm=[4.0, 1.0], forces_N=[12.0], speeds_mm_per_s=[8.6], duration_s=0.4
)
encoder = nt.SpikeEncoder("sa1-ra1-lif", sampling_rate_Hz=touches.sampling_rate_Hz)
network = nt.SpikingClassifier(hidden=20, epochs=15, random_state=0)
pipeline = make_pipeline(encoder, network).fit(
    np.asarray(touches.signals), touches.conditions["label"].to_numpy()
)

# %%
# Blocks of 13 samples, some of them lost: a missing value repeats the last one, and the decision says so.

stream = nt.Stream(pipeline)
signal = np.array(touches.signals[0])
signal[300:305] = np.nan
decisions: list[nt.Decision] = []
for begin in range(0, len(signal), 13):
    decisions += stream.push(signal[begin : begin + 13])
for decision in decisions:
    print(
        f"{decision.label} after {decision.ms:g} ms, {decision.sops} SOPs, {decision.held} steps on repeated values"
    )
print(stream.tally)

# %%
# The touch, and when it was decided.

figure, axes = plt.subplots(figsize=(7, 3), layout="constrained")
axes.plot(1e3 * np.arange(len(signal)) / touches.sampling_rate_Hz, signal, linewidth=0.8)
for decision in decisions:
    axes.axvline(decision.ms, color="black", linestyle="--", label=f"decided: {decision.label}")
axes.set(xlabel="time (ms)", ylabel="signal (mV)")
axes.legend()
plt.show()

# %%
# `nt.live(pipeline, "gratings")` shows the same chain on a local page, with a simulated finger that the page moves and
# sliders for refractory periods, gains and patience. `nt.live(pipeline, "serial:/dev/ttyUSB0")` reads a device.
