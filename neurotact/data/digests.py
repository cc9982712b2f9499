"""Digests of trials: the same content has the same digest, whatever file and place it lies in.

They tell whether a network has seen a trial before. A digest is the first 16 hexadecimal digits of a SHA-256.
"""

import hashlib
import json
from typing import Any

import numpy as np

from neurotact.data.recordings import Recordings
from neurotact.data.spikes import SpikeTrains

DIGITS = 16


def recorded_digests(recordings: Recordings) -> tuple[str, ...]:
    """A digest a trial of what was recorded: samples, sampling rate, unit and channels; not its label.

    >>> import pandas as pd
    >>> once, again = np.ones((4, 2)), np.zeros((4, 2))
    >>> touch = Recordings([once, again, once], 2000.0, "mV", pd.DataFrame({"label": ["felt", "silk", "silk"]}))
    >>> first, second, third = recorded_digests(touch)
    >>> len(first), first == third, first == second
    (16, True, False)
    """
    about = [float(recordings.sampling_rate_Hz), recordings.unit, list(recordings.channels)]
    return tuple(
        _digest([*about, list(signal.shape)], signal.astype("<f4", copy=False)) for signal in recordings.signals
    )


def spike_digests(trains: SpikeTrains) -> tuple[str, ...]:
    """A digest a trial of its spikes: events, length, clock and afferents; not its label.

    It tells trials apart less well than what was recorded does: two silent trials of one length have the same.
    """
    about = [float(trains.sampling_rate_Hz), list(trains.afferents)]
    events = zip(trains.steps, trains.units, trains.trial_steps.tolist(), strict=True)
    return tuple(
        _digest([*about, n_steps, len(steps)], steps.astype("<i8"), units.astype("<i8"))
        for steps, units, n_steps in events
    )


def _digest(about: list[Any], *arrays: np.ndarray) -> str:
    content = hashlib.sha256(json.dumps(about).encode())
    for array in arrays:
        content.update(np.ascontiguousarray(array).data)
    return content.hexdigest()[:DIGITS]
