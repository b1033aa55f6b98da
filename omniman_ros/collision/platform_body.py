"""The platform as a body: a box, or an upright prism with any outline."""

import numpy as np

from omniman_ros.collision.convex_pieces import convex_pieces
from omniman_ros.collision.load_box import LoadBox
from omniman_ros.collision.prism import ConvexPrism
from omniman_ros.collision.solids import UprightSolids
from omniman_ros.core.arrays import Array
from omniman_ros.core.robot import Body


class PlatformBox:
    """A platform that is its bounding box.

    Args:
        length: Length [m].
        width: Width [m].
        heights: Heights of its lower and its upper side [m].

    Attributes:
        radius: Distance of its farthest point from the z axis of base_link [m].
    """

    def __init__(self, length: float, width: float, heights: tuple[float, float]) -> None:
        self._half: Array = np.array((0.5 * length, 0.5 * width))
        self._heights = heights
        self._box = UprightSolids.box((0.0, 0.0, 0.0), length, width, heights)
        self.radius = float(np.hypot(*self._half))

    def distances_from_segments(self, start: Array, end: Array, reach: float) -> Array:
        """Return the distances (...) from segments (3, ...) in base_link; zero where they meet.

        Args:
            start: Starts of the segments [m].
            end: Their ends [m].
            reach: Distance above which a lower bound is enough [m].
        """
        return self._box.distances(start[..., None], end[..., None], reach)[..., 0]

    def distances_from_load(self, load: LoadBox, flange: Array, reach: float) -> Array:
        """Return the distances (...) from a load [m].

        Args:
            flange: Poses (..., 4, 4) of the flange in base_link.
            reach: Distance above which a lower bound is enough [m].
        """
        return load.distances_from_solids(flange, self._box, reach)[..., 0]

    def distances_from_solids(self, poses: Array, solids: UprightSolids) -> Array:
        """Return the distances (..., M) from M solids; zero where they meet [m].

        Args:
            poses: Poses (..., 3) of base_link in the frame of the solids [m, m, rad].
        """
        return solids.box_distances(poses, self._half, self._heights)


class PlatformPrism:
    """A platform whose outline is a simple polygon, convex or not.

    Seen from above, polygon and rectangle are apart by the least distance of a side of the polygon
    from the rectangle, unless the rectangle lies within the polygon. In space, the polygon is the
    union of convex pieces: their least distance counts. The methods are those of `PlatformBox`.

    Args:
        corners: Corners (K, 2) of the outline in base_link, counter-clockwise [m].
        heights: Heights of its lower and its upper side [m].

    Attributes:
        radius: Distance of its farthest point from the z axis of base_link [m].
    """

    def __init__(self, corners: Array, heights: tuple[float, float]) -> None:
        self._heights = heights
        self._pieces = [ConvexPrism(piece, heights) for piece in convex_pieces(corners)]
        following = np.roll(corners, -1, axis=0)
        self._sides = list(zip(corners.tolist(), following.tolist(), strict=True))
        self.radius = float(np.hypot(*corners.T).max())

    def distances_from_segments(self, start: Array, end: Array, reach: float) -> Array:
        """Return the distances (...) from segments (3, ...) in base_link; zero where they meet."""
        result: Array = np.full(start.shape[1:], np.inf)
        for piece in self._pieces:
            # Only a piece that may be nearer than those before matters.
            found = piece.distances(start, end, np.minimum(result, reach))
            np.minimum(result, found, out=result)
        return result

    def distances_from_load(self, load: LoadBox, flange: Array, reach: float) -> Array:
        """Return the distances (...) from a load, with the flange at poses (..., 4, 4) [m]."""
        each = [load.distances_from_prism(flange, piece, reach) for piece in self._pieces]
        result: Array = np.min(each, axis=0)
        return result

    def distances_from_solids(self, poses: Array, solids: UprightSolids) -> Array:
        """Return the distances (..., M) from M solids; zero where they meet [m]."""
        apart = self._distances_from_rectangles(poses, solids)
        horizontal = np.maximum(apart - solids.rounding, 0.0)
        bottom, top = self._heights
        vertical = np.maximum(np.maximum(solids.lower - top, bottom - solids.upper), 0.0)
        result: Array = np.hypot(horizontal, vertical)
        return result

    def _distances_from_rectangles(self, poses: Array, solids: UprightSolids) -> Array:
        """Return the horizontal distances (..., M) from solids without their rounding [m]."""
        c, s = np.cos(poses[..., 2, None]), np.sin(poses[..., 2, None])
        dx, dy = (solids.centre[i] - poses[..., i, None] for i in (0, 1))
        # Centres and directions of the rectangles in base_link.
        x, y = c * dx + s * dy, c * dy - s * dx
        yaw = solids.yaw - poses[..., 2, None]
        c, s = np.cos(yaw), np.sin(yaw)
        length, width = solids.half
        corners = [
            (x + i * length * c - j * width * s, y + i * length * s + j * width * c)
            for i in (-1.0, 1.0)
            for j in (-1.0, 1.0)
        ]
        squared = np.full(x.shape, np.inf)
        meet, within = np.zeros(x.shape, dtype=bool), np.zeros(x.shape, dtype=bool)
        for (ax, ay), (bx, by) in self._sides:
            # The side's first corner and its direction in the frames of the rectangles.
            u, v = c * (ax - x) + s * (ay - y), c * (ay - y) - s * (ax - x)
            eu, ev = c * (bx - ax) + s * (by - ay), c * (by - ay) - s * (bx - ax)
            beyond_u = np.maximum(np.abs(u) - length, 0.0)
            beyond_v = np.maximum(np.abs(v) - width, 0.0)
            np.minimum(squared, beyond_u * beyond_u + beyond_v * beyond_v, out=squared)
            # No axis of the rectangle and not the side's normal separate the two.
            mu, mv = u + 0.5 * eu, v + 0.5 * ev
            meet |= (
                (np.abs(mu) <= length + 0.5 * np.abs(eu))
                & (np.abs(mv) <= width + 0.5 * np.abs(ev))
                & (np.abs(mu * ev - mv * eu) <= length * np.abs(ev) + width * np.abs(eu))
            )
            ex, ey = bx - ax, by - ay
            for px, py in corners:
                share = np.clip(((px - ax) * ex + (py - ay) * ey) / (ex * ex + ey * ey), 0.0, 1.0)
                gx, gy = px - ax - share * ex, py - ay - share * ey
                np.minimum(squared, gx * gx + gy * gy, out=squared)
            if ay != by:
                crosses = (ay > y) != (by > y)
                within ^= crosses & (x < ax + (y - ay) * (ex / ey))
        return np.where(meet | within, 0.0, np.sqrt(squared))


def platform_body(body: Body, heights: tuple[float, float]) -> PlatformBox | PlatformPrism:
    """Return the platform between two heights [m]."""
    if body.outline is None:
        return PlatformBox(body.length, body.width, heights)
    return PlatformPrism(body.outline, heights)
