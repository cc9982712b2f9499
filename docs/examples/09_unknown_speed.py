"""
A speed that was never trained
==============================

Random splits hide what matters in use: the speed of the next touch is not one of those in training. `test_where` asks
the harder question.
"""

import matplotlib.pyplot as plt

import neurotact as nt

touches = nt.simulate(
    "gratings",
    trials=16,
    pitches_mm=[4.0, 1.0],
    forces_N=[12.0],
    speeds_mm_per_s=[4.3, 8.6, 12.9],
    duration_s=0.6,
)
data = nt.windows(nt.encode(touches), nt.Window(length_ms=300, start_ms=200, per_trial=1))
touches.conditions[["label", "force_N", "speed_mm_per_s", "trial"]].head(3)


# %%
# One network per question. `nested` validation leaves out another speed, too, so that early stopping is asked the same.


def accuracy(speed_mm_per_s: float | None) -> float:
    """Test accuracy on a random share of the trials, or on one speed that was left out of training."""
    left_out = None if speed_mm_per_s is None else {"speed_mm_per_s": speed_mm_per_s}
    sides = (
        data.split(nt.Split(seed=0, test=0.3))
        if left_out is None
        else data.split(nt.Split(test_where=left_out))
    )
    network = nt.SpikingClassifier(hidden=30, epochs=25, random_state=0)
    network.fit(sides.train.X, sides.train.y, validation=(sides.validation.X, sides.validation.y))
    return float(network.score(sides.test.X, sides.test.y))


asked = {"random trials": None, "4.3 mm/s": 4.3, "8.6 mm/s": 8.6, "12.9 mm/s": 12.9}
found = {name: accuracy(speed) for name, speed in asked.items()}

# %%
figure, axes = plt.subplots(figsize=(6, 3), layout="constrained")
axes.bar(list(found), [100 * share for share in found.values()], color=["grey", "C0", "C0", "C0"])
axes.axhline(50, color="black", linestyle="--", linewidth=0.8, label="chance")
axes.set(xlabel="tested on", ylabel="test accuracy (%)", ylim=(0, 105))
axes.legend()
plt.show()

# %%
# Random trials flatter: their network met every speed in training. The page on unknown conditions has the whole study.
