"""Pictures of figures that an example's functions return, which pyplot does not know: for the gallery."""

from collections.abc import Callable
from pathlib import Path
from typing import Any
from weakref import WeakSet

from matplotlib.figure import Figure
from sphinx_gallery.scrapers import figure_rst

SHOWN: WeakSet[Figure] = WeakSet()
"""Figures that are on a page already; those of pyplot have a number, and a scraper of their own."""


def pictures(_block: tuple[str, str, int], variables: dict[str, Any], settings: dict[str, Any]) -> str:
    """The figures that are new among the names of an example, as pictures on its page."""
    named = variables["example_globals"].values()
    figures = [each for each in named if isinstance(each, Figure) and not hasattr(each, "number") and each not in SHOWN]
    paths: list[str] = []
    for figure, path in zip(figures, variables["image_path_iterator"], strict=False):
        figure.savefig(path)
        SHOWN.add(figure)
        paths.append(str(Path(path)))
    return figure_rst(paths, settings["src_dir"])


def _get_sg_image_scraper() -> Callable[..., str]:
    return pictures
