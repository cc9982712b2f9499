"""What the arguments of several functions are, and the refusal of others."""

from collections.abc import Mapping, Sequence
from typing import Any

from neurotact.errors import InputError
from neurotact.progress import Tell as Tell
from neurotact.progress import untold as silent  # noqa: F401

Settings = Mapping[str, Any]
"""Changes of a spec: dotted keys and their values, such as `{"sa1.t_ref_ms": 5}`."""
Conditions = Mapping[str, Any]
"""Conditions of trials with one or several values each, such as `{"speed": 300, "force_N": [3, 6]}`."""
LeftOut = str | Sequence[str] | Mapping[str, Any] | None
"""Trials to leave out: by conditions, such as `{"material": "wood"}`, or by class, such as "rest,moving"."""


def check_text(name: str, value: object) -> str:
    """`value`, if it is text."""
    if not isinstance(value, str):
        raise InputError(f"{name}: must be text; got {type(value).__name__}")
    return value


def check_instance(name: str, value: object, wanted: type, fix: str) -> None:
    """InputError unless `value` is of the wanted class; `fix` says what returns one."""
    if not isinstance(value, wanted):
        raise InputError(f"{name}: must be {wanted.__name__}; got {type(value).__name__}; {fix}")
