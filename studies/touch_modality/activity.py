"""When a touch begins: a channel leaves the band of the resting sensor."""

from typing import NamedTuple

import numpy as np
from pydantic import Field, model_validator

from neurotact.errors import InputError
from neurotact.spec import Spec


class ActivityBand(Spec):
    """The voltages of a sensor at rest; values outside are touch.

    The touch-modality paper mentions a predefined threshold (Sec. IV-A) without its value; the values here, and the
    samples before the onset, are those of the authors' public code.
    """

    low_V: float = 1.62
    high_V: float = 1.68
    lead_samples: int = Field(default=50, ge=0)
    """Samples before the first one outside the band (public code; the paper's Algorithm starts at that sample)."""

    @model_validator(mode="after")
    def _is_a_band(self) -> "ActivityBand":
        if self.low_V >= self.high_V:
            raise ValueError(f"low_V must be below high_V; got {self.low_V} and {self.high_V}")
        return self


class Activity(NamedTuple):
    """The first and the last sample at which any channel is outside the band."""

    first: int
    last: int


def find_activity(signal: np.ndarray, band: ActivityBand) -> Activity | None:
    """The active stretch of a `(time, channel)` signal in V; None when no channel ever leaves the band.

    >>> signal = np.full((6, 2), 1.65)
    >>> find_activity(signal, ActivityBand()) is None
    True
    >>> signal[2, 0], signal[4, 1] = 1.61, 1.69
    >>> find_activity(signal, ActivityBand())
    Activity(first=2, last=4)
    """
    outside = np.flatnonzero(((signal < band.low_V) | (signal > band.high_V)).any(axis=1))
    return Activity(int(outside[0]), int(outside[-1])) if len(outside) else None


def cut_from_onset(signal: np.ndarray, n_samples: int, band: ActivityBand) -> np.ndarray | None:
    """`n_samples` of a `(time, channel)` signal in V from its onset on; None for a silent signal.

    The stretch starts `band.lead_samples` before the onset, at 0 at the earliest; if a late onset would leave
    fewer than `n_samples`, it is the last `n_samples` of the recording. A view, not a copy.

    Raises InputError for a recording shorter than `n_samples`.

    >>> signal = np.full((100, 1), 1.65)
    >>> signal[60:, 0] = 1.7
    >>> len(cut_from_onset(signal, 80, ActivityBand(lead_samples=5)))
    80
    """
    if len(signal) < n_samples:
        raise InputError(
            f"onset: a recording has {len(signal)} samples, fewer than the {n_samples} to cut; lengthen it"
        )
    activity = find_activity(signal, band)
    if activity is None:
        return None
    start = min(max(activity.first - band.lead_samples, 0), len(signal) - n_samples)
    return signal[start : start + n_samples]
