"""The display of objects in a notebook."""

from collections.abc import Mapping
from html import escape


def html_of(what: object, further: Mapping[str, str] | None = None, table: str = "") -> str:
    """The short text of an object as HTML, and further facts below it, or a table in HTML.

    >>> html_of("spikes <2>", {"t_ref of sa1": "5 ms"})
    '<code>&#x27;spikes &lt;2&gt;&#x27;</code><table><tr><th>t_ref of sa1</th><td>5 ms</td></tr></table>'
    """
    rows = "".join(
        f"<tr><th>{escape(name)}</th><td>{escape(value)}</td></tr>" for name, value in (further or {}).items()
    )
    return f"<code>{escape(repr(what))}</code>" + (f"<table>{rows}</table>" if rows else "") + table
