"""Figures of a report at the width of a journal's column: panels that stand beside each other go below each other."""

from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec
from matplotlib.legend import Legend

from neurotact.figures.style import printed

NARROW_in = 5.0
"""Below it, a figure has one column of panels."""
PAGE_in = 9.0
"""The most height of a figure: IEEE, Nature and Frontiers print 9.2 to 9.7 in, and the caption needs a line."""


@printed
def fit(figure: Figure, width_in: float) -> Figure:
    """Give a figure this width; its texts keep their size, and its panels theirs in height if a page has room."""
    if width_in < NARROW_in:
        _stack(figure)
    figure.set_layout_engine("constrained")
    figure.set_size_inches(width_in, min(figure.get_figheight(), PAGE_in))
    figure.draw_without_rendering()  # the width of a legend is known once it is drawn
    for legend in [*figure.legends]:
        if legend.get_window_extent().width > width_in * figure.dpi:
            _narrow(figure, legend, width_in)
    return figure


def _narrow(figure: Figure, legend: Legend, width_in: float) -> None:
    """Put a legend above all panels in place of one that is too wide, with as many columns as fit."""
    names = [text.get_text() for text in legend.get_texts()]
    title = legend.get_title().get_text() or None
    handles = [handle for handle in legend.legend_handles if handle is not None]
    legend.remove()
    for n_columns in range(len(names), 0, -1):
        new = figure.legend(handles, names, loc="outside upper center", ncols=n_columns, title=title)
        figure.draw_without_rendering()
        if new.get_window_extent().width <= width_in * figure.dpi:
            return
        if n_columns > 1:
            new.remove()


def _stack(figure: Figure) -> None:
    """Put the panels of a grid below each other, row by row, each as high as it was."""
    places: list[tuple[Axes, Any]] = [(axes, axes.get_subplotspec()) for axes in figure.axes]
    places = [(axes, place) for axes, place in places if place is not None]
    grids = {id(place.get_gridspec()): place.get_gridspec() for _, place in places}
    grid = next(iter(grids.values()), None)
    if len(grids) != 1 or grid is None or grid.ncols == 1:
        return
    ratios = grid.get_height_ratios()
    cells = sorted({(place.rowspan.start, place.colspan.start, place.rowspan.stop) for _, place in places})
    heights = [sum(ratios[first:last]) for first, _, last in cells]
    figure.set_figheight(figure.get_figheight() * sum(heights) / sum(ratios))
    stacked = GridSpec(len(cells), 1, figure=figure, height_ratios=heights)
    for axes, place in places:
        axes.set_subplotspec(stacked[cells.index((place.rowspan.start, place.colspan.start, place.rowspan.stop))])
        axes.tick_params(labelleft=axes.yaxis.get_ticks_position() in ("left", "default", "unknown"), labelbottom=True)
