"""Occupied cells of a map as discs of one radius, with a fast clearance of boxes from them."""

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from omniman_ros.collision.rectangles import Rectangles
from omniman_ros.core.arrays import Array, Shape
from omniman_ros.core.validated import Validated
from omniman_ros.surroundings.ellipses import Ellipses

#: Largest gap to walls that is computed [m]; larger gaps are returned as this value
MAX_COMPUTED_GAP = 0.3
COARSE = 4  #: Number of intervals that are checked as one where walls are far
CHUNK = 24  #: Number of poses that are checked together, against all discs near any of them


@dataclass(frozen=True)
class Walls(Validated):
    """Discs of one radius that cover the boundary of the occupied area."""

    #: (M, 2) centres in odom [m], sorted by x to find those near a pose quickly
    centers: Annotated[Array, Shape("M", 2)]
    radius: float  #: Radius of the discs [m]

    def __post_init__(self) -> None:
        super().__post_init__()
        x = self.centers[:, 0]
        if (x[1:] < x[:-1]).any():
            centers = self.centers[np.argsort(x)]
            centers.setflags(write=False)
            object.__setattr__(self, "centers", centers)

    def __len__(self) -> int:
        return len(self.centers)

    @staticmethod
    def none() -> "Walls":
        """Return an empty set of walls."""
        return Walls(np.zeros((0, 2)), 1.0)

    def near(self, place: Array, reach: float) -> "Walls":
        """Return the discs with centres in a square around a point (2,), half edge `reach` [m]."""
        return self._beside(place[None, :2], reach)

    def ellipses(self, time: float) -> Ellipses:
        """Return the discs as standing obstacles at a time [s]."""
        count = len(self)
        none = np.zeros(count)
        axes = np.full((count, 2), self.radius)
        return Ellipses(time, self.centers, np.zeros((count, 2)), axes, none, none)

    def gaps(self, poses: Array, boxes: Rectangles) -> Array:
        """Return the distances (K,) from boxes to the nearest disc, at most REACH [m].

        They are negative by the depth to which a disc enters a box, and -inf where one of the
        poses (K, 3) in odom is not finite.

        Args:
            poses: (K, 3) poses of base_link in odom [m, m, rad].
        """
        finite = np.isfinite(poses).all(axis=1)
        result = np.where(finite, MAX_COMPUTED_GAP, -math.inf)
        if len(self) and finite.any():
            each = [self._gaps(box.poses(poses[finite]), box.half) for box in boxes.each()]
            result[finite] = np.min(each, axis=0)
        return result

    def _gaps(self, poses: Array, half: Array) -> Array:
        """Return the distances of one box, half (2,) [m], at poses of its centre, all finite."""
        result = np.full(len(poses), MAX_COMPUTED_GAP)
        cos, sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
        size = math.hypot(*half) + self.radius + MAX_COMPUTED_GAP
        around = self._beside(poses[:, :2], size)
        for first in range(0, len(poses), CHUNK):
            part = slice(first, first + CHUNK)
            positions = poses[part, :2]
            offset = around._beside(positions, size).centers - positions[:, None]
            if not offset.size:
                continue
            c, s = cos[part, None], sin[part, None]
            x = np.abs(c * offset[..., 0] + s * offset[..., 1]) - half[0]
            y = np.abs(c * offset[..., 1] - s * offset[..., 0]) - half[1]
            distance = np.hypot(np.maximum(x, 0.0), np.maximum(y, 0.0))
            depth = np.minimum(np.maximum(x, y), 0.0)
            result[part] = np.minimum(
                (distance + depth).min(axis=1) - self.radius, MAX_COMPUTED_GAP
            )
        return result

    def gaps_of_each(self, poses: Array, boxes: Rectangles) -> Array:
        """Return the least distance of each disc (M,) from boxes at poses (K, 3) [m].

        It is up to REACH, and negative by the depth to which the disc enters a box.
        """
        result = np.full(len(self), MAX_COMPUTED_GAP)
        reach = float(boxes.radius.max()) + self.radius + MAX_COMPUTED_GAP
        low, high = poses[:, :2].min(axis=0) - reach, poses[:, :2].max(axis=0) + reach
        near = np.flatnonzero(((self.centers >= low) & (self.centers <= high)).all(axis=1))
        least = result[near]
        for box in boxes.each():
            for x0, y0, yaw in box.poses(poses).tolist():
                x, y = (self.centers[near] - (x0, y0)).T
                c, s = math.cos(yaw), math.sin(yaw)
                along = np.abs(c * x + s * y) - box.half[0]
                across = np.abs(c * y - s * x) - box.half[1]
                distance = np.hypot(np.maximum(along, 0.0), np.maximum(across, 0.0))
                depth = np.minimum(np.maximum(along, across), 0.0)
                np.minimum(least, distance + depth - self.radius, out=least)
        result[near] = least
        return result

    def _beside(self, places: Array, size: float) -> "Walls":
        """Return the discs that may be within `size` [m] of any of the points (K, 2)."""
        (x_min, y_min), (x_max, y_max) = places.min(axis=0) - size, places.max(axis=0) + size
        first = int(np.searchsorted(self.centers[:, 0], x_min, side="left"))
        last = int(np.searchsorted(self.centers[:, 0], x_max, side="right"))
        strip = self.centers[first:last]
        beside = (strip[:, 1] >= y_min) & (strip[:, 1] <= y_max)
        return Walls(strip[beside], self.radius)

    def swept(
        self,
        times: Array,
        poses: Array,
        velocities: Array,
        boxes: Rectangles,
        enough: float = math.inf,
    ) -> tuple[Array, Array]:
        """Return gaps (K,) at samples of a motion, and lower bounds (K - 1,) between them [m].

        The distance changes by no more than L, the largest travel of any point of a box: between
        two samples it is (g0 + g1 - L) / 2 or more. Times increase; between two samples no speed
        is above those at both of them, nor between every COARSE-th sample.

        Args:
            poses: (K, 3) poses of base_link in odom [m, m, rad].
            velocities: (K, 3) velocities in odom [m/s, m/s, rad/s].
            enough: Gap above which a lower bound may stand for the gaps themselves, except before
                the COARSE-th sample [m].
        """
        speed = np.hypot(velocities[:, 0], velocities[:, 1])
        speed = speed + boxes.radius.max() * np.abs(velocities[:, 2])
        last = len(times) - 1
        coarse = np.append(np.arange(0, last, COARSE), last)
        nodes = np.empty(len(times))
        nodes[coarse] = self.gaps(poses[coarse], boxes)
        far = _between(times[coarse], nodes[coarse], speed[coarse])
        is_far = far > enough
        is_far[:1] = False
        part = np.minimum(np.arange(last) // COARSE, len(far) - 1)
        bound, is_far = far[part], is_far[part]
        fine = np.ones(len(times), dtype=bool)
        fine[coarse] = False
        fine[:-1] &= ~is_far
        nodes[fine] = self.gaps(poses[fine], boxes)
        nodes[:-1][is_far & (np.arange(last) % COARSE > 0)] = enough
        return nodes, np.where(is_far, bound, _between(times, nodes, speed))


def _between(times: Array, gaps: Array, speed: Array) -> Array:
    """Return lower bounds (K - 1,) of the gaps between samples at times (K,)."""
    travel = np.diff(times) * np.maximum(speed[:-1], speed[1:])
    result: Array = 0.5 * (gaps[:-1] + gaps[1:] - travel)
    return result
