"""Recordings of made-up sensors: of another rate, number of taxels, noise, drift and polarity, with a known truth."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd

from neurotact.data.recordings import Recordings

REST = 0.15
"""Share of a trial before its touch."""


class Made(NamedTuple):
    """A made-up sensor and what it touches.

    apart: how far classes lie apart in level and ripple, in shares of the first one's; 0: they do not differ. noise:
    standard deviation, in levels. drift: of a whole trial, in levels. sign: of the signal under touch, +1 or -1; 0:
    that of a taxel is random. ripple_Hz: of the first class.
    """

    trials: int = 150
    classes: int = 3
    taxels: int = 6
    rate_Hz: float = 150.0
    seconds: float = 1.2
    apart: float = 0.3
    noise: float = 0.2
    drift: float = 0.0
    sign: int = 1
    ripple_Hz: float = 6.0


SETS = {
    "clear": Made(apart=0.8, noise=0.1),
    "unclear": Made(apart=0.12, noise=0.6),
    "nothing": Made(apart=0.0, classes=2, noise=0.4),
    "few": Made(trials=36, rate_Hz=1000.0, taxels=8),
    "slow": Made(trials=200, rate_Hz=20.0, seconds=2.0, ripple_Hz=1.5, noise=0.4),
    "fast": Made(trials=120, rate_Hz=2000.0, taxels=3, ripple_Hz=60.0, apart=0.25, noise=0.8),
    "drift": Made(drift=3.0, apart=0.4),
    "falling": Made(sign=-1, taxels=4, noise=0.5),
    "either": Made(sign=0, taxels=12, noise=0.5, apart=0.2),
    "many": Made(trials=400, taxels=24, noise=0.9, apart=0.2, classes=5),
}
"""Each by its name."""


def touches(made: Made, seed: int = 0, speeds: Sequence[float] = ()) -> Recordings:
    """The recordings of a made-up sensor: trials of rest, then touch, of lengths that differ by a tenth.

    speeds: of the touches, in turn within each class, as the condition `speed`; ripples are as fast. None: all alike.

    >>> [len(touches(made).signals) for made in (SETS["few"], SETS["slow"])]
    [36, 200]
    """
    rng = np.random.default_rng(seed)
    gains = rng.uniform(0.5, 1.5, made.taxels) * (made.sign or rng.choice([-1, 1], made.taxels))
    shape = rng.normal(0, 1, (made.classes, made.taxels))
    signals, labels = [], np.arange(made.trials) % made.classes
    own = [speeds[trial // made.classes % len(speeds)] for trial in range(made.trials)] if speeds else []
    for trial, label in enumerate(labels):
        ripple_Hz = made.ripple_Hz * (own[trial] / speeds[0] if own else 1)
        time_s = np.arange(round(made.rate_Hz * made.seconds * rng.uniform(1.0, 1.1))) / made.rate_Hz
        since_s = np.maximum(time_s - REST * made.seconds * rng.uniform(0.9, 1.1), 0.0)[:, None]
        level = 1 + made.apart * (label + shape[label]) / 2 + 0.1 * rng.normal()
        ripple = 0.4 * np.sin(
            2 * np.pi * ripple_Hz * (1 + made.apart * label) * since_s + rng.uniform(0, 2 * np.pi, made.taxels)
        )
        touched = (since_s > 0) * (1 - np.exp(-since_s / 0.05)) * (level + ripple) * gains
        drift = made.drift * rng.normal(0, 1, made.taxels) * (time_s / made.seconds)[:, None]
        signals.append((touched + drift + rng.normal(0, made.noise, touched.shape)).astype(np.float32))
    conditions = {"label": [f"class {label}" for label in labels], **({"speed": own} if own else {})}
    return Recordings(signals, made.rate_Hz, "mV", pd.DataFrame(conditions))
