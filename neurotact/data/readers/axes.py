"""The axes of arrays of signals, in any order, and grids of taxels; all become `(trial, time, taxel)`."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from neurotact.errors import InputError

TRIAL, TIME, TAXEL, ROW, COLUMN = "trial", "time", "taxel", "row", "column"
AXES, GRID = (TRIAL, TIME, TAXEL), (TRIAL, TIME, ROW, COLUMN)
LAYOUTS = ((TRIAL, TIME), AXES, GRID)
"""The axes that an array of signals can have; without one of taxels there is one taxel."""
TIME_LAST = (TRIAL, ROW, COLUMN, TIME)
LONGER = 2
"""The time of a grid has this many times as many samples as the grid has rows or columns, or must be named."""


class Grid(NamedTuple):
    """The number of rows and of columns of a grid of taxels."""

    rows: int
    columns: int

    @property
    def channels(self) -> tuple[str, ...]:
        """The names of its taxels, row by row.

        >>> Grid(2, 2).channels
        ('r0c0', 'r0c1', 'r1c0', 'r1c1')
        """
        return tuple(f"r{row}c{column}" for row in range(self.rows) for column in range(self.columns))


def order_of(axes: str | None, shape: Sequence[int], where: str) -> tuple[str, ...]:
    """The names of the axes of an array, in their order, as given or by their lengths.

    Raises InputError for axes that do not fit the array, and where several orders do.

    >>> order_of(None, (20, 6, 10, 75), "touch.npz: 'X'"), order_of("time,taxel,trial", (50, 3, 20), "touch.npz: 'X'")
    (('trial', 'row', 'column', 'time'), ('time', 'taxel', 'trial'))
    """
    if axes is None:
        return _usual(shape, where)
    order = tuple(part.strip() for part in axes.split(","))
    if not any(sorted(order) == sorted(layout) for layout in LAYOUTS):
        raise InputError(
            "axes must name trial, time and taxel, each once, as in trial,taxel,time, or trial, time, row and column "
            f"of a grid, or trial and time of one taxel; got {axes[:60]}"
        )
    if len(order) != len(shape):
        raise InputError(
            f"{where} has the shape {tuple(shape)}, so {len(order)} axes do not fit ({axes}); name each axis"
        )
    return order


def _usual(shape: Sequence[int], where: str) -> tuple[str, ...]:
    if len(shape) == len(AXES):
        return AXES
    if len(shape) != len(TIME_LAST):
        raise InputError(f"{where} has the shape {tuple(shape)}; give an array of trials, samples and taxels")
    fitting = [
        order for order in (GRID, TIME_LAST)
        if _length(order, shape, TIME) >= LONGER * max(_length(order, shape, ROW), _length(order, shape, COLUMN))
    ]  # fmt: skip
    if len(fitting) != 1:
        raise InputError(
            f"{where} has the shape {tuple(shape)}, of which no axis is clearly the time; give "
            f"`axes='{','.join(GRID)}'` or `axes='{','.join(TIME_LAST)}'`"
        )
    return fitting[0]


def _length(order: Sequence[str], shape: Sequence[int], axis: str) -> int:
    return shape[order.index(axis)]


def stacked(values: np.ndarray, order: Sequence[str]) -> tuple[np.ndarray, Grid | None]:
    """Signals as `(trial, time, taxel)`, and the grid that their taxels are, if any, row by row.

    >>> flat, grid = stacked(np.arange(8).reshape(1, 2, 2, 2), ("trial", "row", "column", "time"))
    >>> flat.tolist(), grid
    ([[[0, 2, 4, 6], [1, 3, 5, 7]]], Grid(rows=2, columns=2))
    """
    layout = next(layout for layout in LAYOUTS if sorted(layout) == sorted(order))
    ordered = np.ascontiguousarray(values.transpose([order.index(axis) for axis in layout]))
    grid = Grid(*ordered.shape[2:]) if layout == GRID else None
    return ordered.reshape(*ordered.shape[:2], -1), grid


def stacked_cells(
    cells: Sequence[np.ndarray], axes: str | None, where: str
) -> tuple[list[np.ndarray], Grid | None, tuple[str, ...]]:
    """The signals of a cell array of matrices, `(time, taxel)` of each trial, their grid, and the order of their axes.

    A cell array of vectors is of one taxel. Raises InputError for cells of other taxels than the first one.

    >>> signals, grid, _ = stacked_cells([np.ones((5, 2)), np.ones((4, 2))], None, "touch.mat: 'trials'")
    >>> [signal.shape for signal in signals], grid
    ([(5, 2), (4, 2)], None)
    """
    is_one_taxel = axes is None and all(cell.ndim == 1 for cell in cells)
    order = LAYOUTS[0] if is_one_taxel else order_of(axes, (1, *cells[0].shape), where)
    if order[0] != TRIAL:
        raise InputError(
            f"{where} is a cell array with a trial in each cell; begin `axes` with trial, as in "
            "`axes='trial,time,taxel'`"
        )
    trials: list[np.ndarray] = []
    grids: list[Grid | None] = []
    for number, cell in enumerate(cells, 1):
        if cell.ndim != len(order) - 1:
            raise InputError(
                f"{where}, cell {number}, has the shape {cell.shape}; give each trial the axes of the first one"
            )
        signal, grid = stacked(cell[None], order)
        if trials and (signal.shape[2] != trials[0].shape[1] or grid != grids[0]):
            other = "" if axes else "; if its axes are taxel and time, use `axes='trial,taxel,time'`"
            raise InputError(
                f"{where}, cell {number}, has {signal.shape[2]} taxels where the first has {trials[0].shape[1]}{other}"
            )
        trials.append(signal[0])
        grids.append(grid)
    return trials, grids[0], order
