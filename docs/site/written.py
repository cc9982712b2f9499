"""Pages whose text stands elsewhere, in a file or in the program, and is put in when the site is built."""

import csv
import re
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import command_line
import executors_reference
import python_reference
import spec_reference

if TYPE_CHECKING:
    from sphinx.application import Sphinx

TOP = Path(__file__).parents[2]
PLACE = "<!-- written by make docs -->"
"""Where a page takes the text that is written for it."""


def of_the_top(name: str) -> str:
    """A Markdown file of the top folder, with links that hold in docs/."""
    text = (TOP / name).read_text(encoding="utf-8")
    return re.sub(r"\]\((?!\w+:|#)(?:docs/)?", lambda found: "](" if "docs/" in found.group() else "](../", text)


def negatives() -> str:
    """The table of what did not help, with a link to the page of each line."""
    docs = TOP / "docs"
    with (docs / "data" / "negatives.csv").open(encoding="utf-8", newline="") as lines:
        rows = [{name: text.replace("|", r"\|") for name, text in row.items()} for row in csv.DictReader(lines)]
    for row in rows:
        page = f"{row['where']}.md"
        row["where"] = f"[{row['where']}](../{page})" if (docs / page).is_file() else row["where"]
    return "\n".join(
        ["| idea | set | result | where |", "|---|---|---|---|"] + [f"| {' | '.join(row.values())} |" for row in rows]
    )


WRITTEN: dict[str, Callable[[], str]] = {
    "contributing": lambda: of_the_top("CONTRIBUTING.md"),
    "changelog": lambda: of_the_top("CHANGELOG.md"),
    "results/negatives": negatives,
    "reference/python": python_reference.overview,
    **{f"reference/python/{name}": partial(python_reference.page, name) for name in python_reference.SUBJECTS},
    "reference/command-line": command_line.page,
    "reference/specs": spec_reference.page,
    "reference/executors": executors_reference.page,
}
"""What writes the text of each page."""


def _write(_app: "Sphinx", page: str, source: list[str]) -> None:
    if page in WRITTEN:
        before, after = source[0].split(PLACE)
        source[0] = before + WRITTEN[page]() + after


def setup(app: "Sphinx") -> dict[str, bool]:
    """Write the texts as their pages are read."""
    app.connect("source-read", _write)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
