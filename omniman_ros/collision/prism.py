"""An upright prism with a convex outline."""

import numpy as np

from omniman_ros.collision.arm_segments import Segments
from omniman_ros.collision.convex_search import box_gaps, distances_along
from omniman_ros.core.arrays import Array


class ConvexPrism:
    """An upright prism with a convex outline, and its distances from line segments.

    Args:
        corners: Corners (K, 2) of the outline, counter-clockwise [m].
        heights: Heights of the lower and the upper side [m].

    Attributes:
        edges: The 3 K edges, (3, 3 K) each.
    """

    def __init__(self, corners: Array, heights: tuple[float, float]) -> None:
        self._heights = heights
        lower, upper = corners.min(axis=0), corners.max(axis=0)
        self._box = [(*lower.tolist(), heights[0]), (*upper.tolist(), heights[1])]
        following = np.roll(corners, -1, axis=0)
        self._sides = [
            (x, y, to_x - x, to_y - y)
            for (x, y), (to_x, to_y) in zip(corners.tolist(), following.tolist(), strict=True)
        ]
        low, high = (np.insert(corners, 2, z, axis=1) for z in heights)
        next_low, next_high = (np.roll(points, -1, axis=0) for points in (low, high))
        self.edges = Segments(
            np.concatenate((low, high, low)).T, np.concatenate((next_low, next_high, high)).T
        )

    def distances(self, start: Array, end: Array, reach: Array | float) -> Array:
        """Return the distances (...) from segments (3, ...); zero where they meet [m].

        Args:
            start: Starts of the segments [m].
            end: Their ends [m].
            reach: Distance above which a lower bound is enough, one or (...) [m].
        """
        x, y, z = box_gaps(start, end, *self._box)
        bound = np.sqrt(x * x + y * y + z * z)
        return distances_along(lambda _: self._outward, bound, start, end - start, reach)

    def _outward(self, points: Array) -> Array:
        """Return the vectors (3, ...) to points (3, ...) from the nearest points of the prism."""
        x, y, z = points
        shape = np.shape(x)
        is_inside = np.ones(shape, dtype=bool)
        least, best_x, best_y = np.full(shape, np.inf), np.zeros(shape), np.zeros(shape)
        for corner_x, corner_y, side_x, side_y in self._sides:
            dx, dy = x - corner_x, y - corner_y
            is_inside &= side_x * dy >= side_y * dx
            square = side_x * side_x + side_y * side_y
            share = dx * (side_x / square) + dy * (side_y / square)
            np.minimum(np.maximum(share, 0.0, out=share), 1.0, out=share)
            dx -= share * side_x
            dy -= share * side_y
            squared = dx * dx + dy * dy
            is_nearer = squared < least
            for best, each in ((least, squared), (best_x, dx), (best_y, dy)):
                np.copyto(best, each, where=is_nearer)
        low, high = self._heights
        result = np.stack((best_x, best_y, z - np.minimum(np.maximum(z, low), high)))
        result[:2, is_inside] = 0.0
        return result
