"""Time stamps in two columns: whole seconds, and the rest of the second in milli-, micro- or nanoseconds."""

import re
from collections.abc import Collection, Sequence

import numpy as np

from neurotact.data.readers.clock.stamps import UNIT_S, Unit, unit_in
from neurotact.errors import InputError

NAMED = re.compile(r"(.*?)(nano|micro|milli|[num])?sec(?:ond)?s?", re.IGNORECASE)
"""`sec`, `header.stamp.nanosec`, `tv_usec`, `stamp_nsecs`, `milliseconds`: a beginning, what is counted."""
UNITS: dict[str, Unit] = {"nano": "ns", "n": "ns", "micro": "us", "u": "us", "milli": "ms", "m": "ms"}


def pair_in(names: Sequence[str], others: Collection[int | None] = ()) -> tuple[int, int] | None:
    """The places of the first seconds and the rest of a second whose names begin alike, not among `others`.

    >>> pair_in(["stamp.sec", "stamp.nanosec", "left"]), pair_in(["left", "tv_sec", "tv_usec"], [0])
    ((0, 1), (1, 2))
    >>> pair_in(["seconds", "left"]), pair_in(["a_sec", "b_nsec"])
    (None, None)
    """
    seconds: dict[str, int] = {}
    rests: dict[str, int] = {}
    for column, name in enumerate(names):
        match = NAMED.fullmatch(name.strip())
        if match and column not in others:
            (rests if match[2] else seconds).setdefault(match[1].lower(), column)
    return next(((column, rests[begin]) for begin, column in seconds.items() if begin in rests), None)


def apart(name: str, names: Collection[str]) -> list[str]:
    """The one or two columns that a name or `seconds,rest` stands for; a column may have a comma in its name.

    >>> apart("sec,nanosec", ["sec", "nanosec"]), apart("time, s", ["time, s"]), apart("1,2", [])
    (['sec', 'nanosec'], ['time, s'], ['1', '2'])
    """
    parts = [part.strip() for part in name.split(",")]
    return [name] if name in names or len(parts) != 2 or not all(parts) else parts


def joined(
    seconds: np.ndarray, rest: np.ndarray, name: str, where: str, first_line: int, unit: Unit | None = None
) -> np.ndarray:
    """The stamps in seconds, `(row,)`. name: of the column of the rest, which says its unit, or else the values do.

    Raises InputError, which begins with `where`, for seconds that are not whole, for a rest of a second or more, and
    for a `unit` that is asked for. first_line: the line of the first row, 0 in an array.

    >>> joined(np.array([7.0, 8.0]), np.array([5e8, 0.0]), "nanosec", "felt.csv", 2).tolist()
    [7.5, 8.0]
    """
    row = "line" if first_line else "sample"
    if unit is not None:
        raise InputError(f"{where}: `time_unit`: seconds and {name} together are in seconds; leave it out")
    unit = _unit_of(name, rest)
    wrong = np.flatnonzero((rest < 0) | (rest * UNIT_S[unit] >= 1))
    if len(wrong):
        raise InputError(
            f"{where}: {row} {wrong[0] + first_line}: {name} is {rest[wrong[0]]:.12g} {unit}, not the rest of a "
            "second; name the time stamps with `time_column`"
        )
    broken = np.flatnonzero(seconds != np.floor(seconds))
    if len(broken):
        raise InputError(
            f"{where}: {row} {broken[0] + first_line}: the seconds are {seconds[broken[0]]:.12g}, not whole, so that "
            f"{name} is no rest of them; name the time stamps with `time_column`"
        )
    return seconds + rest * UNIT_S[unit]


def _unit_of(name: str, rest: np.ndarray) -> Unit:
    """The unit of the rest of a second: by its name, else the longest in which all values are less than a second.

    >>> _unit_of("tv_usec", np.array([5.0])), _unit_of("ms", np.array([5.0])), _unit_of("2", np.array([5.0, 250_000.0]))
    ('us', 'ms', 'us')
    """
    counted = NAMED.fullmatch(name.strip())
    named = UNITS.get((counted[2] or "").lower()) if counted else unit_in(f"_{name.strip()}")
    if named not in (None, "s"):
        return named
    most = float(np.max(rest, initial=0.0))
    return "ms" if most < 1e3 else "us" if most < 1e6 else "ns"
