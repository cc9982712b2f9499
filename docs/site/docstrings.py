"""Docstrings as the project writes them, plain text with `code` in backticks, made into what Sphinx reads."""

import re
from collections.abc import Iterator
from typing import TYPE_CHECKING

from numpy.typing import ArrayLike

import neurotact

if TYPE_CHECKING:
    from sphinx.application import Sphinx

NAMES = r"[a-z]\w*(?:,? (?:and )?\w+)*(?: \(.*?\))?"
ENTRY = re.compile(rf"(?P<names>{NAMES}) ?: (?P<text>\S.*)")
"""A line of a list of parameters: `t_ref_ms, gain: of every afferent.`"""
NEXT = re.compile(rf"(?<=\. )(?={NAMES}: )")
"""Where another parameter begins in the same line."""
SPECIAL = re.compile(r"([\\*|]|(?<=\w)_(?!\w))")
"""What reStructuredText would take for markup."""


def to_rest(lines: list[str]) -> list[str]:
    """A docstring in reStructuredText: parameters as lists, `code` as code or a link, other signs as they are.

    >>> to_rest(["A layer.", "", "x: its input, `(trial,)`.", "y_: its *", "  output."])
    ['A layer.', '', '- ``x``: its input, ``(trial,)``.', '- ``y_``: its \\\\* output.', '']
    """
    return [line for paragraph in _paragraphs(lines) for line in (*_written(paragraph), "")]


def _paragraphs(lines: list[str]) -> Iterator[list[str]]:
    paragraph: list[str] = []
    for line in [*lines, ""]:
        if line.strip():
            paragraph.append(line)
        elif paragraph:
            yield paragraph
            paragraph = []


def _written(lines: list[str]) -> list[str]:
    if lines[0].lstrip().startswith(">>>"):
        return lines
    if len(lines) > 1 and set(lines[1].strip()) == {"-"}:  # a heading and its list
        return [f"**{lines[0]}**", "", *(_written(lines[2:]) if lines[2:] else [])]
    if lines[0].startswith("- "):
        return [_inline(line) for line in lines]
    return _with_entries(lines)


def _with_entries(lines: list[str]) -> list[str]:
    """A paragraph whose lines may be entries of a list; what follows the last one with a capital is text again."""
    items: list[tuple[str, str]] = []  # names of parameters, or none, and what is said
    for line in (part for whole in lines for part in map(str.strip, NEXT.split(whole))):
        entry = ENTRY.fullmatch(line)
        names, said = items[-1] if items else ("", "")
        if entry:
            items.append((entry["names"], entry["text"]))
        elif not items or (names and line[0].isupper() and said.endswith(".")):
            items.append(("", line))
        else:
            items[-1] = (names, f"{said} {line}")
    written: list[str] = []
    for place, (names, said) in enumerate(items):
        if place and not (names and items[place - 1][0]):
            written.append("")
        written.append(f"- ``{names}``: {_inline(said)}" if names else _inline(said))
    return written


def _inline(text: str) -> str:
    parts = re.split(r"``(.+?)``|`(.+?)`", text)
    written = ""
    for plain, double, single in zip(parts[::3], [*parts[1::3], None], [*parts[2::3], None], strict=True):
        glue = "\\ " if written and plain[:1].isalnum() else ""
        written += glue + SPECIAL.sub(r"\\\1", plain)
        code = double or single
        if code:
            name = code.removeprefix("nt.")
            written += f":py:obj:`{code} <neurotact.{name}>`" if name in dir(neurotact) else f"``{code}``"
    return written


def _process(_app: "Sphinx", _what: str, _name: str, _object: object, _options: object, lines: list[str]) -> None:
    lines[:] = to_rest(lines)


def _name_unions(
    _app: "Sphinx",
    _what: str,
    _name: str,
    _object: object,
    _options: object,
    signature: str | None,
    returns: str | None,
) -> tuple[str | None, str | None]:
    """What NumPy takes as an array, by the name of that union."""
    from sphinx.util.typing import stringify_annotation

    for mode in ("smart", "fully-qualified-except-typing"):
        signature = signature and signature.replace(stringify_annotation(ArrayLike, mode), "ArrayLike")
    return signature, returns


def _skip(_app: "Sphinx", _what: str, name: str, _object: object, skip: bool, _options: object) -> bool:
    """Methods that scikit-learn gives every estimator to route metadata."""
    return skip or re.fullmatch(r"set_\w+_request", name) is not None


def setup(app: "Sphinx") -> dict[str, bool]:
    """Read every docstring so."""
    app.connect("autodoc-process-docstring", _process)
    app.connect("autodoc-process-signature", _name_unions)
    app.connect("autodoc-skip-member", _skip)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
