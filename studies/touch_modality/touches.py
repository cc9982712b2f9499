"""The touches that the studies of this paper share: Dataset A, read or simulated, and its folds."""

from collections.abc import Iterator, Sequence
from typing import Literal, NamedTuple

import numpy as np
import pandas as pd
from neurotact_parts.studies.touch_modality.activity import ActivityBand, cut_from_onset, find_activity
from neurotact_parts.studies.touch_modality.datasets import ARRAY_SIDE, TOUCH_SAMPLES, WindowRule
from neurotact_parts.studies.touch_modality.folds import Fold, folds_by_person, folds_in_order
from neurotact_parts.studies.touch_modality.simulator import TouchModalitySpec, each_person

from neurotact.data import doubtful
from neurotact.data.hdf5 import load_recordings
from neurotact.errors import InputError
from neurotact.spec import Spec
from neurotact.studies.way import Arrays

TAXELS = ARRAY_SIDE**2


class TouchData(Spec):
    """The touches, and their conversion to sequences."""

    recordings: str = ""
    """An HDF5 file that `neurotact import touch-modality` (or `simulate touch-modality`) wrote; none: simulated."""
    simulation: TouchModalitySpec = TouchModalitySpec()
    band: ActivityBand = ActivityBand()
    windows: WindowRule = "overlap"


class Touches(NamedTuple):
    """Dataset A with the known facts about each pattern; persons is empty if the recordings have none."""

    patterns: np.ndarray
    labels: np.ndarray
    persons: np.ndarray
    activity_s: np.ndarray
    recorded: dict[str, int]
    sampling_rate_Hz: float


def touches_of(data: TouchData) -> Touches:
    """Dataset A of the touches of `data`, sorted by class as folders are.

    Recordings are read or simulated person by person, so that they are never in memory together. Raises InputError for
    a file without 16 channels, and if no signal leaves the band.
    """
    cuts, rows, recorded = [], [], {}
    rate_Hz = data.simulation.sampling_rate_Hz
    for signals, table, rate_Hz in _portions(data):
        for signal, row in zip(signals, table.to_dict("records"), strict=True):
            recorded[row["label"]] = recorded.get(row["label"], 0) + 1
            cut, activity = cut_from_onset(signal, TOUCH_SAMPLES, data.band), find_activity(signal, data.band)
            if cut is not None and activity is not None:
                cuts.append(cut.astype(np.float32))
                rows.append({**row, "activity_s": (activity.last - activity.first) / rate_Hz})
    if not cuts:
        raise InputError(
            f"{data.recordings or 'touches'}: no signal leaves the band {data.band.low_V} to {data.band.high_V} V; "
            "set data.band.low_V and data.band.high_V around this sensor's rest"
        )
    kept = pd.DataFrame(rows)
    order = np.argsort(kept["label"].to_numpy(str), kind="stable")
    patterns = np.empty((len(cuts), *cuts[0].shape), np.float32)
    for number, index in enumerate(order):
        patterns[number], cuts[index] = cuts[index], cuts[index][:0]
    kept = kept.iloc[order]
    persons = kept["person"].to_numpy(np.int64) if "person" in kept else np.array([], np.int64)
    return Touches(
        patterns, kept["label"].to_numpy(str), persons, kept["activity_s"].to_numpy(float), recorded, rate_Hz
    )


def _portions(data: TouchData) -> Iterator[tuple[np.ndarray, pd.DataFrame, float]]:
    if not data.recordings:
        for signals, table in each_person(data.simulation):
            yield signals, table, data.simulation.sampling_rate_Hz
        return
    recordings = load_recordings(data.recordings).to_unit("V")
    if recordings.n_channels != TAXELS:
        raise InputError(f"{data.recordings}: has {recordings.n_channels} channels where the 4 x 4 array has 16")
    doubtful.warn(recordings)  # the published folds are in the order of the files
    yield np.asarray(recordings.signals), recordings.conditions, recordings.sampling_rate_Hz


def typical(patterns: np.ndarray, members: np.ndarray) -> int:
    """The index in `patterns` of the member of median strength."""
    strength = np.array([np.ptp(patterns[i], axis=0).max() for i in members])
    return int(members[np.argsort(strength)[len(members) // 2]])


def folds_of(protocol: Literal["paper", "honest"], data: TouchData, arrays: Arrays, seed: int) -> list[Fold]:
    """The five folds of a protocol; InputError for `honest` folds of touches without known persons."""
    if protocol == "paper":
        return folds_in_order(arrays["labels"])
    if "persons" not in arrays:
        raise InputError(
            f"{data.recordings}: has no condition 'person', which is needed to keep each person on one side; "
            "set protocol = paper"
        )
    return folds_by_person(arrays["persons"], seed=seed)


def seed_of(seed: int, *key: int) -> int:
    """A separate random seed for each key, such as a fold and a run."""
    return int(np.random.SeedSequence(seed, spawn_key=(1, *key)).generate_state(1)[0] % 2**31)


def fit_standardisation(signals: Sequence[np.ndarray]) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """`(offset, scale)`: mean and standard deviation of each taxel over training trials.

    A constant taxel gets scale 1, so that it stays silent and finite.

    >>> fit_standardisation([np.array([[1.0, 5.0], [3.0, 5.0]])])
    ((2.0, 5.0), (1.0, 1.0))
    """
    n_samples = sum(len(s) for s in signals)
    mean = sum(s.sum(axis=0, dtype=np.float64) for s in signals) / n_samples
    variance = sum(((s - mean) ** 2).sum(axis=0, dtype=np.float64) for s in signals) / n_samples
    deviation = np.sqrt(variance)
    still = deviation <= 1e-12 * np.maximum(1.0, np.abs(mean))
    return tuple(np.asarray(mean).tolist()), tuple(np.where(still, 1.0, deviation).tolist())
