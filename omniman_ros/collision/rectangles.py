"""Rectangles in base_link, by which the robot is bounded from above."""

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from omniman_ros.collision.convex_search import Indices
from omniman_ros.collision.upright_obstacles import Mask
from omniman_ros.core.arrays import Array, Shape
from omniman_ros.core.platform import Body
from omniman_ros.core.validated import Validated
from omniman_ros.description.platform_shape import platform_cover

#: Largest number of rectangles that stand for a platform with an outline of its own
MOST_RECTANGLES = 4


@dataclass(frozen=True)
class Rectangles(Validated):
    """One rectangle, or an array of them, fixed to base_link."""

    centre: Annotated[Array, Shape(..., 2)]  #: (..., 2) centres in base_link [m]
    yaw: Annotated[Array, Shape(...)]  #: (...) directions of their lengths in base_link [rad]
    half: Annotated[Array, Shape(..., 2)]  #: (..., 2) half lengths and half widths [m], above zero

    @staticmethod
    def around(body: Body) -> "Rectangles":
        """Return one rectangle, or several, whose union contains a platform."""
        rows = platform_cover(body, MOST_RECTANGLES)
        if body.outline is None:
            return Rectangles.centred(rows[0, 3:])
        return Rectangles.of_rows(rows)

    @staticmethod
    def of_rows(rows: Array) -> "Rectangles":
        """Return the rectangles (P,) of rows (P, 5): centre, yaw, half."""
        return Rectangles(rows[:, :2], rows[:, 2], rows[:, 3:])

    @staticmethod
    def centred(half: Array) -> "Rectangles":
        """Return one rectangle around the origin of base_link, half length and width (2,) [m]."""
        return Rectangles(np.zeros(2), np.zeros(()), np.asarray(half, dtype=np.float64))

    @property
    def is_single(self) -> bool:
        """Whether this is one rectangle, not an array."""
        return self.yaw.ndim == 0

    def select(self, index: Indices | Mask) -> "Rectangles":
        """Return the rectangles with some indices, or those of a mask; one stays as it is."""
        if self.is_single:
            return self
        return Rectangles.unchecked(
            centre=self.centre[index], yaw=self.yaw[index], half=self.half[index]
        )

    def each(self) -> list["Rectangles"]:
        """Return the rectangles of an array (P,) one by one."""
        if self.is_single:
            return [self]
        return [self.select(np.array(k)) for k in range(len(self.yaw))]

    @property
    def rows(self) -> Array:
        """Rows (P, 5): centre, yaw, half; one rectangle is one row."""
        rows = np.concatenate((self.centre, self.yaw[..., None], self.half), axis=-1)
        return rows.reshape(-1, 5)

    def contain(self, points: Array, tolerance: float) -> Mask:
        """Return which rectangles (P,) contain all points (k, 2) up to a tolerance [m]."""
        rows = self.rows[:, None]
        c, s = np.cos(rows[..., 2]), np.sin(rows[..., 2])
        x, y = (points[:, i] - rows[..., i] for i in (0, 1))
        along, across = np.abs(c * x + s * y), np.abs(c * y - s * x)
        is_within = (along <= rows[..., 3] + tolerance) & (across <= rows[..., 4] + tolerance)
        result: Mask = np.all(is_within, axis=1)
        return result

    def distances(self, points: Array) -> Array:
        """Return the distances (...) of points (..., 2) from all of them [m], zero inside."""
        nearest = np.full(points.shape[:-1], np.inf)
        for x0, y0, yaw, length, width in self.rows.tolist():
            c, s = math.cos(yaw), math.sin(yaw)
            x, y = points[..., 0] - x0, points[..., 1] - y0
            along = np.maximum(np.abs(c * x + s * y) - length, 0.0)
            across = np.maximum(np.abs(c * y - s * x) - width, 0.0)
            np.minimum(nearest, np.hypot(along, across), out=nearest)
        return nearest

    @property
    def own_centre(self) -> tuple[Array, Array]:
        """Centres (...) along the rectangles' own lengths and widths [m]."""
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        x, y = self.centre[..., 0], self.centre[..., 1]
        return c * x + s * y, c * y - s * x

    @property
    def corners(self) -> Array:
        """Corners (..., 4, 2) in base_link, counter-clockwise [m]."""
        signs = np.array([(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)])
        local = self.half[..., None, :] * signs
        c, s = np.cos(self.yaw)[..., None], np.sin(self.yaw)[..., None]
        x, y = local[..., 0], local[..., 1]
        turned = np.stack((c * x - s * y, s * x + c * y), axis=-1)
        result: Array = self.centre[..., None, :] + turned
        return result

    @property
    def radius(self) -> Array:
        """Distances (...) of their farthest points from the origin of base_link [m]."""
        corners = self.corners
        result: Array = np.hypot(corners[..., 0], corners[..., 1]).max(axis=-1)
        return result

    def poses(self, poses: Array) -> Array:
        """Return the poses (K, 3) of one rectangle's centre at poses (K, 3) of base_link."""
        c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
        x, y = self.centre
        return np.column_stack(
            (poses[:, 0] + c * x - s * y, poses[:, 1] + s * x + c * y, poses[:, 2] + self.yaw)
        )

    def support(self, directions: Array) -> Array:
        """Return the farthest extents (...) of all of them along directions (...) [m, rad].

        Args:
            directions: Angles in base_link [rad].
        """
        corners = self.corners.reshape(-1, 2)
        along = np.stack((np.cos(directions), np.sin(directions)), axis=-1) @ corners.T
        result: Array = along.max(axis=-1)
        return result
