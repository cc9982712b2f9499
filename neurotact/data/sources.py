"""Sources of recordings besides our own files: simulators and readers, found by name."""

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from neurotact import plugins, spec
from neurotact.data.recordings import Recordings
from neurotact.data.spikes import SpikeTrains
from neurotact.errors import InputError, nearest
from neurotact.spec import Spec

Progress = Callable[[int, int], None]
"""Called as `progress(done, total)` with numbers of trials."""


class Control(NamedTuple):
    """A quantity of a touch that the user sets: one of `choices`, else a number from `low` to `high`.

    name: with its unit, as in force_N. about: a description.
    """

    name: str
    about: str
    value: float | str
    choices: tuple[str, ...] = ()
    low: float = 0.0
    high: float = 0.0
    step: float = 0.0


class Finger(NamedTuple):
    """A simulated finger that the user moves, one touch after the other.

    controls: called as `controls(spec)`; returns the controls.
    touch: called as `touch(spec, values, number)`; returns a touch as recordings of one trial. Its number is the seed
    of its random numbers; no touch equals a trial of `simulate`.
    """

    controls: Callable[[Any], tuple[Control, ...]]
    touch: Callable[[Any, Mapping[str, Any], int], Recordings]

    def checked(self, what: Any, values: Mapping[str, Any]) -> dict[str, Any]:
        """Values of all controls, with defaults for those that are not given; InputError for a wrong one."""
        controls = {control.name: control for control in self.controls(what)}
        settings = {name: control.value for name, control in controls.items()}
        for name, value in values.items():
            if name not in controls:
                raise InputError(f"{name}: is not a control of this finger; {nearest(name, [*controls])}")
            settings[name] = _checked(controls[name], value)
        return settings


def _checked(control: Control, value: Any) -> float | str:
    if control.choices:
        if value not in control.choices:
            raise InputError(f"{control.name}: '{str(value)[:40]}' is unknown; {nearest(str(value), control.choices)}")
        return value
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if not is_number or not control.low <= value <= control.high:
        raise InputError(f"{control.name}: must be from {control.low:g} to {control.high:g}; got {str(value)[:40]}")
    return float(value)


class Simulator(NamedTuple):
    """An experiment that can be simulated (entry point group `neurotact.simulators`).

    about: what it simulates, in one line.
    model: its spec, which has the property `n_trials`.
    simulate: called as `simulate(spec, progress)`.
    by_hand: its finger, if it has one that `neurotact live` can move.

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
    by_hand: Finger | None = None

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
