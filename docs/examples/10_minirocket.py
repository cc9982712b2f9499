"""
Is it good? Compare with MiniRocket
===================================

A spiking network deserves an opponent that is quick to train and hard to beat. MiniRocket takes the raw signals, a
ridge classifier decides; the network takes the spikes.
"""

from time import perf_counter

import matplotlib.pyplot as plt
import numpy as np
from neurotact_parts.opponents import MiniRocketClassifier
from sklearn.model_selection import train_test_split
from sklearn.pipeline import make_pipeline

import neurotact as nt

touches = nt.simulate(
    "gratings",
    trials=16,
    pitches_mm=[4.0, 2.0, 1.0, 0.5],
    forces_N=[12.0],
    speeds_mm_per_s=[8.6],
    duration_s=0.4,
)
X, y = np.asarray(touches.signals), touches.conditions["label"].to_numpy()
sides = train_test_split(X, y, test_size=0.3, stratify=y, random_state=0)
X_train, X_test, y_train, y_test = (np.asarray(side) for side in sides)

# %%
# Both get the same trials.

spiking = make_pipeline(
    nt.SpikeEncoder("sa1-ra1-lif", sampling_rate_Hz=touches.sampling_rate_Hz),
    nt.SpikingClassifier(epochs=20, random_state=0),
)
rows: dict[str, tuple[float, float]] = {}
for name, estimator in {
    "spiking network": spiking,
    "MiniRocket": MiniRocketClassifier(random_state=0),
}.items():
    began = perf_counter()
    estimator.fit(X_train, y_train)
    rows[name] = float(estimator.score(X_test, y_test)), perf_counter() - began
    print(f"{name}: accuracy {rows[name][0]:.0%}, trained in {rows[name][1]:.1f} s")

# %%
# What the network buys is not accuracy but operations: see the example on costs.

figure, axes = plt.subplots(figsize=(5, 3), layout="constrained")
axes.bar(list(rows), [100 * accuracy for accuracy, _ in rows.values()], color=["C0", "C1"])
axes.set(ylabel="test accuracy (%)", ylim=(0, 105))
plt.show()
