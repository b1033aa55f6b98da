"""An upright prism with a convex outline."""

import numpy as np

from omniman_ros.collision.arm_segments import Segments
from omniman_ros.collision.convex_search import box_gaps, distances_along
from omniman_ros.core.arrays import Array


class ConvexPrism:
    """An upright prism with a convex outline (K, 2), counter-clockwise [m].

    Its 3 K edges are (3, 3 K) each.
    """

    def __init__(self, corners: Array, heights: tuple[float, float]) -> None:
        self._heights = heights
        lower, upper = corners.min(axis=0), corners.max(axis=0)
        self._box = [(*lower.tolist(), heights[0]), (*upper.tolist(), heights[1])]
        following = np.roll(corners, -1, axis=0)
        # Columns (K, 1), one row for each side.
        self._corner_x, self._corner_y = corners.T[..., None]
        self._side_x, self._side_y = (following - corners).T[..., None]
        squares = self._side_x**2 + self._side_y**2
        self._share_x, self._share_y = self._side_x / squares, self._side_y / squares
        low, high = (np.insert(corners, 2, z, axis=1) for z in heights)
        next_low, next_high = (np.roll(points, -1, axis=0) for points in (low, high))
        self.edges = Segments(
            np.concatenate((low, high, low)).T, np.concatenate((next_low, next_high, high)).T
        )

    def distances(self, start: Array, end: Array, reach: Array | float) -> Array:
        """Return the distances (...) from segments (3, ...); zero where they meet [m].

        Above `reach`, one or (...) [m], a lower bound is enough.
        """
        x, y, z = box_gaps(start, end, *self._box)
        bound = np.sqrt(x * x + y * y + z * z)
        return distances_along(lambda _: self._outward, bound, start, end - start, reach)

    def _outward(self, points: Array) -> Array:
        """Return the vectors (3, n) to points (3, n) from the nearest points of the prism."""
        x, y, z = points
        # Vectors (K, n) from the nearest points of all sides.
        dx, dy = x - self._corner_x, y - self._corner_y
        is_inside = (self._side_x * dy >= self._side_y * dx).all(axis=0)
        fraction = dx * self._share_x
        fraction += dy * self._share_y
        np.minimum(np.maximum(fraction, 0.0, out=fraction), 1.0, out=fraction)
        dx -= fraction * self._side_x
        dy -= fraction * self._side_y
        squared = np.multiply(dx, dx, out=fraction)
        squared += dy * dy
        nearest = squared.argmin(axis=0), np.arange(len(x))
        low, high = self._heights
        result = np.stack((dx[nearest], dy[nearest], z - np.minimum(np.maximum(z, low), high)))
        result[:2, is_inside] = 0.0
        return result
