"""
What a decision costs
=====================

The cost ledger counts what is computed for a decision, such as multiplications (MACs) and additions (ACs), what is read
from memory and written to it, and how long the touch lasts. The energy is an estimate of both, by memory-45nm.
"""

import matplotlib.pyplot as plt

import neurotact as nt

touches = nt.simulate(
    "gratings",
    trials=16,
    pitches_mm=[4.0, 2.0, 0.5],
    forces_N=[12.0],
    speeds_mm_per_s=[8.6],
    duration_s=0.6,
)

# %%
# The same network behind afferents with three refractory periods, with and without early exit.

ledgers = {}
for t_ref_ms in (1.0, 5.0, 20.0):
    spikes = nt.encode(touches, settings={"sa1.t_ref_ms": t_ref_ms, "ra1.t_ref_ms": t_ref_ms})
    train, validation, test = nt.windows(spikes, nt.Window(length_ms=200, start_ms=150)).split(
        nt.Split(seed=0, test=0.3)
    )
    network = nt.SpikingClassifier(hidden=20, epochs=10, exit_tolerance=0.05, random_state=0)
    network.fit(train.X, train.y, validation=(validation.X, validation.y))
    ledgers[f"{t_ref_ms:g} ms"] = network.costs(test.X)
    ledgers[f"{t_ref_ms:g} ms, early"] = network.costs(test.X, early_exit=True)
ledgers["1 ms"][["name", "macs", "acs", "sops", "energy_estimate_nJ"]].round(1)

# %%
# Afferents are computed at every step, whatever they send; the network's additions follow the spikes.

parts = {name: ledger.set_index("name")["energy_estimate_nJ"] for name, ledger in ledgers.items()}
figure, axes = plt.subplots(figsize=(7, 3), layout="constrained")
axes.barh(list(parts), [part["encoder"] for part in parts.values()], label="encoder")
axes.barh(
    list(parts), [part["network"] for part in parts.values()], left=[part["encoder"] for part in parts.values()],
    label="network",
)  # fmt: skip
axes.set(xlabel="energy estimate per decision (nJ)")
axes.legend()
plt.show()
