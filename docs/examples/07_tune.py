"""
Tune with a budget
==================

A search over hyperparameters that may spend only so many operations per window. Trials are proposed by TPE, judged on
validation windows, and stopped early when they fall behind.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt

import neurotact as nt

touches = nt.simulate(
    "gratings",
    trials=12,
    pitches_mm=[4.0, 2.0, 0.5],
    forces_N=[12.0],
    speeds_mm_per_s=[8.6],
    duration_s=0.4,
)
folder = Path(tempfile.mkdtemp())
nt.save(nt.encode(touches), folder / "spikes.h5")

# %%
# A search space in the terms of NNI. Every key of the network's spec can be in it.

space = {
    "hidden": {"_type": "choice", "_value": [5, 10, 20, 40]},
    "tau_mem_ms": {"_type": "loguniform", "_value": [3, 60]},
    "model": {"_type": "choice", "_value": ["snn", "rsnn"]},
}
search, window = (
    nt.Search(space=space, trials=12, max_sops=3000),
    nt.Window(length_ms=150, start_ms=100),
)
settings = {"training.epochs": 8}
trials = nt.tune(
    folder / "spikes.h5", folder / "search", settings=settings, search=search, window=window, workers=1
)
trials[["hidden", "model", "accuracy_validation", "sops_total"]].head()

# %%
# The best network within the budget is a run folder, like one that `nt.train` writes.

best = nt.result(folder / "search" / "best")
print((folder / "search" / "best.toml").read_text())
print(f"test accuracy {best['accuracy_test']:.0%} with {best['sops_total']:,.0f} SOPs per window")

# %%
figure, axes = plt.subplots(figsize=(6, 3.5), layout="constrained")
axes.scatter(trials["sops_total"], 100 * trials["accuracy_validation"])
axes.axvline(3000, color="grey", linestyle="--", label="budget")
axes.set(xlabel="SOPs per window", ylabel="validation accuracy (%)", xscale="log")
axes.legend()
plt.show()
