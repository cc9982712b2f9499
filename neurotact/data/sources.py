"""Where recordings come from besides files of our own: simulators and readers, found by name."""

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from neurotact import plugins, spec
from neurotact.data.recordings import Recordings
from neurotact.data.spikes import SpikeTrains
from neurotact.errors import InputError
from neurotact.spec import Spec

Progress = Callable[[int, int], None]
"""Called as `progress(done, total)` with numbers of trials."""


class Simulator(NamedTuple):
    """An experiment that can be simulated (entry point group `neurotact.simulators`).

    about: what it simulates, in one line.
    model: its spec, which has the property `n_trials`.
    simulate: called as `simulate(spec, progress)`.
    """

    about: str
    model: type[Spec]
    simulate: Callable[[Any, Progress | None], Recordings]

    def build(self, changes: Mapping[str, Any], source: str) -> Any:
        """The simulator's spec with dotted keys changed; a change within a nested table keeps the rest of it."""
        table = spec.override(self.model().model_dump(mode="json"), changes)
        return spec.build(self.model, table, source=source)


class Reader(NamedTuple):
    """A format that recordings are published in (entry point group `neurotact.readers`).

    about: which recordings, in one line.
    read: called as `read(path)`; as `read(path, step_ms)` where `step_ms` is given, and returns spikes then.
    step_ms: of a reader of events: the clock on which they become spikes, unless the user names another.
    """

    about: str
    read: Callable[..., Recordings | SpikeTrains]
    step_ms: float | None = None


def simulator(name: str) -> Simulator:
    """The simulator of that name; InputError when there is none."""
    return plugins.load("simulators", name)


def reader(name: str) -> Reader:
    """The reader of that name; InputError when there is none."""
    return plugins.load("readers", name)


def read_recordings(name: str, path: Path) -> Recordings:
    """The recordings that the reader of that name finds; InputError where it finds spikes, which need no encoder."""
    found = reader(name).read(path)
    if not isinstance(found, Recordings):
        raise InputError(f"{path}: '{name}' reads spikes, not recordings; train on them with neurotact train")
    return found


def expand(path: str) -> Path:
    """`path` with `$NEUROTACT_DATA` replaced by its value, by default ../shared/data.

    >>> from unittest.mock import patch
    >>> with patch.dict(os.environ, NEUROTACT_DATA="/tactile"):
    ...     str(expand("$NEUROTACT_DATA/fabricslide"))
    '/tactile/fabricslide'
    """
    return Path(path.replace("$NEUROTACT_DATA", os.environ.get("NEUROTACT_DATA", "../shared/data")))
