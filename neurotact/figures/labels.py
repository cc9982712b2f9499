"""Labels of the points of a figure, placed so that they touch no mark, no other label and no edge."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke

DIRECTIONS = ((1, 0), (1, -1), (1, 1), (-1, 0), (-1, 1), (-1, -1), (0, 1), (0, -1))
"""Sides of a point for its label, the preferred one first."""
DISTANCES_pt = (5.0, 9.0)
"""Distances from the point to the nearest edge of the label."""
CLEAR_pt = 1.0
"""Distance between a label and anything that it must not touch."""
HALO = [withStroke(linewidth=3.5, foreground="white")]
"""Halo around a label, so that it is readable where it crosses a line."""

Box = np.ndarray
"""Left, bottom, right and top in pixels; several boxes are `(box, 4)`."""


def label_points(axes: Axes, x: Sequence[float], y: Sequence[float], words: Sequence[str], **style: Any) -> int:
    """Label each point and return the number of labels.

    A label touches no mark, no other text and no edge of the panel; of the remaining places, the one that crosses the
    fewest lines is used, with a white halo at a crossing. A distant label is joined to its point by a thin line. If no
    place is left, the point has no label. Call it after everything else is drawn, including the legend: places depend
    on the figure's current size.

    x, y: of the points, in data. style: of the text, as `Axes.annotate` takes it.

    >>> from neurotact.figures.style import new_figure
    >>> axes = new_figure(2.0).subplots()
    >>> _ = axes.plot([0, 1], [0, 1], "o")
    >>> label_points(axes, [0, 1], [0, 1], ["50 ms", "100 ms"])
    2
    """
    style = {"path_effects": HALO, **style}
    figure = axes.get_figure(root=True)
    assert figure is not None
    figure.draw_without_rendering()
    pixels_per_pt = figure.dpi / 72
    frame = np.array(axes.get_window_extent().extents)
    taken = [*_marks(axes, pixels_per_pt), *(np.array(text.get_window_extent().extents) for text in axes.texts)]
    strokes = _strokes(axes)
    places = axes.transData.transform(np.column_stack([np.asarray(x, float), np.asarray(y, float)]))
    written = 0
    for point, value, word in zip(places, zip(x, y, strict=True), words, strict=True):
        text = axes.annotate(word, value, xytext=(0, 0), textcoords="offset points", **style)
        text.set_in_layout(False)
        left, bottom, right, top = text.get_window_extent().extents
        boxes = _candidates(point, right - left, top - bottom, pixels_per_pt)
        free = [box for box in boxes if _is_within(box, frame) and not _touches(box, taken, CLEAR_pt * pixels_per_pt)]
        if not free:
            text.remove()
            continue
        box = min(free, key=lambda box: _n_crossed(box, strokes))
        text.set_position(tuple((box[:2] - (left, bottom)) / pixels_per_pt))
        if _gap(point, box) > pixels_per_pt * (DISTANCES_pt[0] + CLEAR_pt):
            text.remove()
            line = {"arrowstyle": "-", "lw": 0.5, "color": text.get_color(), "shrinkA": 0, "shrinkB": 2}
            text = axes.annotate(
                word, value, xytext=text.get_position(), textcoords="offset points", arrowprops=line, **style
            )
            text.set_in_layout(False)
        taken.append(box)
        written += 1
    return written


def _gap(point: np.ndarray, box: Box) -> float:
    """From a point to the nearest edge of a box."""
    return float(np.hypot(*np.maximum(np.maximum(box[:2] - point, point - box[2:]), 0.0)))


def _candidates(point: np.ndarray, width: float, height: float, pixels_per_pt: float) -> list[Box]:
    """Boxes of that size around a point, in order of preference."""
    half = np.array([width, height]) / 2
    middles = [
        point + np.array(direction) * (half + pixels_per_pt * distance / np.hypot(*direction))
        for distance in DISTANCES_pt
        for direction in DIRECTIONS
    ]
    return [np.concatenate([middle - half, middle + half]) for middle in middles]


def _marks(axes: Axes, pixels_per_pt: float) -> list[Box]:
    """A box around each drawn mark."""
    boxes = []
    for line in axes.lines:
        if line.get_marker() in ("None", "none", " ", "", None) or line.get_transform() != axes.transData:
            continue
        half = pixels_per_pt * line.get_markersize() / 2
        places = axes.transData.transform(np.asarray(line.get_xydata(), float))
        boxes += [np.concatenate([point - half, point + half]) for point in places if np.isfinite(point).all()]
    return boxes


def _strokes(axes: Axes) -> np.ndarray:
    """The drawn lines in pixels, sampled every few pixels, `(sample, 2)`."""
    paths = [_path(line) for line in axes.lines if line.get_linestyle() not in ("None", "none", " ", "")]
    samples = [np.empty((0, 2))]
    for path in paths:
        for start, stop in pairwise(path):
            if np.isfinite([start, stop]).all():
                n = int(np.hypot(*(stop - start)) // 3) + 2
                samples.append(np.linspace(start, stop, n))
    return np.concatenate(samples)


def _path(line: Line2D) -> np.ndarray:
    """The corners of a line in pixels, including those of its steps."""
    path = line.get_path()
    corners = np.asarray(path.vertices, float)
    if line.get_drawstyle() == "steps-post" and len(corners):
        x, y = np.repeat(corners, 2, axis=0).T
        corners = np.column_stack([x[1:], y[:-1]])
    return line.get_transform().transform(corners)


def _is_within(box: Box, frame: Box) -> bool:
    return bool((box[:2] >= frame[:2]).all() and (box[2:] <= frame[2:]).all())


def _touches(box: Box, others: Sequence[Box], clear: float) -> bool:
    if not others:
        return False
    boxes = np.stack(others)
    apart = (boxes[:, :2] >= box[2:] + clear) | (boxes[:, 2:] <= box[:2] - clear)
    return bool((~apart.any(axis=1)).any())


def _n_crossed(box: Box, strokes: np.ndarray) -> int:
    return int(((strokes >= box[:2]) & (strokes <= box[2:])).all(axis=1).sum())
