"""Where the thresholds of graded afferents lie: at even quantiles of what they feel in training trials."""

from collections.abc import Iterable

import numpy as np

from neurotact.encoders.afferents import AfferentSpec

MOST_VALUES = 1_000_000
"""Steps of a trial that are sampled; of a longer trial every second step is, or every third, and so on."""


def sample(felt: Iterable[np.ndarray], n_values: int) -> np.ndarray:
    """The positive values of trials `(time, taxel)` that hold `n_values` together, at most `MOST_VALUES`.

    >>> sample([np.array([[1.0, -1.0], [2.0, 3.0]])], 4).tolist()
    [1.0, 2.0, 3.0]
    """
    every = -(-n_values // MOST_VALUES)
    parts = [signal[::every] for signal in felt]
    return np.concatenate([part[part > 0] for part in parts])


def fit(felt: np.ndarray, spec: AfferentSpec, gain: float, n_grades: int) -> tuple[float, ...]:
    """Grades of a gain whose thresholds lie at even quantiles of what is felt when anything is.

    The i-th of k thresholds lies at the quantile (i - 1/2)/k: a constant signal of that size, times gain and grade,
    just reaches the threshold of the membrane. Rounded to three digits; fewer grades where some would be equal.
    felt: positive values, in the unit of the gain.

    >>> spec = AfferentSpec.model_validate({"sa1": {"gain": 1}, "ra1": {"gain": 1}})
    >>> fit(np.linspace(0, 8, 1001), spec, gain=5.0, n_grades=4)
    (0.286, 0.4, 0.667, 2.0)
    """
    if not len(felt):
        return (1.0,)
    places = (np.arange(n_grades) + 0.5) / n_grades
    levels = np.quantile(felt, places) * gain / (spec.v_threshold_mV - spec.v_rest_mV)
    return tuple(sorted({float(f"{1 / level:.3g}") for level in levels}))
