"""Maps of occupancy, and updates of a part of their cells."""

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core import plausible
from omniman_ros.core.arrays import Array, Shape
from omniman_ros.core.errors import InputError
from omniman_ros.core.validated import Validated

#: Occupancies (rows along y, columns along x) of cells, 0 to 100 [%]; negative where unknown
Cells = NDArray[np.int8]

MAX_CELLS = 25_000_000  #: Largest number of cells of a map: 250 x 250 m at 5 cm


@dataclass(frozen=True)
class MapUpdate(Validated):
    """Rectangle of cells that replaces those of a map.

    Attributes:
        column, row: Column and row of its first cell in the map.

    Raises:
        InputError: The cells do not have two axes, or there are none or too many.
    """

    #: (rows, columns) occupancies of the rectangle [%]
    values: Annotated[Cells, Shape("rows", "columns")]
    column: int
    row: int
    frame: str = ""  #: Name of the map's frame
    time: float | None = None  #: Stamp [s]; None without one

    def __post_init__(self) -> None:
        super().__post_init__()
        _require_cells(self.values)

    def is_before(self, known: "OccupancyMap") -> bool:
        """Return whether both are stamped, and the update is older than the map."""
        return self.time is not None and known.time is not None and self.time < known.time


@dataclass(frozen=True)
class OccupancyMap(Validated):
    """Map of cells, each of which is occupied with some probability.

    Raises:
        InputError: The cells do not have two axes, or there are none or too many; the resolution
            is not above 0; or the origin or the size is not finite or plausible.
    """

    #: (rows, columns) occupancies [%], read-only
    values: Annotated[Cells, Shape("rows", "columns")]
    resolution: float  #: Edge of a cell [m]
    #: (3,) x, y, yaw of the corner of the first cell in the frame [m, m, rad], read-only
    origin: Annotated[Array, Shape(3)]
    frame: str = ""  #: Name of the frame
    time: float | None = None  #: Stamp [s]; None without one

    def __post_init__(self) -> None:
        super().__post_init__()
        _require_cells(self.values)
        plausible.demand(self.origin, plausible.LENGTH, "map: origin")
        if not self.resolution > 0.0:
            raise InputError(f"the resolution is {self.resolution} m, expected above 0")
        size = self.resolution * np.array(self.values.shape, dtype=np.float64)
        plausible.demand(size, plausible.LENGTH, "map: size")

    def updated(self, update: MapUpdate) -> "OccupancyMap":
        """Return the map with the cells of an update, and with its stamp.

        Raises:
            InputError: The update is in another frame, older than the map, without a stamp
                although the map has one, or not inside of the map.
        """
        if update.frame != self.frame:
            raise InputError(f"its frame is {update.frame!r}, that of the map {self.frame!r}")
        if self.time is not None:
            if update.time is None:
                raise InputError("it is unstamped, and the map that it would change is stamped")
            if update.is_before(self):
                age = self.time - update.time
                raise InputError(f"stale, {age:.3f} s before the map that it would change")
        (height, width), (rows, columns) = update.values.shape, self.values.shape
        x, y = update.column, update.row
        if x < 0 or y < 0 or x + width > columns or y + height > rows:
            raise InputError(
                f"{width} x {height} cells from ({x}, {y}) on are not inside of a map of "
                f"{columns} x {rows}"
            )
        values = self.values.copy()
        values[y : y + height, x : x + width] = update.values
        values.setflags(write=False)
        return replace(self, values=values, time=update.time)


def cells_of(data: NDArray[np.int8], width: int, height: int) -> Cells:
    """Return the cells of a message as a read-only view of its data.

    Args:
        data: (width * height,) occupancies, row by row from the smallest y on [%].

    Raises:
        InputError: The number of cells is 0, or not what the sizes state.
    """
    # A product of the message's 32-bit integers could overflow, that of Python's cannot.
    if not data.size or int(width) < 1 or data.size != int(width) * int(height):
        raise InputError(f"there are {data.size} cells, expected {width} x {height}")
    cells = data.reshape(int(height), int(width))
    cells.setflags(write=False)
    return cells


def changed_cells(before: Cells, after: Cells) -> tuple[slice, slice] | None:
    """Return the rows and columns of the smallest rectangle with all changes; None without any."""
    differs = before != after
    rows, columns = np.flatnonzero(differs.any(axis=1)), np.flatnonzero(differs.any(axis=0))
    if not len(rows):
        return None
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)


def _require_cells(cells: Cells) -> None:
    if not 0 < cells.size <= MAX_CELLS:
        raise InputError(
            f"map: the cells have shape {cells.shape}, expected rows and columns of 1 to "
            f"{MAX_CELLS} cells"
        )
