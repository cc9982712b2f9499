"""Equations as MathML, which browsers draw by themselves: no script, and nothing fetched from elsewhere."""

from typing import Any

from docutils import nodes
from docutils.utils.math import MathError, latex2mathml
from sphinx.application import Sphinx
from sphinx.errors import ExtensionError


def _markup(text: str, *, inline: bool) -> str:
    try:
        return latex2mathml.tex2mathml(text, as_block=not inline)
    except MathError as error:
        raise ExtensionError(f"the equation {text!r} cannot be drawn: {error}") from error


def _inline(writer: Any, node: nodes.math) -> None:
    writer.body.append(_markup(node.astext(), inline=True))
    raise nodes.SkipNode


def _block(writer: Any, node: nodes.math_block) -> None:
    writer.body.append(f'<div class="equation">{_markup(node.astext(), inline=False)}</div>')
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, bool]:
    """Make this the way in which the site draws equations."""
    app.add_html_math_renderer("mathml", (_inline, None), (_block, None))
    app.config.html_math_renderer = "mathml"
    return {"parallel_read_safe": True, "parallel_write_safe": True}
