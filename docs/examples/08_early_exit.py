"""
Decide early
============

A network need not see the whole window. It may stop when its leading class has not changed for a while; how long is
chosen on validation windows, so that accuracy there stays within a tolerance. It is used if they are enough to show
that: each part of them judges what the others choose.
"""

import matplotlib.pyplot as plt

import neurotact as nt

touches = nt.simulate(
    "gratings",
    trials=60,
    pitches_mm=[4.0, 2.0, 0.5],
    forces_N=[12.0],
    speeds_mm_per_s=[8.6],
    duration_s=0.6,
)
data = nt.windows(nt.encode(touches), nt.Window(length_ms=300, start_ms=150))
train, validation, test = data.split(nt.Split(seed=0, validation=0.4, test=0.3))

# %%
# `exit_tolerance` is the accuracy that may be lost. `bound` is the most that validation windows leave possible.

network = nt.SpikingClassifier(hidden=30, epochs=15, exit_tolerance=0.15, random_state=0)
network.fit(train.X, train.y, validation=(validation.X, validation.y))
print(network.exit_rule_, f"loses at most {network.exit_choice_.bound:.1%}")
print("used:", network.exit_choice_.used)

# %%
# Each window: what it was taken for, after how long, and at which cost.

full = network.decide(test.X)
early = network.decide(test.X, early_exit=True)
for name, table in {"whole window": full, "early exit": early}.items():
    means = table.assign(right=table["predicted"] == test.y)[["ms", "sops_total", "right"]].mean()
    print(
        f"{name}: {means['ms']:.0f} ms, {means['sops_total']:,.0f} SOPs, accuracy {means['right']:.0%}"
    )
early[["predicted", "ms", "input_spikes", "sops_total"]].head()

# %%
figure, axes = plt.subplots(figsize=(6, 3), layout="constrained")
names = [str(name) for name in network.classes_]
axes.hist([early["ms"][test.y == name] for name in names], bins=15, stacked=True, label=names)
axes.axvline(300, color="grey", linestyle="--")
axes.set(xlabel="decided after (ms)", ylabel="windows")
axes.legend(title="grating")
plt.show()
