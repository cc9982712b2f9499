"""A sweep: axes of dotted keys and their values; the cells of a study are the product of the axes."""

import json
import math
from collections import Counter
from collections.abc import Iterator, Mapping
from itertools import product
from pathlib import Path
from typing import Any

from neurotact.errors import InputError

MOST_POINTS = 100_000
SWEEP = "sweep."
"""Begins the keys of axes."""
JOIN = " & "
"""Joins keys that are swept together; each point of the axis is a list of their values."""


def check(sweep: Mapping[str, list[Any]]) -> None:
    """ValueError if an axis has no value, or one that cannot be, or if a key is on two axes."""
    if twice := [key for key, n in Counter(keys(sweep)).items() if n > 1]:
        raise ValueError(f"sweep: '{twice[0]}' is on two axes; drop one")
    for axis, values in sweep.items():
        _check_values(axis, values)
    if math.prod(map(len, sweep.values())) > MOST_POINTS:
        raise ValueError(f"the sweep has more than {MOST_POINTS:,} points; drop values or axes")
    if not all(isinstance(seed, int) and seed >= 0 for seed in sweep.get("seed", [])):
        raise ValueError("sweep.seed must be whole numbers >= 0")


def _check_values(axis: str, values: list[Any]) -> None:
    """ValueError if there is none, a point of another size than its axis, a table, None, or a value twice."""
    n = len(axis.split(JOIN))
    if not values:
        raise ValueError(f"sweep of '{axis}' has no value")
    if n > 1 and any(not isinstance(value, list) or len(value) != n for value in values):
        raise ValueError(f"sweep of '{axis}' needs a list of {n} values for each point")
    if tables := [value for value in values if isinstance(value, Mapping)]:
        key = next(iter(tables[0]), "key")
        raise ValueError(f"sweep of '{axis}' has a table, by which cells have no name; sweep '{axis}.{key}' instead")
    if any(None in (value if n > 1 else [value]) for value in values):
        raise ValueError(f"sweep of '{axis}' has None, which the file of a study cannot hold; leave it out")
    plain = (value[0] if isinstance(value, list) and len(value) == 1 else value for value in values)
    said = Counter(json.dumps(value, default=str) for value in plain)
    if twice := [value for value, times in said.items() if times > 1]:
        raise ValueError(f"sweep of '{axis}' has {twice[0]} twice; drop one")


def points(sweep: Mapping[str, list[Any]]) -> Iterator[dict[str, Any]]:
    """The value of each key, for each point of the sweep; the first axis is the slowest.

    >>> list(points({"a & b": [[1, 2]], "seed": [0, 1]}))
    [{'a': 1, 'b': 2, 'seed': 0}, {'a': 1, 'b': 2, 'seed': 1}]
    """
    for point in product(*sweep.values()):
        chosen: dict[str, Any] = {}
        for axis, value in zip(sweep, point, strict=True):
            names = axis.split(JOIN)
            chosen |= dict(zip(names, value if len(names) > 1 else [value], strict=True))
        yield chosen


def values(sweep: Mapping[str, list[Any]], key: str) -> list[Any]:
    """The values that a sweep gives a key, alone or joined with others; empty if the key is not swept.

    >>> values({"dataset & seed": [["slow", 0], ["fast", 1]]}, "dataset")
    ['slow', 'fast']
    """
    joined = [(axis.split(JOIN), points) for axis, points in sweep.items() if key in axis.split(JOIN)]
    return [point[names.index(key)] if len(names) > 1 else point for names, points in joined for point in points]


def keys(sweep: Mapping[str, list[Any]]) -> list[str]:
    """Every key that a sweep decides."""
    return [key for axis in sweep for key in axis.split(JOIN)]


def unswept(sweep: dict[str, Any], overrides: Mapping[str, Any], path: Path) -> dict[str, Any]:
    """Turn overrides of swept keys into sweeps of one value, in `sweep`; return the other overrides.

    An axis replaces those of some of its keys.
    """
    if not isinstance(sweep, dict):
        raise InputError(f"sweep: must be a table; got {sweep!r} ({path})")
    others = {}
    for key, value in overrides.items():
        joint = [axis for axis in sweep if JOIN in axis and key.removeprefix(SWEEP) in axis.split(JOIN)]
        if joint:
            each = value if isinstance(value, list) and value else [value]
            points = json.dumps([[one] * len(joint[0].split(JOIN)) for one in each])
            raise InputError(
                f"`settings`: {key.removeprefix(SWEEP)} is swept as '{joint[0]}'; give their values, as in "
                f"`settings={{'{SWEEP}{joint[0]}': {points}}}`"
            )
        if key.startswith(SWEEP):
            axis = key.removeprefix(SWEEP)
            for other in [one for one in sweep if one != axis and {*one.split(JOIN)} < {*axis.split(JOIN)}]:
                del sweep[other]  # its values are now joined with others
            sweep[axis] = value
        elif key in sweep:
            sweep[key] = [value]
        else:
            others[key] = value
    return others
