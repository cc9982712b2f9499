"""The style of figures: colours, sizes, words on an axis, and saving."""

from collections.abc import Callable, Iterable, Sequence
from functools import wraps
from io import BytesIO
from pathlib import Path
from typing import Any, Literal, NamedTuple, ParamSpec

import numpy as np
from matplotlib import colormaps, rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.ticker import (
    FixedFormatter,
    FuncFormatter,
)

from neurotact.errors import InputError
from neurotact.files import whole

P = ParamSpec("P")

WIDTH_in = 7.2
"""Two columns of a journal page."""
SUFFIXES = (".png", ".svg", ".pdf")
SHOWN_dpi = 110
"""Resolution of a figure in a notebook, whose column is about 800 pixels wide."""

# The texture paper's Figs. 5 and 6: SA-I blue, RA-I orange, their sum green; tones that are distinct for colour-blind
# readers and in grey print (after Okabe and Ito).
SA, RA, TOTAL = "#0072B2", "#E06C00", "#009E73"
INK, MUTED, PALE = "#1f1f1f", "#666666", "#d9d9d9"
SYMBOLS = (r"$t_\mathrm{ref}$", r"$N_\mathrm{max}$")
"""The only formula; any other dollar sign belongs to the name of a class."""
LONGEST_WORDS, LONGEST_TICK = 200, 40
PAIR_TITLE = r"$t_\mathrm{ref}$ of RA-I & SA-I"
PAIR_AXIS = f"{PAIR_TITLE} (ms)"
SERIES = (
    ("#0072B2", "o"),
    ("#56B4E9", "s"),
    ("#009E73", "^"),
    ("#CC79A7", "D"),
    ("#D55E00", "v"),
    ("#1f1f1f", "P"),
)
"""Colour and marker of each series."""

RC: Any = {
    "font.family": "DejaVu Sans",
    "font.size": 8.0,
    "axes.titlesize": 8.5,
    "axes.titleweight": "bold",
    "axes.labelsize": 8.0,
    "axes.labelcolor": INK,
    "axes.edgecolor": MUTED,
    "axes.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.unicode_minus": True,
    "axes.axisbelow": True,
    "axes.prop_cycle": "cycler('color', ['#0072B2', '#E06C00', '#009E73', '#CC79A7', '#56B4E9', '#1f1f1f'])",
    "xtick.labelsize": 7.5,
    "ytick.labelsize": 7.5,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "text.color": INK,
    "grid.color": "#e6e6e6",
    "grid.linewidth": 0.6,
    "legend.fontsize": 7.5,
    "legend.frameon": False,
    "lines.linewidth": 1.2,
    "figure.facecolor": "white",
    "savefig.facecolor": "white",
    "path.simplify": False,
    "svg.fonttype": "path",
    "svg.hashsalt": "neurotact",
    "pdf.fonttype": 42,
}


class Drawn(NamedTuple):
    """A figure of the report: file name, title, figure, caption, and text alternative."""

    name: str
    title: str
    figure: Figure
    caption: str
    alt: str


def printed(draw: Callable[P, Figure]) -> Callable[P, Figure]:
    """A drawing function whose figure has neurotact's style, for any settings of matplotlib."""

    @wraps(draw)
    def styled(*args: P.args, **kwargs: P.kwargs) -> Figure:
        with rc_context(RC):
            return draw(*args, **kwargs)

    return styled


class _NotebookFigure(Figure):
    """A figure that a notebook shows as the last value of a cell, with or without pyplot.

    The inline backend shows only figures made by pyplot; this one provides its picture through IPython's `_repr_png_`.
    It is never registered with pyplot, so it need not be closed.

    >>> new_figure(1.0)._repr_png_()[1:4]
    b'PNG'
    """

    def _repr_png_(self) -> bytes:
        _show_names_as_they_are(self)
        picture = BytesIO()
        with rc_context(RC):
            self.savefig(picture, format="png", dpi=SHOWN_dpi)
        return picture.getvalue()


def new_figure(height_in: float, width_in: float = WIDTH_in) -> Figure:
    """An empty figure with automatic layout."""
    return _NotebookFigure(figsize=(width_in, height_in), layout="constrained")


def new_panels(
    n: int, most_columns: int, height_in: float, head_in: float = 0.0, **shared: Any
) -> tuple[Figure, list[Axes]]:
    """A figure and its `n` panels, row by row.

    height_in: of a row; head_in: of what stands above them; shared: of matplotlib's subplots.
    """
    n_columns = min(n, most_columns)
    n_rows = -(-n // n_columns)
    figure = new_figure(head_in + height_in * n_rows)
    panels = figure.subplots(n_rows, n_columns, squeeze=False, **shared).ravel().tolist()
    for spare in panels[n:]:
        spare.remove()
    return figure, panels[:n]


def save(figure: Figure, path: str | Path) -> None:
    """Write a figure in the format of its suffix, whole or not at all; the same figure gives the same bytes.

    Raises InputError for a suffix that is not .png, .svg or .pdf.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(f"{path}: figures are written as {', '.join(SUFFIXES)}; end the name with one of them")
    _show_names_as_they_are(figure)
    undated: dict[str, Any] = {".png": {"Software": None}, ".svg": {"Date": None}, ".pdf": {"CreationDate": None}}
    with rc_context(RC), whole(path) as draft:
        figure.savefig(draft, format=suffix[1:], dpi=200, metadata=undated[suffix])


def _show_names_as_they_are(figure: Figure) -> None:
    """Make names safe: no formulas, no characters without a glyph, no excessive length.

    Numeric ticks keep their powers of ten.
    """
    for text in figure.findobj(Text):
        words = text.get_text()
        text.set_text(_as_shown(words, LONGEST_WORDS))
        text.set_parse_math(words.count("$") == 2 * sum(map(words.count, SYMBOLS)))
    for axis in (axis for axes in figure.axes for axis in (axes.xaxis, axes.yaxis)):
        formatter = axis.get_major_formatter()
        is_named = isinstance(formatter, (FuncFormatter, FixedFormatter))
        names = [label.get_text() for label in axis.get_majorticklabels()]
        shown = [_as_shown(name, LONGEST_TICK) for name in names]
        if is_named and names != shown:
            axis.set_major_formatter(FixedFormatter(shown))
        for label in (*axis.get_majorticklabels(), *axis.get_minorticklabels()):
            label.set_parse_math(not is_named)


def _as_shown(words: str, longest: int) -> str:
    """A text for a figure: control characters replaced, cut if too long.

    >>> _as_shown("felt", 4), _as_shown("polyester", 5)
    ('felt', 'poly…')
    """
    plain = "".join(letter if letter.isprintable() or letter in "\n\xa0" else "\ufffd" for letter in words)
    return plain if len(plain) <= longest else f"{plain[: longest - 1]}…"


def add_legend(figure: Figure, panels: Iterable[Axes], ncols: int, **kwargs: Any) -> None:
    """One legend above all panels, with each label once; the colour of a thin line is seen in it."""
    legends = [axes.get_legend_handles_labels() for axes in panels]
    handles = {label: handle for both in legends for handle, label in zip(*both, strict=True)}
    added = figure.legend(list(handles.values()), list(handles), loc="outside upper center", ncols=ncols, **kwargs)
    for line in added.get_lines():
        line.set_linewidth(max(line.get_linewidth(), RC["lines.linewidth"]))


def bars(mean: Any, deviation: Any, whole: float | None = 100.0) -> np.ndarray:
    """Lengths of an error bar below and above a mean, within 0 and `whole`, `(2, point)`, the range of an accuracy.

    mean, deviation: a number or `(point,)`; if one is absent (NaN) there is no bar.
    whole: 100 for percent, 1 for shares; None for an unbounded quantity, whose bars are the deviation on both sides.

    >>> bars([98.0, 50.0, 1.0], [5.0, 5.0, 5.0]).tolist()
    [[5.0, 5.0, 1.0], [2.0, 5.0, 5.0]]
    """
    mean, deviation = np.atleast_1d(np.asarray(mean, float)), np.nan_to_num(np.asarray(deviation, float))
    if whole is None:
        return np.stack([np.where(np.isnan(mean), 0.0, deviation)] * 2)
    ends = np.clip(mean - deviation, 0.0, whole), np.clip(mean + deviation, 0.0, whole)
    return np.nan_to_num(np.maximum([mean - ends[0], ends[1] - mean], 0.0))


def keep_within(panels: Iterable[Axes], whole: float = 100.0, axis: Literal["x", "y"] = "y") -> None:
    """Limit the axis of drawn accuracies to 0 and `whole`; marks at an end are still drawn whole.

    Call it when everything is drawn: later drawing no longer changes the limits.
    """
    for panel in panels:
        low, high = panel.get_ylim() if axis == "y" else panel.get_xlim()
        (panel.set_ylim if axis == "y" else panel.set_xlim)(max(low, 0.0), min(high, whole))
        for line in panel.lines:
            line.set_clip_on(False)
            line.set_in_layout(False)


def name_ticks(axes: Axes, names: Sequence[str], positions: Sequence[float] | np.ndarray | None = None) -> None:
    """Name ticks of the x axis, at 0, 1, ... by default; rotated if the names are long."""
    aslant: Any = {"rotation": 40, "ha": "right", "rotation_mode": "anchor"} if max(map(len, names)) > 4 else {}
    axes.set_xticks(np.arange(len(names)) if positions is None else positions, names, **aslant)


def sequence(n: int) -> list[Any]:
    """Colours of `n` steps of one quantity, from light to dark; one dark colour for a single step."""
    return list(colormaps["viridis"]([0.3] if n == 1 else np.linspace(0.78, 0.02, n)))


def series_style(index: int) -> dict[str, Any]:
    """Colour and marker of the series at `index`, as keywords of a plot."""
    colour, marker = SERIES[index % len(SERIES)]
    return {"color": colour, "marker": marker}
