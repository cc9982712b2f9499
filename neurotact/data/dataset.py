"""A set of touches by its source: simulated, read in a published format, of arrays, or a file; and the trials used.

Simulators and readers, ours and other packages', are found by name (`Simulator`, `Reader`).
"""

import math
import os
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from pydantic import Field, field_validator, model_validator

from neurotact import plugins, spec
from neurotact.data import doubtful, hdf5
from neurotact.data.digests import content_digest
from neurotact.data.recordings import Recordings
from neurotact.data.spikes import SpikeTrains
from neurotact.data.trial_choice import LeaveOut, TrialChoice, Where, chosen_trials, fewer_trials
from neurotact.errors import InputError, nearest
from neurotact.spec import Spec, build

ALL = "all"
"""The name of all trials, where a study names no part of them."""
Progress = Callable[[int, int], None]
"""Called as `progress(done, total)` with numbers of trials."""


class Simulator(NamedTuple):
    """An experiment that can be simulated (entry point group `neurotact.simulators`).

    about: what it simulates, in one line.
    model: its spec, which has the property `n_trials`.
    simulate: called as `simulate(spec, progress)`.
    by_hand: its `Finger` of `exporters/live/finger.py`, if `neurotact live` can move one.

    >>> import numpy as np
    >>> class Presses(Spec):
    ...     n_trials: int = 4
    >>> def simulate(spec, progress):
    ...     return Recordings(np.ones((spec.n_trials, 100, 2)), 1000.0, "mV", ["soft", "hard"] * (spec.n_trials // 2))
    >>> len(Simulator("Presses of a finger.", Presses, simulate).simulate(Presses(), None))
    4
    """

    about: str
    model: type[Spec]
    simulate: Callable[[Any, Progress | None], Recordings]
    by_hand: Any = None

    def build(self, changes: Mapping[str, Any], source: str) -> Any:
        """The simulator's spec with dotted keys changed; the rest of a nested table is kept."""
        table = spec.override(self.model().model_dump(mode="json"), changes)
        return spec.build(self.model, table, source=source)


class Reader(NamedTuple):
    """A format of recordings (entry point group `neurotact.readers`).

    about: the recordings, in one line.
    read: called as `read(path)`; called as `read(path, step_ms)` if `step_ms` is given, and then returns spikes.
    step_ms: for a reader of events: the clock on which they become spikes, unless the user gives another.

    >>> import numpy as np
    >>> def read(path):
    ...     return Recordings([np.load(file) for file in sorted(path.glob("*.npy"))], 500.0, "mV", ["felt"])
    >>> Reader("A folder of .npy files.", read).about
    'A folder of .npy files.'
    """

    about: str
    read: Callable[..., Recordings | SpikeTrains]
    step_ms: float | None = None


def simulator(name: str) -> Simulator:
    """The simulator of that name; InputError when there is none, or it cannot be used."""
    loaded = plugins.load("simulators", name, Simulator)
    if not (isinstance(loaded.model, type) and issubclass(loaded.model, Spec) and callable(loaded.simulate)):
        raise plugins.unfit("simulators", name, "has a model that is not a Spec, or nothing to call")
    return loaded


def reader(name: str) -> Reader:
    """The reader of that name; InputError when there is none, or it cannot be used."""
    loaded = plugins.load("readers", name, Reader)
    if not callable(loaded.read):
        raise plugins.unfit("readers", name, "has nothing to call")
    return loaded


def expand(path: str) -> Path:
    """`path` with `$NEUROTACT_DATA` replaced by its value, by default ../shared/data.

    >>> from unittest.mock import patch
    >>> with patch.dict(os.environ, NEUROTACT_DATA="/tactile"):
    ...     str(expand("$NEUROTACT_DATA/fabricslide"))
    '/tactile/fabricslide'
    """
    return Path(path.replace("$NEUROTACT_DATA", os.environ.get("NEUROTACT_DATA", "../shared/data")))


SOURCES = ("simulate", "read", "file", "arrays")
Touches = TypeVar("Touches", bound=Recordings | SpikeTrains)


class _ArraysSpec(Spec):
    """A file of arrays, as `neurotact import arrays` reads it."""

    path: str
    """The file."""
    sampling_rate_Hz: float = Field(gt=0)
    """Samples per second."""
    unit: str
    """The unit of the signals."""


class DatasetSpec(Spec):
    """The source of a study's recordings, and the parts that it uses."""

    simulate: str | None = None
    """An experiment that can be simulated, such as `gratings`."""
    parameters: dict[str, Any] = {}
    """Parameters of the simulation, by the keys of its spec."""
    read: str | None = None
    """A published format, such as `fabricslide`."""
    file: str | None = None
    """An HDF5 file of recordings."""
    arrays: _ArraysSpec | None = None
    """A file of arrays."""
    path: str | None = None
    """The folder to read; `$NEUROTACT_DATA` is replaced by its value, by default ../shared/data."""
    content: str | None = None
    """Digest of the trials that are used (`data.digests.content_digest`); others are refused, wherever they lie."""
    subsets: dict[str, dict[str, Any]] = {ALL: {}}
    """Name and conditions of each part, such as `"v1 mix" = { speed_mm_per_s = 8.6 }`."""
    stratify: tuple[str, ...] = ()
    """Conditions balanced in the split besides the class."""
    where: Where = {}
    """Conditions of the trials that are used, such as `{ speed = 300 }`; the others are as if never recorded."""
    leave_out: LeaveOut = {}
    """Conditions of trials that are not used, or classes, such as `"rest"`."""
    at_most: int | None = Field(default=None, ge=2)
    """Trials that are used at most, evenly spaced within each class and condition; absent: all."""

    @field_validator("subsets")
    @classmethod
    def _has_a_subset(cls, subsets: dict[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
        if not subsets:
            raise ValueError("must name at least one part; leave the key out to take all trials")
        return subsets

    @field_validator("simulate")
    @classmethod
    def _can_be_simulated(cls, name: str | None) -> str | None:
        return _known("simulators", name, "simulation")

    @field_validator("read")
    @classmethod
    def _can_be_read(cls, name: str | None) -> str | None:
        return _known("readers", name, "reader")

    @model_validator(mode="after")
    def _has_one_source(self) -> "DatasetSpec":
        if sum(getattr(self, source) is not None for source in SOURCES) != 1:
            raise ValueError("give one of simulate, read, file and arrays")
        if self.read is not None and self.path is None:
            raise ValueError("read needs path, the folder of the published data")
        return self

    def identity(self) -> dict[str, Any]:
        """The keys that decide the recordings, independent of the location of the files."""
        decides: dict[str, Any] = {"simulate": self.simulate, "parameters": self.parameters, "read": self.read}
        if self.arrays is not None:
            decides["arrays"] = self.arrays.model_dump(mode="json", exclude={"path"})
        chosen = {key: value for key, value in self.choice._asdict().items() if value}
        some = {} if self.at_most is None else {"at_most": self.at_most}
        return {**decides, "stratify": self.stratify, **chosen, **some}

    @property
    def choice(self) -> TrialChoice:
        """The trials that are used."""
        return TrialChoice(self.where, self.leave_out)

    @property
    def recordings(self) -> Path | None:
        """The whole path of the file of recordings."""
        return None if self.file is None else expand(self.file).absolute()

    @property
    def source(self) -> str:
        """The file or folder that is read, or the name of the simulation."""
        return self.file or self.path or (self.arrays.path if self.arrays else self.simulate) or ""


def _known(group: plugins.Group, name: str | None, what: str) -> str | None:
    names = plugins.names(group)
    if name is not None and name not in names:
        raise ValueError(f"there is no such {what}; {nearest(name, names)}")
    return name


def load_touches(spec: DatasetSpec) -> Recordings | SpikeTrains:
    """Simulate, read or load the trials that a data set uses; a line says how many they are.

    Raises InputError if their content is not that of the spec.
    """
    return _chosen(_every(spec), spec)


def load_recordings(spec: DatasetSpec) -> Recordings:
    """As `load_touches`; InputError for spikes, which need no encoder. Lines tell what is doubtful in a read set."""
    if spec.file is not None:  # a study may use a small part of a large file
        with hdf5.open_recordings(expand(spec.file)) as stored:
            return _known_content(_fewer(stored, spec).loaded(), spec)
    touches = _every(spec)
    if not isinstance(touches, Recordings):
        what = f"{expand(spec.path or '')}: '{spec.read}' reads spikes, not recordings"
        raise InputError(f"{what}; train on them with neurotact train")
    chosen = _chosen(touches, spec)
    if spec.read is not None:
        doubtful.check(chosen, spec.source)
    return chosen


def _chosen(touches: Touches, spec: DatasetSpec) -> Touches:
    return _known_content(_fewer(touches, spec), spec)


def _fewer(touches: Any, spec: DatasetSpec) -> Any:
    """Of recordings, stored ones or spikes: the trials that a data set uses."""
    chosen = chosen_trials(touches, spec.choice, spec.source, tell=spec.content is None)
    return fewer_trials(chosen, spec.at_most)


def _known_content(chosen: Touches, spec: DatasetSpec) -> Touches:
    """The trials, if they have the content that the spec names."""
    if spec.content is not None and content_digest(chosen) != spec.content:
        raise InputError(f"{spec.source}: its trials changed since this study began; run it in another folder")
    return chosen


def _every(spec: DatasetSpec) -> Recordings | SpikeTrains:
    name = next(name for name in SOURCES if getattr(spec, name) is not None)
    return _FROM[name](spec, expand(spec.source))


def _simulated(spec: DatasetSpec, _: Path) -> Recordings:
    experiment = simulator(spec.simulate or "")
    return experiment.simulate(build(experiment.model, spec.parameters, source="dataset.parameters"), None)


def _of_arrays(spec: DatasetSpec, path: Path) -> Recordings:
    assert spec.arrays is not None
    return plugins.load_function("tools", "import_arrays")(path, spec.arrays.sampling_rate_Hz, spec.arrays.unit)


_FROM: Mapping[str, Callable[[DatasetSpec, Path], Recordings | SpikeTrains]] = {
    "simulate": _simulated,
    "read": lambda spec, path: reader(spec.read or "").read(path),
    "file": lambda spec, path: hdf5.load(path),
    "arrays": _of_arrays,
}
"""What gives the trials of each of `SOURCES`."""


def until(recordings: Recordings, end_ms: float | None) -> Recordings:
    """The beginning of each trial, all of it if None, with the sample at its end: a slower clock ends no earlier."""
    if end_ms is None:
        return recordings
    n_samples = math.ceil(end_ms * 1e-3 * recordings.sampling_rate_Hz - 1e-9) + 1
    return replace(recordings, signals=[signal[:n_samples] for signal in recordings.signals])
