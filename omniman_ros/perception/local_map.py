"""Rolling map of what stands around the robot, by the log-odds of its cells.

Source: H. Moravec and A. Elfes, "High Resolution Maps from Wide Angle Sonar" (ICRA 1985), in the
additive form of log-odds with bounds (K. Yguel et al., 2007; A. Hornung et al., OctoMap, 2013). A
cell is looked up in the view, in place of a ray drawn through the cells: no cell is missed where
rays are farther apart than cells.
"""

import math

import numpy as np
from numpy.typing import NDArray

from omniman_ros.collision.rectangles import Rectangles
from omniman_ros.core.arrays import Array
from omniman_ros.core.rigid import PlanarPose
from omniman_ros.perception.parameters import MapParameters
from omniman_ros.perception.rolling_grid import centered_corner, shifted
from omniman_ros.perception.scan import Mask, View

HIT, MISS = 0.9, 0.4
"""What a beam that ends in a cell adds to its log-odds, and one that passes takes away."""
LOWEST, HIGHEST = -2.0, 3.5
"""Bounds of the log-odds: a change of the world is believed after some beams."""
#: Log-odds from which a cell belongs to something that stands: two beams that ended there
STANDS = 1.6
FREE = -0.7  #: Log-odds up to which a cell was seen free: two beams that passed
_AROUND = [(row, column) for row in (-1, 0, 1) for column in (-1, 0, 1)]


class LocalMap:
    """Square grid in odom that follows the robot by whole cells.

    Attributes:
        resolution: Edge of a cell [m].
        corner: (2,) column and row of the first cell in odom, counted from the origin of odom.
        log_odds: (n, n) of the cells, rows along y; 0 where nothing is known.
    """

    def __init__(self, parameters: MapParameters) -> None:
        self.resolution = parameters.resolution
        count = math.ceil(parameters.size / parameters.resolution)
        self.log_odds: NDArray[np.float32] = np.zeros((count, count), dtype=np.float32)
        self.corner = np.zeros(2, dtype=np.intp)
        self.clear()

    def clear(self) -> None:
        """Forget everything."""
        self.log_odds[:] = 0.0
        self.corner[:] = -(len(self.log_odds) // 2)

    @property
    def origin(self) -> Array:
        """Corner (2,) of the first cell in odom [m]."""
        origin: Array = self.resolution * self.corner.astype(np.float64)
        return origin

    def follow(self, center: Array) -> bool:
        """Move the map if the robot, (2,) in odom [m], has left its middle; return whether so."""
        count = len(self.log_odds)
        corner = centered_corner(center, self.resolution, count)
        shift = corner - self.corner
        if np.abs(shift).max() <= count // 16:
            return False
        self.log_odds, self.corner = shifted(self.log_odds, shift, 0.0), corner
        return True

    def update(self, view: View, hits: Array, reach: float) -> None:
        """Enter what was seen: free space up to a reach, and what stands, (M, 2) in odom [m]."""
        rows, columns, passed = view.passed(
            self.origin, self.resolution, len(self.log_odds), reach
        )
        cells, inside = self._cells(hits)
        met = np.unique(cells[inside])
        before = self.log_odds.ravel()[met]
        window = self.log_odds[rows, columns]
        window[passed] -= MISS
        flat = self.log_odds.ravel()
        flat[met] = before + HIT
        np.clip(self.log_odds, LOWEST, HIGHEST, out=self.log_odds)

    def occupy(self, pose: PlanarPose, parts: Rectangles, around: float) -> None:
        """Enter that the robot stands somewhere: nothing else does, though no beam passes there.

        It covers parts in base_link. Cells within the distance `around` [m] of it of which nothing
        is known are free, since what is seen there belongs to the robot.

        Args:
            pose: Pose of the robot in odom [m, m, rad].
        """
        reach = float(parts.radius.max()) + around
        center = np.array(pose[:2])
        rows, columns, _ = self._disc(center, reach)
        x, y = (
            self.resolution * (np.arange(part.start, part.stop) + 0.5 + corner) - middle
            for part, corner, middle in zip((columns, rows), self.corner, center, strict=True)
        )
        c, s = math.cos(pose[2]), math.sin(pose[2])
        local = np.stack((c * x + s * y[:, None], c * y[:, None] - s * x), axis=-1)
        distances = parts.distances(local)
        window = self.log_odds[rows, columns]
        window[(distances <= 0.0) | ((distances <= around) & (window == 0.0))] -= MISS
        np.clip(window, LOWEST, HIGHEST, out=window)

    def stands(self, points: Array) -> Mask:
        """Return whether points (M, 2) in odom lie in or beside cells that stand, (M,)."""
        flat, count = self.log_odds.ravel(), len(self.log_odds)
        cells, inside = self._cells(points, edge=1)
        cells[~inside] = count + 1
        found: Mask = np.zeros(len(points), dtype=bool)
        for row, column in _AROUND:
            found |= flat[cells + row * count + column] >= STANDS
        return found & inside

    def was_free(self, points: Array) -> Mask:
        """Return whether points (M, 2) in odom lie in cells that were seen free, (M,)."""
        cells, inside = self._cells(points)
        cells[~inside] = 0
        result: Mask = (self.log_odds.ravel()[cells] <= FREE) & inside
        return result

    def standing(self) -> Array:
        """Return the middles (M, 2) of the cells that stand, in odom [m]."""
        rows, columns = np.nonzero(self.log_odds >= STANDS)
        index = (np.column_stack((columns, rows)) + self.corner).astype(np.float64)
        middles: Array = self.resolution * (index + 0.5)
        return middles

    def forget(self, center: Array, radius: float) -> None:
        """Forget the occupied cells of a disc in odom that do not belong to what stands [m]."""
        rows, columns, inside = self._disc(center, radius)
        window = self.log_odds[rows, columns]
        window[inside & (window > 0.0) & (window < HIGHEST)] = 0.0

    def occupancy(self, centers: Array, radii: Array) -> NDArray[np.int8]:
        """Return the occupancy (n, n) of the cells [%], -1 where nothing is known.

        Discs in odom, (K, 2) and (K,) [m], move and do not belong to the map.
        """
        odds = self.log_odds
        percent = np.rint(100.0 / (1.0 + np.exp(-odds))).astype(np.int8)
        percent[odds == 0.0] = -1
        for center, radius in zip(centers, radii.tolist(), strict=True):
            rows, columns, inside = self._disc(center, radius + self.resolution)
            window = percent[rows, columns]
            window[inside & (self.log_odds[rows, columns] < HIGHEST)] = 0
        return percent

    def _cells(self, points: Array, edge: int = 0) -> tuple[NDArray[np.intp], Mask]:
        """Return the flat numbers of the cells of points (M, 2), and whether they are inside.

        The outer `edge` cells at the border do not count as inside.
        """
        count = len(self.log_odds)
        index = np.floor(points / self.resolution).astype(np.intp) - self.corner
        inside: Mask = np.all((index >= edge) & (index < count - edge), axis=1)
        return index[:, 1] * count + index[:, 0], inside

    def _disc(self, center: Array, radius: float) -> tuple[slice, slice, Mask]:
        """Return the rows and columns around a disc [m], and which of these cells are in it."""
        count = len(self.log_odds)
        low = np.floor((center - radius) / self.resolution).astype(np.intp) - self.corner
        high = np.ceil((center + radius) / self.resolution).astype(np.intp) - self.corner
        low, high = np.clip(low, 0, count), np.clip(high, 0, count)
        x, y = (
            self.resolution * (np.arange(low[k], high[k]) + 0.5 + self.corner[k]) - center[k]
            for k in (0, 1)
        )
        rows, columns = slice(int(low[1]), int(high[1])), slice(int(low[0]), int(high[0]))
        distances: Array = np.hypot(x[None, :], y[:, None])
        inside: Mask = np.asarray(distances <= radius)
        return rows, columns, inside
