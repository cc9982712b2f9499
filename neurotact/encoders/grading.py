"""The thresholds of graded afferents: even quantiles of their drive in training trials."""

from collections.abc import Iterable

import numpy as np

from neurotact.encoders.afferents import AfferentSpec

MOST_VALUES = 1_000_000
"""Steps of a trial that are sampled; in a longer trial every second step, or every third, and so on."""


def sample(drive: Iterable[np.ndarray], n_values: int) -> np.ndarray:
    """The positive values of trials `(time, taxel)` with `n_values` values in all, at most `MOST_VALUES`.

    >>> sample([np.array([[1.0, -1.0], [2.0, 3.0]])], 4).tolist()
    [1.0, 2.0, 3.0]
    """
    every = -(-n_values // MOST_VALUES)
    parts = [signal[::every] for signal in drive]
    return np.concatenate([part[part > 0] for part in parts])


def fit(drive: np.ndarray, spec: AfferentSpec, gain: float, n_grades: int) -> tuple[float, ...]:
    """Grades of a gain whose thresholds are at even quantiles of the positive drive.

    The i-th of k thresholds lies at the quantile (i - 1/2)/k: a constant signal of that size, times gain and grade,
    just reaches the threshold of the membrane. Rounded to three digits; equal grades are merged.
    drive: positive values, in the unit of the gain.

    >>> spec = AfferentSpec.model_validate({"sa1": {"gain": 1}, "ra1": {"gain": 1}})
    >>> fit(np.linspace(0, 8, 1001), spec, gain=5.0, n_grades=4)
    (0.286, 0.4, 0.667, 2.0)
    """
    if not len(drive):
        return (1.0,)
    places = (np.arange(n_grades) + 0.5) / n_grades
    levels = np.quantile(drive, places) * gain / (spec.v_threshold_mV - spec.v_rest_mV)
    return tuple(sorted({float(f"{1 / level:.3g}") for level in levels}))
