"""Simple polygons, given by their corners in order."""

from collections.abc import Sequence

import numpy as np

from omniman_ros.core.arrays import Array

LEAST_WIDTH = 1e-5  #: Width of a slab up to which it is left out [m]


def signed_area(corners: Array) -> float:
    """Return the area of a polygon (K, 2) [m^2], above zero if it is counter-clockwise.

    Args:
        corners: Corners (K, 2) [m].
    """
    x, y = corners[:, 0], corners[:, 1]
    return 0.5 * float(x @ np.roll(y, -1) - y @ np.roll(x, -1))


def is_simple(corners: Array) -> bool:
    """Return whether sides of a polygon (K, 2) meet only where neighbours have their corner.

    Args:
        corners: Corners (K, 2), three or more [m].
    """
    count = len(corners)
    start, along = corners, np.roll(corners, -1, axis=0) - corners
    ahead = np.roll(along, -1, axis=0)
    turn = along[:, 0] * ahead[:, 1] - along[:, 1] * ahead[:, 0]
    if not along.any(axis=1).all() or ((turn == 0.0) & ((along * ahead).sum(axis=1) < 0.0)).any():
        return False
    first, second = np.triu_indices(count, 2)
    apart = (second - first) % count != count - 1
    first, second = first[apart], second[apart]
    end = start + along
    a, b = _sides(start[first], end[first], start[second], end[second])
    c, d = _sides(start[second], end[second], start[first], end[first])
    meet = (a * b <= 0.0) & (c * d <= 0.0)
    # Sides on one line meet where their extents do.
    low = np.maximum(np.minimum(start[first], end[first]), np.minimum(start[second], end[second]))
    high = np.minimum(np.maximum(start[first], end[first]), np.maximum(start[second], end[second]))
    return not bool((meet & (low <= high).all(axis=1)).any())


def trapezoids(corners: Array, cuts: Sequence[float] = ()) -> list[Array]:
    """Return trapezoids (4, 2) whose union is a simple polygon (K, 2), convex or not [m].

    Lines along y through all corners divide the polygon into slabs, in each of which its sides
    bound trapezoids in pairs.

    Args:
        cuts: Places along x of further lines [m].
    """
    found = []
    levels = np.unique((*corners[:, 0], *cuts))
    ends = np.stack((corners, np.roll(corners, -1, axis=0)), axis=1)
    ends = np.take_along_axis(ends, ends[:, :, :1].argsort(axis=1), axis=1)
    for left, right in zip(levels[:-1].tolist(), levels[1:].tolist(), strict=True):
        if right - left < LEAST_WIDTH:
            continue
        sides = ends[(ends[:, 0, 0] <= left) & (ends[:, 1, 0] >= right)]
        run = sides[:, 1] - sides[:, 0]
        slope = run[:, 1] / run[:, 0]
        heights = sides[:, 0, 1:] + slope[:, None] * (np.array((left, right)) - sides[:, 0, :1])
        heights = heights[heights.sum(axis=1).argsort()]
        for (low, low_right), (high, high_right) in zip(heights[::2], heights[1::2], strict=True):
            found.append(
                np.array([(left, low), (right, low_right), (right, high_right), (left, high)])
            )
    return found


def _sides(start: Array, end: Array, first: Array, second: Array) -> tuple[Array, Array]:
    """Return on which sides of lines (N, 2) two points (N, 2) are: above zero on the left."""
    x, y = (end - start).T
    u, v = (first - start).T
    s, t = (second - start).T
    return x * v - y * u, x * t - y * s
