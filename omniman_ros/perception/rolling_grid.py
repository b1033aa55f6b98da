"""Square grids in odom that follow the robot by whole cells."""

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.arrays import Array
from omniman_ros.perception.scan import Indices, Mask

Cell = TypeVar("Cell", bound=np.generic)


def centered_corner(center: Array, resolution: float, count: int) -> Indices:
    """Return column and row (2,) in odom of the first cell of a grid around a place (2,) [m]."""
    corner: Indices = np.floor(center / resolution).astype(np.intp) - count // 2
    return corner


def shifted(cells: NDArray[Cell], shift: Indices, fill: float) -> NDArray[Cell]:
    """Return the cells (n, n) of a grid that has moved by columns and rows (2,), others `fill`."""
    count = len(cells)
    moved = np.full_like(cells, fill)
    if np.abs(shift).max() < count:
        columns, rows = shift.tolist()
        moved[_span(-rows, count), _span(-columns, count)] = cells[
            _span(rows, count), _span(columns, count)
        ]
    return moved


def _span(shift: int, count: int) -> slice:
    """Return the part of an axis that is still there after a shift."""
    return slice(max(shift, 0), min(count + shift, count))


def grown(cells: Mask, steps: int, first: int = 0) -> Mask:
    """Return cells (n, n) and those that are near them, by steps of one cell.

    The steps go to four neighbours and to eight by turns, after `first` others: an octagon, whose
    extent along a diagonal is 6 % above that along an axis.
    """
    result = cells.copy()
    for step in range(first, first + steps):
        before = result
        result = before.copy()
        result[1:] |= before[:-1]
        result[:-1] |= before[1:]
        source = result.copy() if step % 2 else before
        result[:, 1:] |= source[:, :-1]
        result[:, :-1] |= source[:, 1:]
    return result
