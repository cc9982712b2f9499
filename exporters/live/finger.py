"""A simulated finger that the user of the page moves: what a simulator gives as its `by_hand`."""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from neurotact.data.recordings import Recordings
from neurotact.errors import InputError, nearest


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
