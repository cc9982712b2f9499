"""
Export to NIR
=============

The Neuromorphic Intermediate Representation (NIR) is a graph of neurons that other simulators and chips read. A fitted
pipeline is written, and read back the same.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import torch
from sklearn.pipeline import make_pipeline

import neurotact as nt

touches = nt.simulate(
    "gratings", trials=10, pitches_mm=[4.0, 1.0], forces_N=[12.0], speeds_mm_per_s=[8.6], duration_s=0.4
)
X, y = np.asarray(touches.signals), touches.conditions["label"].to_numpy()
encoder = nt.SpikeEncoder("sa1-ra1-lif", sampling_rate_Hz=touches.sampling_rate_Hz)
network = nt.SpikingClassifier(hidden=20, epochs=10, random_state=0)
pipeline = make_pipeline(encoder, network).fit(X, y)

# %%
# A graph has one clock. The encoder and the bins of this network's slower clock stay outside, which the export says; with
# `settings={"step_ms": "encoder"}` the afferents are part of the graph.

path = Path(tempfile.mkdtemp()) / "touch.nir"
graph = nt.to_nir(pipeline, path)
for name, node in graph.nodes.items():
    print(f"{name}: {type(node).__name__}")

# %%
# Read back, the network decides as before. What a chip does not take can be asked for:

again = nt.from_nir(path)
spikes = np.asarray(encoder.transform(X))
labels = again.network.infer(torch.from_numpy(spikes)).labels.numpy()
print("equal decisions:", bool((network.classes_[labels] == pipeline.predict(X)).all()))
limits = nt.check_chip(pipeline, "loihi2")
limits.loc[~limits["fits"], ["what", "here", "limit"]]

# %%
# The input weights of the graph: a row per hidden neuron, a column per afferent.

figure, axes = plt.subplots(figsize=(5, 4), layout="constrained")
image = axes.imshow(again.network.w_in.detach().numpy().T, cmap="RdBu", aspect="auto")
axes.set(xlabel="afferent", ylabel="hidden neuron")
figure.colorbar(image, label="weight")
plt.show()
