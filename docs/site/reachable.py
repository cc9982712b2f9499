"""What a keyboard and a screen reader need of a page, and Sphinx and the theme leave out."""

import re
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sphinx.application import Sphinx

SCROLLS = re.compile(r'<(?P<tag>pre|div class="(?:table-wrapper|math-wrapper)[^"]*")(?P<rest>[^>]*)>')
"""What scrolls sideways where it is wider than the page: only with the focus can a keyboard scroll it."""


def with_focus(body: str) -> str:
    """The body of a page in which everything that may scroll can have the focus.

    >>> with_focus('<div class="table-wrapper docutils container"><pre>x</pre></div>')
    '<div class="table-wrapper docutils container" tabindex="0"><pre tabindex="0">x</pre></div>'
    """
    return SCROLLS.sub(lambda found: f'<{found["tag"]}{found["rest"]} tabindex="0">', body)


def _change(_app: "Sphinx", _page: str, _template: str, context: dict, _doctree: object) -> None:
    if "body" in context:
        context["body"] = with_focus(context["body"])


def setup(app: "Sphinx") -> dict[str, bool]:
    """Change each page as it is written."""
    app.connect("html-page-context", _change)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
