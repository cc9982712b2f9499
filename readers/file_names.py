"""Parts of file names that tell files apart and that nobody named: conditions that would be lost in silence."""

import re
from collections.abc import Sequence
from itertools import pairwise
from pathlib import PurePosixPath
from typing import NamedTuple

from neurotact.data.readers.specs import FIELD, FILE
from neurotact.data.recordings import LABEL

TOKENS = (
    re.compile(r"[^\W\d_]+|\d+(?:\.\d+)?|[\W_]"),
    re.compile(r"[^\W_]+|[\W_]"),
    re.compile(r"[^\W\d_]+|(?:(?<=[^\W\d_])-)?\d+(?:\.\d+)?|[\W_]"),
)
"""Words, numbers and signs of a name; for names with words of letters and digits, such words and signs; and, where some
numbers behind a letter have a minus and others not, such numbers."""
MOST_NUMBERED = 2
"""Times as many numbers as there are files that a range may hold; those of repetitions leave out few."""


class Parts(NamedTuple):
    """What differs between names. pattern: gives each part a name; example: the parts in the first file."""

    pattern: str
    example: tuple[str, ...]


def unnamed(files: Sequence[str], levels: Sequence[str]) -> Parts | None:
    """The parts of paths below the folders of `levels`, if one may be a condition; None if they only number the files.

    A condition comes back within a folder, or in another one, where it is a word or a number with gaps.

    >>> unnamed([f"{label}/F{force}_{n:02}.csv" for label in ("felt", "silk") for force in (3, 6) for n in (0, 1)],
    ...         ["label"])
    Parts(pattern='F{F}_{number}', example=('3', '00'))
    >>> unnamed(["felt/slide0.csv", "felt/slide1.csv", "silk/slide0.csv"], ["label"]) is None
    True
    """
    names = _split(files, len(levels))
    above = ["/".join(PurePosixPath(file).parts[: len(levels)]) for file in files]
    if names is None or not any(_may_be_condition(values, above) for values in zip(*names, strict=True)):
        return None
    taken = [LABEL, FILE, *(name for level in levels for name in FIELD.findall(level) or [level])]
    return _parts(names, None, taken)


def labelled(files: Sequence[str]) -> str:
    """A pattern for names of which the first word that differs is the class; empty without one, or a common form.

    >>> labelled(["felt_1.csv", "silk_2.csv"]), labelled(["felt_V-10_0.csv", "silk_V20_0.csv"])
    ('{label}_{number}', '{label}_V{V}_0')
    """
    names = _split(files, 0)
    found = Parts("", ()) if names is None else _parts(names, LABEL, [FILE])
    return found.pattern if f"{{{LABEL}}}" in found.pattern else ""


def _split(files: Sequence[str], n_levels: int) -> list[list[str]] | None:
    """The tokens of each path below the levels; None if they are not as many, or a pattern cannot tell them apart."""
    below = ["/".join(PurePosixPath(file).with_suffix("").parts[n_levels:]) for file in files]
    for tokens in TOKENS:
        names = [tokens.findall(name) for name in below]
        if len({len(name) for name in names}) != 1 or any("{" in name for name in below):
            continue
        differ = [len({*values}) > 1 for values in zip(*names, strict=True)]
        words = [all(value[-1].isalnum() for value in values) for values in zip(*names, strict=True)]
        is_beside = any(one and other for one, other in pairwise(differ))
        if any(differ) and not is_beside and all(word for one, word in zip(differ, words, strict=True) if one):
            return names
    return None


def _is_number(token: str) -> bool:
    return token.removeprefix("-").replace(".", "").isdecimal()


def _may_be_condition(values: Sequence[str], above: Sequence[str]) -> bool:
    places, each = {*zip(above, values, strict=True)}, {*values}
    if len(places) == len({*above}):  # one value in each folder, which tells it already
        return False
    if len(places) < len(values):
        return True
    is_known_again = len(each) < len(places)
    if not all(map(_is_number, each)):
        return is_known_again
    numbers = [float(value) for value in each]
    return is_known_again and max(numbers) - min(numbers) >= MOST_NUMBERED * len(each)


def _parts(names: list[list[str]], first: str | None, taken: Sequence[str]) -> Parts:
    """A name for each part: `first` for the first word, or the letters before a number, or its place."""
    pattern, called, example = "", [*taken], []
    columns = [*zip(*names, strict=True)]
    places = [place for place, values in enumerate(columns) if len({*values}) > 1]
    for place, token in enumerate(names[0]):
        if place not in places:
            pattern += token
            continue
        before = names[0][place - 1] if place else ""
        is_number = all(map(_is_number, columns[place]))
        wanted = [None if is_number else first, before, "number" if is_number and place == places[-1] else None]
        free = (name for name in wanted if name and name.isalpha() and name.isidentifier() and name not in called)
        called.append(next(free, f"part{len(example) + 1}"))
        pattern += f"{{{called[-1]}}}"
        example.append(token)
    return Parts(pattern, tuple(example))
