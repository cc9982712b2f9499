"""Sets of touches with every condition of their trials: simulated, read in published formats, or a user's own file."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd
from neurotact_parts.studies.comparison.skipped import left_out
from pydantic import Field, model_validator

from neurotact.data import hdf5
from neurotact.data.digests import content_digest
from neurotact.data.readers import arrays
from neurotact.data.recordings import LABEL, Recordings
from neurotact.data.sources import expand
from neurotact.data.trial_choice import LeaveOut, TrialChoice, Where, chosen_trials
from neurotact.errors import InputError, nearest
from neurotact.spec import Spec
from neurotact.studies.preparation import load_dataset
from neurotact.studies.protocol import Arrays
from neurotact.studies.study import DatasetSpec

CONDITION = "condition "
"""Prefix of the arrays of conditions, `(trial,)`."""


class ArrayFile(Spec):
    """A file of arrays, as `neurotact.data.readers.arrays` reads it."""

    path: str
    sampling_rate_Hz: float = Field(gt=0)
    unit: str


class TouchSet(Spec):
    """A set of touches: recordings of one skin, in one or several parts, or a user's own file."""

    parts: dict[str, DatasetSpec] = {}
    """The parts by name; their trials follow each other."""
    arrays: ArrayFile | None = None
    """A file of arrays, in place of parts."""
    path: str | None = None
    """A user's own HDF5 file of recordings, in place of parts."""
    content: str | None = None
    """Digest of the trials in that file (`data.digests.content_digest`)."""
    where: Where = {}
    """Conditions of the trials of that file that are used."""
    leave_out: LeaveOut = {}
    """Conditions of trials of that file that are not used, or classes."""
    keys: dict[str, Any] = {}
    """Keys of `own-recordings` for this set, such as `window.length_ms`."""

    @model_validator(mode="after")
    def _has_one_source(self) -> "TouchSet":
        sources = [bool(self.parts), self.arrays is not None, self.content is not None]
        if sum(sources) != 1 or (self.path is None) != (self.content is None):
            raise ValueError("give parts or arrays; `data` names a file of your own")
        return self


class TouchData(Spec):
    """The chosen set, and all sets."""

    set: str
    sets: dict[str, TouchSet]

    @model_validator(mode="after")
    def _names_a_set(self) -> "TouchData":
        if self.set not in self.sets:
            raise ValueError(f"set: '{self.set}' is not one of the sets; {nearest(self.set, list(self.sets))}")
        return self

    @property
    def chosen(self) -> TouchSet:
        return self.sets[self.set]


def load(data: TouchData) -> Arrays:
    """Recordings as arrays, which `recordings_of` reads; or only the reason for their absence.

    `values`, `(sample, taxel)` float32, `lengths`, `(trial,)`, `sampling_rate_Hz`, `unit`, `channels`, and
    each condition, `(trial,)`. Raises InputError if a user's own file does not exist, or was changed since the study
    began.
    """
    chosen = data.chosen
    if chosen.path is not None:
        choice = TrialChoice(chosen.where, chosen.leave_out)
        touches = chosen_trials(hdf5.load_recordings(expand(chosen.path)), choice, chosen.path, tell=False)
        if content_digest(touches) != chosen.content:
            raise InputError(f"{chosen.path}: its trials changed since this study began; run it in another folder")
        return _arrays_of(touches)
    try:
        return _arrays_of(_joined([*_parts_of(chosen)]))
    except InputError as error:
        return left_out(data.set, error)


def recordings_of(stored: Arrays, source: str) -> Recordings:
    """The recordings of `load`; source: their name in messages."""
    signals = np.split(stored["values"], np.cumsum(stored["lengths"])[:-1])
    conditions = {key.removeprefix(CONDITION): stored[key] for key in stored if key.startswith(CONDITION)}
    rate_Hz, channels = float(stored["sampling_rate_Hz"]), tuple(stored["channels"].tolist())
    return Recordings(signals, rate_Hz, str(stored["unit"]), pd.DataFrame(conditions), channels, source)


def _parts_of(chosen: TouchSet) -> Iterator[Recordings]:
    if chosen.arrays is not None:
        one = chosen.arrays
        yield arrays.read(expand(one.path), one.sampling_rate_Hz, one.unit)
    for part in chosen.parts.values():
        yield load_dataset(part)


def _joined(parts: list[Recordings]) -> Recordings:
    """The trials of several recordings of one skin."""
    first = parts[0]
    conditions = pd.concat([part.conditions for part in parts], ignore_index=True)
    signals = [signal for part in parts for signal in part.to_unit(first.unit).signals]
    return Recordings(signals, first.sampling_rate_Hz, first.unit, conditions, first.channels, first.source)


def _arrays_of(touches: Recordings) -> Arrays:
    conditions = touches.conditions
    texts = {name: conditions[name].astype(str) for name in conditions if conditions[name].dtype.kind not in "iufb"}
    kept = conditions.assign(**{LABEL: conditions[LABEL].astype(str), **texts})
    return {
        "values": np.concatenate([np.asarray(signal, np.float32) for signal in touches.signals]),
        "lengths": touches.lengths,
        "sampling_rate_Hz": np.array(touches.sampling_rate_Hz),
        "unit": np.array(touches.unit),
        "channels": np.array(touches.channels),
        **{f"{CONDITION}{name}": np.array(kept[name].tolist()) for name in kept},
    }
