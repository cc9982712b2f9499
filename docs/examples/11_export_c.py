"""
Export to C
===========

A fitted pipeline becomes C99 without dependencies: conditioning, afferents, network and early exit, in integers, from a
raw sample to a decision.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from sklearn.pipeline import make_pipeline

import neurotact as nt

touches = nt.simulate(
    "gratings", trials=10, pitches_mm=[4.0, 1.0], forces_N=[12.0], speeds_mm_per_s=[8.6], duration_s=0.4
)
encoder = nt.SpikeEncoder("sa1-ra1-lif", sampling_rate_Hz=touches.sampling_rate_Hz)
network = nt.SpikingClassifier(hidden=20, epochs=15, random_state=0)
pipeline = make_pipeline(encoder, network).fit(
    np.asarray(touches.signals), touches.conditions["label"].to_numpy()
)

# %%
# The recordings give the range of the samples, from which the formats of the integers are chosen. `prove` would compile
# the code, run it here and in an emulator, and compare it spike by spike.

folder = Path(tempfile.mkdtemp()) / "touch"
made = nt.export_c(pipeline, folder, recordings=touches)
for path in sorted(folder.iterdir()):
    print(f"{path.name}: {len(path.read_text().splitlines())} lines")

# %%
# The interface of the code:

header = (folder / "touch.h").read_text().splitlines()
print(
    "\n".join(
        line for line in header if line.startswith(("typedef", "int", "void", "const", "#define"))
    )
)

# %%
# What rounding did to the input weights: 8 bits, in steps of a common power of two.

assert made.formats is not None
weights = network.network_.get_parameter("w_in").detach().numpy()
figure, axes = plt.subplots(figsize=(5, 3), layout="constrained")
axes.plot(weights.ravel(), np.asarray(made.formats.hidden.w).ravel(), ".", markersize=3)
axes.set(xlabel="weight as trained", ylabel="weight in C (digits)")
plt.show()
