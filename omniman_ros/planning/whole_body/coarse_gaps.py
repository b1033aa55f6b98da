"""Gaps of the whole body for the search, which looks at thousands of poses at once."""

import numpy as np
from numpy.typing import NDArray

from omniman_ros.collision.convex_search import Indices
from omniman_ros.collision.signed_gaps import point_gap_values, rectangle_gaps
from omniman_ros.collision.upright_obstacles import UprightObstacles
from omniman_ros.core.arrays import Array
from omniman_ros.planning.whole_body.body_gaps import BodyGaps

#: Largest distance by which a disc may reach beyond what it stands for [m]: the cells of a map are
#: discs, up to a size of 7 cm
ROUNDED = 0.015
BATCH = 2_000_000  #: Number of pairs of spheres and obstacles that are looked at together


class CoarseGaps:
    """Gaps of a body to many obstacles; posts, persons and cells of a map count as discs.

    Distances to discs cost a tenth of those to boxes. They contain what they stand for.
    """

    def __init__(self, gaps: BodyGaps) -> None:
        self._gaps = gaps

    def platform(self, poses: Array, obstacles: UprightObstacles) -> Array:
        """Return the gaps (k, M) of the platform at poses (k, 3) to obstacles [m]."""
        is_disc = _are_discs(obstacles, *self._gaps.heights)
        others = obstacles.select(np.flatnonzero(~is_disc))
        centre, radius = obstacles.centre[:, is_disc], _radii(obstacles)[is_disc]
        result = np.full((len(poses), len(obstacles)), np.inf)
        for each in self._gaps.rectangles:
            at = each.poses(poses)
            if len(others):
                gaps = rectangle_gaps(others, at, each.half, self._gaps.heights)
                result[:, ~is_disc] = np.minimum(result[:, ~is_disc], gaps)
            c, s = np.cos(at[:, 2, None]), np.sin(at[:, 2, None])
            x, y = (centre[k] - at[:, k, None] for k in (0, 1))
            beyond_x = np.abs(c * x + s * y) - each.half[0]
            beyond_y = np.abs(c * y - s * x) - each.half[1]
            distance = np.hypot(np.maximum(beyond_x, 0.0), np.maximum(beyond_y, 0.0))
            distance += np.minimum(np.maximum(beyond_x, beyond_y), 0.0) - radius
            result[:, is_disc] = np.minimum(result[:, is_disc], distance)
        return result

    def spheres_least(
        self, centre: Array, obstacles: UprightObstacles
    ) -> tuple[Array, Indices, Indices]:
        """Return the least gaps (k,) of spheres (3, k, S) to obstacles, and both numbers."""
        is_disc = _are_discs(obstacles, float(centre[2].min()), float(centre[2].max()))
        order = np.concatenate([np.flatnonzero(is_disc), np.flatnonzero(~is_disc)])
        discs = obstacles.select(np.flatnonzero(is_disc))
        others = obstacles.select(np.flatnonzero(~is_disc))
        found = []
        rows = max(1, BATCH // (centre.shape[2] * len(obstacles)))
        for first in range(0, centre.shape[1], rows):
            part = centre[:, first : first + rows]
            parts = [_to_discs(discs, part), point_gap_values(others, part)]
            gap = np.concatenate(parts, axis=-1) - self._gaps.spheres.radius[:, None]
            flat = gap.reshape(len(gap), -1)
            least = flat.argmin(axis=1)
            found.append((flat[np.arange(len(flat)), least], *np.divmod(least, len(obstacles))))
        gaps, sphere, obstacle = (np.concatenate(each) for each in zip(*found, strict=True))
        return gaps, sphere, order[obstacle]


def _are_discs(obstacles: UprightObstacles, low: float, high: float) -> NDArray[np.bool_]:
    """Return which obstacles are as discs for all that is between two heights [m]."""
    beyond = np.hypot(*obstacles.half) - obstacles.half.min(axis=0)
    result: NDArray[np.bool_] = beyond <= ROUNDED
    result &= (obstacles.lower <= low) & (obstacles.upper >= high)
    return result


def _radii(obstacles: UprightObstacles) -> Array:
    """Return the radii (M,) of discs that contain obstacles [m]."""
    result: Array = np.hypot(*obstacles.half) + obstacles.rounding
    return result


def _to_discs(obstacles: UprightObstacles, points: Array) -> Array:
    """Return distances (..., M) of points (3, ...) from discs, by |p|^2 - 2 p c + |c|^2 [m]."""
    level = np.moveaxis(points[:2], 0, -1)
    square = (level * level).sum(axis=-1)[..., None] - 2.0 * (level @ obstacles.centre)
    square += (obstacles.centre * obstacles.centre).sum(axis=0)
    np.sqrt(np.maximum(square, 0.0, out=square), out=square)
    square -= _radii(obstacles)
    result: Array = square
    return result
