"""Occupancy grid, and discs that cover the boundary of its occupied cells."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core import plausible, se2
from omniman_ros.core.arrays import Array, Shape
from omniman_ros.core.errors import InputError
from omniman_ros.core.parameters import Range
from omniman_ros.core.rigid import PlanarPose
from omniman_ros.core.validated import Validated
from omniman_ros.surroundings.ellipses import Ellipses
from omniman_ros.surroundings.occupancy import MAX_CELLS, OccupancyMap

Mask = NDArray[np.bool_]  #: Array of flags, in the shape of the cells or of the points

MIN_RESOLUTION = 0.005  #: Smallest edge of a cell [m]
MAX_RESOLUTION = 1.0  #: Largest edge of a cell [m]
UNKNOWN = -1  #: Value of a cell of unknown occupancy
CERTAIN = 100  #: Value of a cell that is occupied for certain [%]


@dataclass(frozen=True)
class GridMap(Validated):
    """Occupancy grid as in `nav_msgs/OccupancyGrid`; the area outside of it is free.

    Raises:
        InputError: The grid does not have two axes, or no or too many cells; the resolution is
            out of range; the origin is not finite or implausibly large.
    """

    #: (rows, columns) occupied cells; rows along y, columns along x of the map
    occupied: Annotated[Mask, Shape("rows", "columns")]
    #: Edge of a cell [m]
    resolution: Annotated[float, Range(low=MIN_RESOLUTION, high=MAX_RESOLUTION, unit="m")]
    #: (3,) x, y, yaw in odom of the lower left corner of cell (0, 0) [m, m, rad]
    origin: Annotated[Array, Shape(3)]

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 < self.occupied.size <= MAX_CELLS:
            raise InputError(
                f"map: the cells have shape {self.occupied.shape}, expected rows and columns of "
                f"1 to {MAX_CELLS} cells"
            )
        plausible.demand(self.origin[:2], plausible.LENGTH, "map: origin")
        plausible.demand(self.origin[2:], plausible.ANGLE, "map: yaw of the origin")

    @staticmethod
    def of_occupancy(
        occupancy: OccupancyMap, threshold: int = 50, unknown_is_free: bool = True
    ) -> "GridMap":
        """Create a map from occupancies of 0 to 100 % (-1: unknown), occupied from a threshold on.

        Raises:
            InputError: A value or the threshold is out of range; see also the class.
        """
        values = occupancy.values
        if not 1 <= threshold <= CERTAIN:
            raise InputError(f"map: the threshold is {threshold} percent, expected 1 to {CERTAIN}")
        low, high = int(values.min()), int(values.max())
        if low < UNKNOWN or high > CERTAIN:
            value = low if low < UNKNOWN else high
            raise InputError(f"map: a cell has the value {value}, expected {UNKNOWN} to {CERTAIN}")
        occupied = values >= threshold
        if not unknown_is_free:
            occupied = occupied | (values == UNKNOWN)
        return GridMap(occupied, occupancy.resolution, occupancy.origin)

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
        """Return centres (M, 2) in odom, row by row, and radius [m] of discs on the boundary.

        An occupied cell at the boundary has a free one among its eight neighbours; the area
        outside of the map is free. The robot cannot reach the cells behind the boundary without
        touching it.
        """
        return self._discs, self.radius

    def displaced(self, frame: PlanarPose) -> "GridMap":
        """Return a map that is given in a frame, by the pose of that frame in odom [m, m, rad].

        The cells are shared; what takes long to compute is not computed again.
        """
        moved = GridMap(self.occupied, self.resolution, se2.displaced(self.origin, frame))
        moved.__dict__["_boundary"] = self._boundary
        return moved

    @cached_property
    def _boundary(self) -> Array:
        """Centres (M, 2) of the cells at the boundary in the map's own axes, which takes long."""
        rows, columns = np.nonzero(self.occupied & ~self._within())
        middles: Array = (np.column_stack([columns, rows]) + 0.5).astype(np.float64)
        middles *= self.resolution
        return middles

    @cached_property
    def _discs(self) -> Array:
        """Centres (M, 2) of the discs in odom [m]."""
        in_map = self._boundary
        cos, sin = math.cos(self.origin[2]), math.sin(self.origin[2])
        centers: Array = self.origin[:2] + in_map @ np.array([[cos, sin], [-sin, cos]])
        centers.setflags(write=False)
        return centers

    def ellipses(self, time: float = 0.0) -> Ellipses:
        """Return the discs of `obstacles` as standing obstacles at a time [s]."""
        centers, radius = self.obstacles()
        count = len(centers)
        axes = np.full((count, 2), radius)
        none = np.zeros(count)
        return Ellipses(time, centers, np.zeros((count, 2)), axes, none, none)

    def occupied_at(self, points: Array) -> Mask:
        """Return whether points (N, 2) in odom [m] lie in occupied cells, (N,)."""
        offset = points - self.origin[:2]
        cos, sin = math.cos(self.origin[2]), math.sin(self.origin[2])
        cells = np.floor(offset @ np.array([[cos, -sin], [sin, cos]]) / self.resolution)
        rows, columns = self.occupied.shape
        x, y = cells[:, 0], cells[:, 1]
        on_map = (x >= 0) & (x < columns) & (y >= 0) & (y < rows)
        result = np.zeros(len(points), dtype=bool)
        result[on_map] = self.occupied[y[on_map].astype(np.intp), x[on_map].astype(np.intp)]
        return result

    def _within(self) -> Mask:
        """Return the cells whose eight neighbours are all occupied."""
        padded = np.pad(self.occupied, 1)
        rows = padded[:-2] & padded[1:-1] & padded[2:]
        result: Mask = rows[:, :-2] & rows[:, 1:-1] & rows[:, 2:]
        return result
