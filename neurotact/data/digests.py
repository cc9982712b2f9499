"""Digests of trials, and of all trials of a file: the same content has the same digest in any file and at any index.

They show whether a network has seen a trial before, and whether a study is one of the same recordings. A digest is the
first 16 hexadecimal digits of a SHA-256.
"""

import hashlib
import json
from collections.abc import Iterable
from typing import Any

import numpy as np

from neurotact.data.conditioning import pieces
from neurotact.data.recordings import Trials
from neurotact.data.spikes import SpikeTrains

DIGITS = 16
DIGEST = "recorded_digest"
"""The name of the digest of the recorded signal in files of other formats."""
TOUCH = "recorded_touch"
"""The name of `SpikeTrains.trial_touches` there."""


def recorded_digest(recordings: Trials, trial: int) -> str:
    """The digest of a trial's recording: samples, sampling rate, unit and channels; not its label.

    >>> import pandas as pd
    >>> from neurotact.data.recordings import Recordings
    >>> once, again = np.ones((4, 2)), np.zeros((4, 2))
    >>> touch = Recordings([once, again, once], 2000.0, "mV", pd.DataFrame({"label": ["felt", "silk", "silk"]}))
    >>> first, second, third = (recorded_digest(touch, trial) for trial in range(3))
    >>> len(first), first == third, first == second
    (16, True, False)
    """
    shape = [int(recordings.lengths[trial]), recordings.n_channels]
    about = [float(recordings.sampling_rate_Hz), recordings.unit, list(recordings.channels), shape]
    return _digest(about, (piece.astype("<f4", copy=False) for piece in pieces(recordings, trial)))


def spike_digests(trains: SpikeTrains) -> tuple[str, ...]:
    """One digest per trial of its spikes: events, length, clock and afferents; not its label.

    It distinguishes trials less well than the digest of the recording: two silent trials of equal length have the same.
    """
    about = [float(trains.sampling_rate_Hz), list(trains.afferents)]
    events = zip(trains.steps, trains.units, trains.trial_steps.tolist(), strict=True)
    return tuple(
        _digest([*about, n_steps, len(steps)], (steps.astype("<i8", copy=False), units.astype("<i8", copy=False)))
        for steps, units, n_steps in events
    )


def recorded_trials(recordings: Trials, trains: SpikeTrains, trials: np.ndarray) -> np.ndarray | None:
    """The trial of the recordings that each of some spike trains was encoded from, `(trial,)`; None if of others.

    Trials are recognised by their content. As many trials with the same classes are looked up at their own numbers
    first; else, since the spikes may be those of a choice of trials, all recordings are read once. Spikes without
    digests, of earlier versions, are taken to be of recordings that look alike.
    """
    looks_alike = len(recordings) == len(trains) and list(recordings.labels) == list(trains.labels)
    if not trains.trial_digests:
        return trials if looks_alike else None
    wanted = [trains.trial_digests[trial] for trial in trials.tolist()]
    if looks_alike and wanted == [recorded_digest(recordings, trial) for trial in trials.tolist()]:
        return trials
    place_of = {recorded_digest(recordings, trial): trial for trial in range(len(recordings))}
    rows = [place_of.get(digest) for digest in wanted]
    return None if None in rows else np.array(rows, np.int64)


def again(digest: str, number: int) -> str:
    """Another digest, of a digest and a number.

    >>> again("0123456789abcdef", 1) == again("0123456789abcdef", 2)
    False
    """
    return _digest([digest, number], ())


def content_digest(touches: Trials | SpikeTrains) -> str:
    """The digest of all trials in their order, with their classes and conditions.

    >>> from neurotact.data.recordings import Recordings
    >>> once, other = (Recordings(np.ones((2, 4, 1)), 2000.0, "mV", labels) for labels in (["a", "b"], ["b", "a"]))
    >>> content_digest(once) == content_digest(once), content_digest(once) == content_digest(other)
    (True, False)
    """
    if isinstance(touches, SpikeTrains):
        digests = spike_digests(touches)
    else:
        digests = tuple(recorded_digest(touches, trial) for trial in range(len(touches)))
    table = touches.conditions.astype(str)
    return _digest([*digests, list(map(str, table.columns)), table.to_numpy().tolist()], ())


def _digest(about: list[Any], arrays: Iterable[np.ndarray]) -> str:
    content = hashlib.sha256(json.dumps(about).encode())
    for array in arrays:
        content.update(np.ascontiguousarray(array).data)
    return content.hexdigest()[:DIGITS]
