"""The moving parts of a report's page: its style, its scripts, the drawing library and the data."""

import json
from base64 import b64encode
from collections.abc import Sequence
from functools import lru_cache
from gzip import compress
from hashlib import sha256
from importlib import resources
from typing import Any, NamedTuple

from markupsafe import Markup
from plotly.offline import get_plotlyjs

NETWORKS = ("marks.js", "plotly.js", "cell.js", "trade_off.js", "table.js", "main.js")
PROTOCOL = ("marks.js", "plotly.js", "table.js", "protocol.js")


class Table(NamedTuple):
    """A table as text: what it shows, the heads of its columns, its rows, each headed by its first `n_heads` cells."""

    caption: str
    columns: list[str]
    rows: list[list[str]]
    n_heads: int = 0


class Parts(NamedTuple):
    """What the template puts into the page as it is.

    plotly: the library, gzipped and in base64: 2 MB in place of 4.8, unpacked by the browser.
    policy: a content security policy under which these two scripts run and nothing is fetched.
    """

    style: Markup
    script: Markup
    plotly: Markup
    data: Markup
    policy: str


def parts(data: dict[str, Any], scripts: Sequence[str]) -> Parts:
    """The parts of a page that shows `data` by the named scripts."""
    script = "\n".join(["(() => {", '"use strict";', *map(_read, scripts), "})();"])
    plotly, library_hash = _plotly()
    allowed = f"'sha256-{_hash(script)}' '{library_hash}'"
    policy = (
        f"default-src 'none'; script-src {allowed}; style-src 'unsafe-inline'; img-src data: blob:; "
        "base-uri 'none'; form-action 'none'"
    )
    return Parts(Markup(_read("style.css")), Markup(script), Markup(plotly), Markup(script_json(data)), policy)


def script_json(value: Any) -> str:
    """JSON that cannot end the script element that holds it.

    >>> script_json({"name": "</script>&"})
    '{"name":"\\\\u003c/script\\\\u003e\\\\u0026"}'
    """
    text = json.dumps(value, separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


@lru_cache(maxsize=1)
def _plotly() -> tuple[str, str]:
    """plotly.js packed, and its hash as a policy names it."""
    library = get_plotlyjs()
    return b64encode(compress(library.encode(), 9, mtime=0)).decode(), f"sha256-{_hash(library)}"


def _read(name: str) -> str:
    return (resources.files("neurotact.studies") / "page" / name).read_text(encoding="utf-8")


def _hash(script: str) -> str:
    return b64encode(sha256(script.encode()).digest()).decode()
