"""
What a refractory period saves
==============================

After a spike an afferent is silent for its refractory period. A longer one means fewer spikes, so fewer synaptic
operations (SOPs) in the network behind. Is the texture still recognised?
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
print(touches)

# %%
# Each period is encoded, cut into windows of 150 ms, and classified by a network of its own. The trials are divided in
# the same way each time.

periods_ms = [1.0, 2.0, 5.0, 10.0, 20.0]
sent: list[float] = []
operations: list[float] = []
accuracies: list[float] = []
for t_ref_ms in periods_ms:
    spikes = nt.encode(touches, "sa1-ra1-lif", {"sa1.t_ref_ms": t_ref_ms, "ra1.t_ref_ms": t_ref_ms})
    train, validation, test = nt.windows(spikes, nt.Window(length_ms=150, start_ms=150)).split(
        nt.Split(seed=0, test=0.3)
    )
    network = nt.SpikingClassifier(hidden=20, epochs=10, random_state=0)
    network.fit(train.X, train.y, validation=(validation.X, validation.y))
    sent.append(float(test.X.sum(axis=(1, 2)).mean()))
    operations.append(float(network.sops(test.X).total.mean()))
    accuracies.append(float(network.score(test.X, test.y)))
    print(f"{t_ref_ms:4g} ms: {operations[-1]:6,.0f} SOPs per window, accuracy {accuracies[-1]:.0%}")

# %%
# A few windows tell only large differences of accuracy apart; the study `refractory-period` trains 216 networks.

figure, (left, middle, right) = plt.subplots(1, 3, figsize=(9, 3), layout="constrained")
left.plot(periods_ms, sent, "o-")
left.set(xlabel="refractory period (ms)", ylabel="afferent spikes per window", ylim=(0, None))
middle.plot(periods_ms, operations, "o-")
middle.set(xlabel="refractory period (ms)", ylabel="SOPs per window", ylim=(0, None))
right.plot(periods_ms, [100 * accuracy for accuracy in accuracies], "o-")
right.set(xlabel="refractory period (ms)", ylabel="test accuracy (%)", ylim=(0, 105))
plt.show()
