"""An occupancy grid: which cells of the floor are taken, and discs that cover their boundary."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core import plausible
from omniman_ros.core.errors import InputError
from omniman_ros.planning.ellipses import Ellipses

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

MOST_CELLS = 4_000_000
"""A map has at most so many cells: 100 x 100 m at 5 cm."""
FINEST, COARSEST = 0.005, 1.0
"""Least and largest edge of a cell [m]."""
UNKNOWN, SURE = -1, 100
"""Values of a cell of which nothing is known, and of one that is occupied for certain."""


@dataclass(frozen=True)
class GridMap:
    """Cells of the floor, as `nav_msgs/OccupancyGrid` has them; what is not on it is free.

    Attributes:
        occupied: (rows, columns); rows along y, columns along x of the map.
        resolution: Edge of a cell [m].
        origin: (3,) x, y, yaw in odom of the lower left corner of cell (0, 0) [m, m, rad].

    Raises:
        InputError: Not two axes, no or too many cells, a resolution out of range, an origin that
            is not finite or huge.
    """

    occupied: Mask
    resolution: float
    origin: Array

    def __post_init__(self) -> None:
        cells = np.array(self.occupied, dtype=bool)
        if cells.ndim != 2 or not 0 < cells.size <= MOST_CELLS:
            raise InputError(
                f"map: cells of shape {cells.shape}, expected rows and columns of 1 to "
                f"{MOST_CELLS} cells"
            )
        if not FINEST <= self.resolution <= COARSEST:
            raise InputError(
                f"map: resolution {self.resolution} m, expected {FINEST:g} to {COARSEST:g}"
            )
        origin = np.array(self.origin, dtype=np.float64)
        if origin.shape != (3,):
            raise InputError(f"map: an origin of shape {origin.shape}, expected (3,)")
        plausible.demand(origin[:2], plausible.LENGTH, "map: origin")
        plausible.demand(origin[2:], plausible.ANGLE, "map: yaw of the origin")
        cells.setflags(write=False)
        origin.setflags(write=False)
        object.__setattr__(self, "occupied", cells)
        object.__setattr__(self, "origin", origin)

    @staticmethod
    def of_occupancy(
        data: NDArray[np.int8],
        width: int,
        height: int,
        resolution: float,
        origin: Array,
        threshold: int = 50,
        unknown_is_free: bool = False,
    ) -> "GridMap":
        """The map of a message's numbers.

        Args:
            data: (width * height,) row by row from the least y on; -1 unknown, 0 to 100 percent.
            width: Cells in a row.
            height: Rows.
            resolution: Edge of a cell [m].
            origin: (3,) pose in odom of the corner of cell (0, 0) [m, m, rad].
            threshold: A cell of this many percent or more is occupied, 1 to 100.
            unknown_is_free: Whether a cell of which nothing is known is free.

        Raises:
            InputError: Sizes that don't fit, a value or the threshold out of range; see also the
                class.
        """
        values = np.asarray(data)
        # Python's integers: a product of the message's own 32 bit ones could be cut off.
        if int(width) < 1 or int(height) < 1 or values.size != int(width) * int(height):
            raise InputError(f"map: {values.size} cells, expected {width} x {height}")
        if not 1 <= threshold <= SURE:
            raise InputError(f"map: threshold {threshold} percent, expected 1 to {SURE}")
        low, high = int(values.min()), int(values.max())
        if low < UNKNOWN or high > SURE:
            value = low if low < UNKNOWN else high
            raise InputError(f"map: a cell of value {value}, expected {UNKNOWN} to {SURE}")
        occupied = values >= threshold
        if not unknown_is_free:
            occupied = occupied | (values == UNKNOWN)
        return GridMap(occupied.reshape(int(height), int(width)), resolution, origin)

    @property
    def size(self) -> tuple[float, float]:
        """Extents along the map's own x and y [m]."""
        rows, columns = self.occupied.shape
        return columns * self.resolution, rows * self.resolution

    @property
    def radius(self) -> float:
        """Radius of the disc that just covers a cell [m]."""
        return self.resolution / math.sqrt(2.0)

    def obstacles(self) -> tuple[Array, float]:
        """Discs that cover the occupied cells at the boundary of what is occupied.

        These have a free cell among the eight around them; what is not on the map is free. Nothing
        gets to the cells behind them without touching them.

        Returns:
            Centres (M, 2) in odom [m], row by row, and the radius of all of them [m].
        """
        return self._discs, self.radius

    @cached_property
    def _discs(self) -> Array:
        """Centres of the discs; in a large map they take a while."""
        rows, columns = np.nonzero(self.occupied & ~self._within())
        own = self.resolution * (np.column_stack([columns, rows]) + 0.5)
        cos, sin = math.cos(self.origin[2]), math.sin(self.origin[2])
        centers: Array = self.origin[:2] + own @ np.array([[cos, sin], [-sin, cos]])
        centers.setflags(write=False)
        return centers

    def ellipses(self, time: float = 0.0) -> Ellipses:
        """The discs of `obstacles` as obstacles that stand, at a time [s]."""
        centers, radius = self.obstacles()
        count = len(centers)
        axes = np.full((count, 2), radius)
        none = np.zeros(count)
        return Ellipses(time, centers, np.zeros((count, 2)), axes, none, none)

    def occupied_at(self, points: Array) -> Mask:
        """Whether points (N, 2) in odom [m] lie in occupied cells, (N,)."""
        away = points - self.origin[:2]
        cos, sin = math.cos(self.origin[2]), math.sin(self.origin[2])
        own = np.floor(away @ np.array([[cos, -sin], [sin, cos]]) / self.resolution)
        rows, columns = self.occupied.shape
        x, y = own[:, 0], own[:, 1]
        on_map = (x >= 0) & (x < columns) & (y >= 0) & (y < rows)
        result = np.zeros(len(points), dtype=bool)
        result[on_map] = self.occupied[y[on_map].astype(np.intp), x[on_map].astype(np.intp)]
        return result

    def _within(self) -> Mask:
        """Cells whose eight neighbours are all occupied."""
        wide = np.pad(self.occupied, 1)
        rows = wide[:-2] & wide[1:-1] & wide[2:]
        result: Mask = rows[:, :-2] & rows[:, 1:-1] & rows[:, 2:]
        return result
