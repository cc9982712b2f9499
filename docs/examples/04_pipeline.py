"""
Pipeline and cross-validation
=============================

The encoder and the network are scikit-learn estimators. In a pipeline, the scales and gains of the encoder are chosen
anew in each fold, on the trials that the fold trains on, so that no test trial has a say in them.
"""

import matplotlib.pyplot as plt
import numpy as np
from sklearn.metrics import ConfusionMatrixDisplay
from sklearn.model_selection import cross_val_predict
from sklearn.pipeline import make_pipeline

import neurotact as nt

touches = nt.simulate(
    "gratings",
    trials=9,
    pitches_mm=[4.0, 2.0, 0.5],
    forces_N=[12.0],
    speeds_mm_per_s=[8.6],
    duration_s=0.3,
)
X = np.asarray(touches.signals)  # (trial, time, taxel), in mV
y = touches.conditions["label"].to_numpy()
print(X.shape)

# %%
# A plain array has no clock, so that the encoder must be told it.

encoder = nt.SpikeEncoder("sa1-ra1-lif", sampling_rate_Hz=touches.sampling_rate_Hz)
network = nt.SpikingClassifier(hidden=20, epochs=15, random_state=0)
pipeline = make_pipeline(encoder, network)
predicted = np.asarray(cross_val_predict(pipeline, X, y, cv=3))
print(f"accuracy {np.mean(predicted == y):.0%}")

# %%
# What is mistaken for what. Every trial is decided by a network that was not trained on it.

ConfusionMatrixDisplay.from_predictions(y, predicted, cmap="Blues", colorbar=False)
plt.show()

# %%
# Keys of the specs are parameters, too, with two underscores for each dot: a grid could be
# `{"spikeencoder__sa1__t_ref_ms": [1, 5], "spikingclassifier__hidden": [20, 40]}`.

pipeline.set_params(spikeencoder__sa1__t_ref_ms=5, spikingclassifier__hidden=40).fit(X, y)
print(encoder.settings, network.network_)
