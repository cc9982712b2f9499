"""Pages ask nobody else for anything: no fonts, scripts, styles or pictures from another host."""

import re
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sphinx.application import Sphinx

REQUEST = re.compile(
    r"""<(?:script|img|iframe|source|video|audio|embed)\b[^>]*\bsrc=["']?(?:https?:)?//[^\s"'>]+
    |<link\b(?![^>]*rel=["']?(?:canonical|next|prev|search)\b)[^>]*\bhref=["']?(?:https?:)?//[^\s"'>]+
    |(?:@import\s+|url\(\s*)["']?(?:https?:)?//[^\s"')]+""",
    re.VERBOSE,
)
"""What makes a browser ask another host while it shows a page; a link that a reader may follow does not."""


def requests(folder: Path) -> list[str]:
    """The requests to other hosts in the pages and styles of a folder, each with its file."""
    files = sorted(path for kind in ("*.html", "*.css") for path in folder.rglob(kind))
    return [
        f"{path.relative_to(folder)}: {found.group()}"
        for path in files
        for found in REQUEST.finditer(path.read_text(encoding="utf-8"))
    ]


def _check(app: "Sphinx", failure: Exception | None) -> None:
    from sphinx.util import logging

    if failure is None and app.builder.format == "html":
        for request in requests(Path(app.outdir)):
            logging.getLogger(__name__).warning("asks another host: %s", request)


def setup(app: "Sphinx") -> dict[str, bool]:
    """Look at every page when the site is built; a warning is an error there."""
    app.connect("build-finished", _check)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
