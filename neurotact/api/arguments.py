"""What the arguments of several functions are, and the refusal of others."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from neurotact.errors import InputError

Settings = Mapping[str, Any]
"""Changes of a spec: dotted keys and their values, such as `{"sa1.t_ref_ms": 5}`."""
Conditions = Mapping[str, Any]
"""Conditions of trials with one or several values each, such as `{"speed": 300, "force_N": [3, 6]}`."""
LeftOut = str | Sequence[str] | Mapping[str, Any] | None
"""Trials to leave out: by conditions, such as `{"material": "wood"}`, or by class, such as "rest,moving"."""
Tell = Callable[[str | pd.DataFrame], object]
"""Called with what the command of a function prints, a text or a table at a time; `print` is one."""


def silent(_what: str | pd.DataFrame) -> None:
    """A `Tell` that prints nothing."""


def check_text(name: str, value: object) -> str:
    """`value`, if it is text."""
    if not isinstance(value, str):
        raise InputError(f"{name}: must be text; got {type(value).__name__}")
    return value


def path_of(spikes: object) -> Path:
    """The path of a file of spikes; InputError for spikes in memory, which no run folder could find again."""
    if not isinstance(spikes, (str, Path)):
        raise InputError(
            f"spikes: must be the path of a file; got {type(spikes).__name__}; nt.save(spikes, 'spikes.h5') writes one"
        )
    return Path(spikes)


def check_folder(run: object, function: str, why: str) -> None:
    """InputError unless `run` is a path: the function needs more of a training than a fitted estimator keeps."""
    if not isinstance(run, (str, Path)):
        raise InputError(
            f"run: {function} needs the folder of a training, {why}; got {type(run).__name__}; `nt.train(...)` makes "
            "one"
        )


def check_instance(name: str, value: object, wanted: type, fix: str) -> None:
    """InputError unless `value` is of the wanted class; `fix` says what returns one."""
    if not isinstance(value, wanted):
        raise InputError(f"{name}: must be {wanted.__name__}; got {type(value).__name__}; {fix}")
