"""What a keyboard and a screen reader need of a page, and Sphinx and the theme leave out."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sphinx.application import Sphinx

Change = tuple[str, str | Callable[[re.Match[str]], str]]


def _signature(found: re.Match[str]) -> str:
    """The lines of a signature, which are no definition list: they stand in a term of one, and have no terms."""
    lines = found[0].replace("<dd>", '<span class="sig-line">').replace("</dd>", "</span>")
    return lines.replace("<dl>", '<span class="sig-lines">').replace("</dl>", "</span>")


CHANGES: tuple[Change, ...] = (
    # What scrolls sideways where it is wider than the page: only with the focus can a keyboard scroll it.
    (r'<(pre|div class="(?:table-wrapper|math-wrapper|output_subarea)[^"]*")>', r'<\1 tabindex="0">'),
    (r"<dl>\s*(?:<dd>(?:(?!</?d[ld]>).)*</dd>\s*)+</dl>", _signature),
    # A head without words is no head: a corner above heads of rows, or a table of pictures.
    (r'<th( class="head[^"]*")?>\s*(?:<p>\s*</p>\s*)?</th>', r"<td\1></td>"),
    (r'(?<!</h1>)<div id="search-results">', '<h1>Search</h1><div id="search-results">'),
    (r'role="heading">', 'role="heading" aria-level="2">'),
    (r'<aside class="sidebar-drawer">', '<aside class="sidebar-drawer" aria-label="Pages">'),
    (r'<aside class="toc-drawer([^"]*)">', r'<aside class="toc-drawer\1" aria-label="On this page">'),
    # On a phone a picture is small: it opens at its full size.
    (r'<p>(<img [^>]*src="([^"]+)"[^>]*>)\s*</p>', r'<p><a href="\2">\1</a></p>'),
    # A picture of the gallery covers the text of its link, which is hidden.
    (
        r'(<a class="reference internal" href="[^"]*")(><span class="doc">([^<]*)</span></a>)',
        lambda found: f'{found[1]} aria-label="{found[3]}"{found[2]}',
    ),
)
"""Patterns of HTML and what takes their place; none of them finds what another has made, nor its own."""


def reachable(html: str) -> str:
    """A page with the changes.

    >>> reachable('<dt>f(<dl>\\n<dd>a,</dd>\\n<dd>b</dd>\\n</dl>)</dt><pre>x</pre>').replace("\\n", "")
    '<dt>f(<span class="sig-lines"><span class="sig-line">a,</span><span class="sig-line">b</span></span>)</dt>\
<pre tabindex="0">x</pre>'
    """
    for pattern, place in CHANGES:
        html = re.sub(pattern, place, html, flags=re.DOTALL)
    return html


def _change(app: "Sphinx", failure: Exception | None) -> None:
    if failure is None and app.builder.format == "html":
        for page in Path(app.outdir).rglob("*.html"):
            before = page.read_text(encoding="utf-8")
            after = reachable(before)
            if after != before:
                page.write_text(after, encoding="utf-8")


def setup(app: "Sphinx") -> dict[str, bool]:
    """Change the pages when all are written."""
    app.connect("build-finished", _change)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
