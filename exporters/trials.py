"""The trials of a run, on which an export is tested, and that give the ranges of its integers."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from neurotact_parts.streams.chain import build_encoder
from neurotact_parts.streams.long_recordings import RECORDING
from torch import Tensor

from neurotact.data import encoded_from, hdf5
from neurotact.data.recordings import Recordings
from neurotact.data.spikes import SpikeTrains
from neurotact.encoders.encoding import encode_recordings
from neurotact.errors import InputError
from neurotact.networks.training import numbers, run_folder, tasks
from neurotact.networks.training.ranges import OF_EVENTS, evenly


class Recorded(NamedTuple):
    """The trials that give the ranges, and those on which an export is tested: signals and classes.

    training, test: signals `(sample, taxel)` in the encoder's unit. labels: class indices of the test trials, or the
    numbers that the network tells of them.
    sampling_rate_Hz: of the recordings. windows: of the training trials, `(window, time, afferent)`.
    """

    training: list[np.ndarray]
    test: list[np.ndarray]
    labels: np.ndarray
    sampling_rate_Hz: float
    windows: Tensor


def recorded(restored: run_folder.Restored, recordings: Recordings | str | Path | None = None) -> Recorded:
    """The signals of a run's training and test trials, in the encoder's unit.

    A network that takes the events of a sensor has them as signals, 0 or 1 in each step of its clock.
    Raises InputError if the run's spikes were not encoded from these recordings.
    """
    if restored.encoder == {}:
        return _of_events(restored, recordings)
    if not restored.spikes:
        return _given(restored, recordings)
    if isinstance(recordings, Recordings):
        raise InputError("recordings: must be the file that the run was trained on; give its path, or leave it out")
    trains = run_folder.trained_spikes_of(restored)
    assert restored.spikes_path is not None  # the file of these
    unit = str((restored.encoder or {}).get("unit", "mV"))
    split, windows = tasks.trials_of(trains, restored.task), tasks.sides_of(trains, restored.task).train.spikes
    chosen, test = evenly(split.train), split.test
    if restored.task.parts > 1:
        trains, (chosen, test) = _whole(restored, trains, (chosen, test))
    path, trials = encoded_from.find(restored.spikes_path, trains, np.append(chosen, test), recordings)
    with encoded_from.opened(path, trains) as stored:
        sides = trials[: len(chosen)], trials[len(chosen) :]
        parts = [list(stored.select(side).loaded().to_unit(unit).signals) for side in sides]
        labels = _labels(restored, trains, test)
        return Recorded(parts[0], parts[1], labels, stored.sampling_rate_Hz, windows)


def _whole(
    restored: run_folder.Restored, parts: SpikeTrains, sides: Sequence[np.ndarray]
) -> tuple[SpikeTrains, list[np.ndarray]]:
    """The recordings whose parts are the trials of a detector, and those that have a part on each side."""
    assert restored.spikes_path is not None
    whole = tasks.load_spikes(restored.spikes_path, restored.task.model_copy(update={"parts": 1}))
    return whole, [np.unique(parts.conditions[RECORDING].to_numpy()[side]) for side in sides]


def _of_events(restored: run_folder.Restored, recordings: object) -> Recorded:
    """The same of a network that takes the events of a sensor."""
    if recordings is not None:
        raise InputError("recordings: the network takes the events of a sensor; leave them out")
    if not restored.spikes:
        raise InputError("run: was fitted in memory, to events that it did not keep; train it from a file of spikes")
    trains = run_folder.trained_spikes_of(restored)
    split = tasks.trials_of(trains, restored.task)
    rasters = []
    for trial in trains.select(split.test).trials():
        raster = np.zeros((trial.n_steps, len(trains.afferents)), np.float32)
        raster[trial.steps, trial.units] = 1
        rasters.append(raster)
    windows = tasks.sides_of(trains, restored.task).train.spikes
    return Recorded(list(OF_EVENTS), rasters, _labels(restored, trains, split.test), trains.sampling_rate_Hz, windows)


def _labels(restored: run_folder.Restored, trials: SpikeTrains | Recordings, chosen: np.ndarray) -> np.ndarray:
    """The classes of some trials, as indices into those of the network, or their numbers `(trial, target)`."""
    if restored.task.detects:
        return np.zeros(len(chosen), np.int64)  # a recording has no label
    if restored.task.numbers:
        return numbers.of_trials(trials.conditions, restored.task.numbers)[chosen]
    return np.array([restored.classes.index(trials.classes[label]) for label in trials.labels[chosen]], np.int64)


def _given(restored: run_folder.Restored, recordings: Recordings | str | Path | None) -> Recorded:
    """All trials of some recordings as those of training and of the test, for a network that was fitted in memory."""
    if recordings is None:
        raise InputError(
            "`recordings`: a classifier keeps none, and integers need the range of samples; give recordings like those "
            "that it was fitted on, or `variant='float'`"
        )
    encoder = build_encoder(restored)
    data = recordings if isinstance(recordings, Recordings) else hdf5.load_recordings(recordings)
    unknown = sorted({*data.classes} - {*restored.classes})
    if unknown and not restored.task.target:
        raise InputError(f"recordings: class '{unknown[0]}' is not a class of the network; leave its trials out")
    data = data.in_order(encoder.conditioning.taxels)
    chosen = data.select(evenly(np.arange(len(data))))
    trains = encode_recordings(chosen, encoder)
    examples, _ = tasks.examples_of(trains, np.arange(len(trains)), restored.task)
    signals = list(chosen.to_unit(encoder.unit).signals)
    labels = _labels(restored, chosen, np.arange(len(chosen)))
    return Recorded(signals, signals, labels, data.sampling_rate_Hz, examples.spikes)
