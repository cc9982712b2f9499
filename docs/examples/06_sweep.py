"""
A sweep: a picture and a table
==============================

How large must the network be, and how long the window? A loop over both, a table of all results, and a picture of the
trade-off between accuracy and operations.
"""

import matplotlib.pyplot as plt
import pandas as pd

import neurotact as nt

touches = nt.simulate(
    "gratings",
    trials=16,
    pitches_mm=[4.0, 2.0, 0.5],
    forces_N=[12.0],
    speeds_mm_per_s=[8.6],
    duration_s=0.6,
)
spikes = nt.encode(touches)

# %%
# One network for each cell of the sweep. The split depends on the trials alone, and is the same for all.

rows: list[dict[str, float]] = []
for length_ms in (50, 100, 200):
    data = nt.windows(spikes, nt.Window(length_ms=length_ms, start_ms=200, per_trial=1))
    train, validation, test = data.split(nt.Split(seed=1, test=0.3))
    for hidden in (5, 15, 45):
        network = nt.SpikingClassifier(hidden=hidden, epochs=10, random_state=0)
        network.fit(train.X, train.y, validation=(validation.X, validation.y))
        rows.append(
            {
                "window (ms)": length_ms,
                "hidden": hidden,
                "accuracy": float(network.score(test.X, test.y)),
                "SOPs": float(network.sops(test.X).total.mean()),
            }
        )
table = pd.DataFrame(rows)
table.round(2)

# %%
figure, axes = plt.subplots(figsize=(6, 3.5), layout="constrained")
for length_ms in (50, 100, 200):
    mine = [row for row in rows if row["window (ms)"] == length_ms]
    costs, shares = [row["SOPs"] for row in mine], [100 * row["accuracy"] for row in mine]
    axes.plot(costs, shares, "o-", label=f"{length_ms} ms")
axes.set(xlabel="SOPs per window", ylabel="test accuracy (%)", xscale="log", ylim=(0, 105))
axes.legend(title="window")
plt.show()

# %%
# `nt.run_study` does the same from a TOML file, over processes and machines, resumes where it was stopped, and writes a
# report.
