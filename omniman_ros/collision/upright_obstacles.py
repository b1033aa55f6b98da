"""Upright obstacles: what stands on the floor, hangs above it, or is the platform itself.

The first axis of an array of points holds their three coordinates.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from omniman_ros.collision.convex_search import Indices, Outward, box_gaps, distances_along
from omniman_ros.collision.segments import dot
from omniman_ros.core.arrays import Array, Shape
from omniman_ros.core.validated import Validated

Mask = NDArray[np.bool_]  #: Array of flags


@dataclass(frozen=True)
class UprightObstacles(Validated):
    """Boxes with vertical edges that may be rounded: boxes, cylinders, and walls with round ends.

    A solid is the set of all points that are within `rounding` of a rectangle horizontally, and
    between its lower and its upper side.

    Attributes:
        lower, upper: Heights (M,) of their lower and upper sides [m].
    """

    centre: Annotated[Array, Shape(2, ..., "M")]  #: Centres (2, M) of the rectangles [m]
    yaw: Annotated[Array, Shape("M")]  #: Directions (M,) of their lengths [rad]
    #: Half lengths and half widths (2, M) [m]; zero for cylinders
    half: Annotated[Array, Shape(2, "M")]
    #: Horizontal distances (M,) by which the rectangles are extended [m]
    rounding: Annotated[Array, Shape("M")]
    lower: Annotated[Array, Shape("M", finite=False)]
    upper: Annotated[Array, Shape("M", finite=False)]

    @staticmethod
    def box(
        pose: Sequence[float], length: float, width: float, heights: tuple[float, float]
    ) -> "UprightObstacles":
        """Return one box by the pose (x, y, yaw) of its centre and its lengths [m, rad].

        Args:
            pose: Pose (x, y, yaw) of its centre [m, m, rad].
            length: Length [m].
            width: Width [m].
            heights: Heights of its lower and its upper side [m].
        """
        x, y, yaw = pose
        return UprightObstacles(
            np.array([[x], [y]]),
            np.array([yaw]),
            np.array([[0.5 * length], [0.5 * width]]),
            np.zeros(1),
            np.array([heights[0]]),
            np.array([heights[1]]),
        )

    @staticmethod
    def cylinder(
        x: float, y: float, radius: float, heights: tuple[float, float]
    ) -> "UprightObstacles":
        """Return one cylinder at a position [m] with a radius [m] between two heights [m]."""
        return UprightObstacles(
            np.array([[x], [y]]),
            np.zeros(1),
            np.zeros((2, 1)),
            np.array([radius]),
            np.array([heights[0]]),
            np.array([heights[1]]),
        )

    @staticmethod
    def join(parts: Sequence["UprightObstacles"]) -> "UprightObstacles":
        """Return all obstacles of several sets, in their order."""
        if not parts:
            flat = np.zeros((2, 0))
            return UprightObstacles(flat, flat[0], flat, flat[0], flat[0], flat[0])
        return UprightObstacles.unchecked(
            **{
                name: np.concatenate([getattr(part, name) for part in parts], axis=-1)
                for name in ("centre", "yaw", "half", "rounding", "lower", "upper")
            }
        )

    def __len__(self) -> int:
        return len(self.yaw)

    def select(self, index: Indices) -> "UprightObstacles":
        """Return the obstacles with some indices, which may repeat."""
        return UprightObstacles.unchecked(
            centre=self.centre[..., index],
            yaw=self.yaw[index],
            half=self.half[:, index],
            rounding=self.rounding[index],
            lower=self.lower[index],
            upper=self.upper[index],
        )

    def placed(self, centre: Array) -> "UprightObstacles":
        """Return the obstacles at other centres (2, ..., M), one for each of several times."""
        return UprightObstacles.unchecked(**{**vars(self), "centre": centre})

    def _local(self, points: Array) -> Array:
        """Return points (3, ..., M) in the frames of the obstacles; heights stay."""
        x, y = points[0] - self.centre[0], points[1] - self.centre[1]
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        return np.stack((c * x + s * y, c * y - s * x, np.broadcast_to(points[2], x.shape)))

    def point_distances(self, points: Array) -> Array:
        """Return the distances (..., M) of points (3, ..., M), one for each solid [m]."""
        outward = self._outward(self._local(points))
        result: Array = np.sqrt(dot(outward, outward))
        return result

    def nearest_points(self, points: Array) -> Array:
        """Return the points (3, ..., M) of the obstacles nearest to points (3, ..., M) [m]."""
        x, y, z = self._outward(self._local(points))
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        result: Array = points - np.stack((c * x - s * y, s * x + c * y, z))
        return result

    def _outward(self, points: Array) -> Array:
        """Return vectors (3, ..., M) to points (3, ..., M) from the nearest of the obstacles."""
        result = np.empty(points.shape)
        for i in (0, 1):
            half = self.half[i]
            result[i] = points[i] - np.minimum(np.maximum(points[i], -half), half)
        result[2] = points[2] - np.minimum(np.maximum(points[2], self.lower), self.upper)
        if self.rounding.any():
            distance = np.hypot(result[0], result[1])
            beyond = np.maximum(distance - self.rounding, 0.0)
            result[:2] *= beyond / np.maximum(distance, np.finfo(np.float64).tiny)
        return result

    def distances(self, start: Array, end: Array, reach: float) -> Array:
        """Return the distances (..., M) between segments and obstacles; zero where they meet [m].

        Starts and ends are (3, ..., M), one for each solid; a last axis of length 1 stands for all
        obstacles. Distances above `reach` may be too small, but are not below it.
        """
        first, last = self._local(start), self._local(end)
        lower, upper = (
            (*(sign * self.half), z) for sign, z in ((-1, self.lower), (1, self.upper))
        )
        x, y, z = box_gaps(first, last, lower, upper)
        bound = np.hypot(np.maximum(np.hypot(x, y) - self.rounding, 0.0), z)
        is_one = len(self) == 1  # which is broadcast

        def outward(where: tuple[Indices, ...]) -> Outward:
            return self._outward if is_one else self.select(where[-1])._outward

        return distances_along(outward, bound, first, last - first, reach)

    def box_distances(self, poses: Array, half: Array, heights: tuple[float, float]) -> Array:
        """Return the distances (..., M) of an upright box from obstacles; zero on contact [m].

        The centre of its rectangle has poses (..., 3); half length and half width are (2,) [m].

        Args:
            poses: Poses (..., 3) of the centre of its rectangle [m, m, rad].
        """
        yaw = self.yaw - poses[..., 2, None]
        x, y = (self.centre[i] - poses[..., i, None] for i in (0, 1))
        c, s = np.cos(poses[..., 2, None]), np.sin(poses[..., 2, None])
        # Each rectangle in the frame of the other.
        own = corner_distances(c * x + s * y, c * y - s * x, yaw, self.half, half[:, None])
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        other = corner_distances(-c * x - s * y, s * x - c * y, -yaw, half[:, None], self.half)
        is_apart = own[1] | other[1]
        apart = np.where(is_apart, np.minimum(own[0], other[0]), 0.0)
        horizontal = np.maximum(apart - self.rounding, 0.0)
        vertical = np.maximum(np.maximum(self.lower - heights[1], heights[0] - self.upper), 0.0)
        result: Array = np.hypot(horizontal, vertical)
        return result


def corner_distances(
    x: Array, y: Array, yaw: Array, half: Array, fixed: Array
) -> tuple[Array, Mask]:
    """Return the least distance of a rectangle's corners from a fixed one, and a separation.

    The centre (x, y) of the rectangle and its direction are in the frame of the fixed one; both
    have half lengths and half widths (2, ...) [m]. The second result is whether a side of the
    fixed rectangle separates the two.

    Args:
        yaw: Its direction there [rad].
    """
    c, s = np.cos(yaw), np.sin(yaw)
    beyond, is_apart = [], np.zeros(np.broadcast(x, yaw).shape, dtype=bool)
    for place, along, across, limit in (
        (x, half[0] * c, -half[1] * s, fixed[0]),
        (y, half[0] * s, half[1] * c, fixed[1]),
    ):
        total, difference = along + across, along - across
        corners = np.abs(place + np.stack((total, difference, -difference, -total))) - limit
        beyond.append(np.maximum(corners, 0.0))
        is_apart |= np.abs(place) > limit + np.abs(along) + np.abs(across)
    return np.hypot(*beyond).min(axis=0), is_apart
