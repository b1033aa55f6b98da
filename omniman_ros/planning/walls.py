"""What a map says is occupied, as discs that stand: quick to keep a box clear of."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omniman_ros.planning.ellipses import Ellipses

Array = NDArray[np.float64]

REACH = 0.3
"""Walls that are further away than this count as being so far [m]."""
CHUNK = 24
"""So many poses are looked at together, with the discs that are beside any of them."""


@dataclass(frozen=True)
class Walls:
    """Discs of one radius that cover what is occupied at its boundary.

    Attributes:
        centers: (M, 2) in odom, put in the order of x: few of a large map are looked at [m].
        radius: [m].
    """

    centers: Array
    radius: float

    def __post_init__(self) -> None:
        x = self.centers[:, 0]
        if (x[1:] < x[:-1]).any():
            object.__setattr__(self, "centers", self.centers[np.argsort(x)])

    def __len__(self) -> int:
        return len(self.centers)

    @staticmethod
    def none() -> "Walls":
        """No wall."""
        return Walls(np.zeros((0, 2)), 1.0)

    def near(self, place: Array, reach: float) -> "Walls":
        """Those whose centres are within a square of this half edge [m] around a place (2,)."""
        return self._beside(place[None, :2], reach)

    def ellipses(self, time: float) -> Ellipses:
        """The same as obstacles that stand, at a time [s]."""
        count = len(self)
        none = np.zeros(count)
        axes = np.full((count, 2), self.radius)
        return Ellipses(time, self.centers, np.zeros((count, 2)), axes, none, none)

    def gaps(self, poses: Array, half: Array) -> Array:
        """Distance from a box to the nearest disc, pose by pose.

        Args:
            poses: (K, 3) of the box's centre in odom [m, m, rad].
            half: (2,) half length and half width of the box [m].

        Returns:
            (K,) [m], at most REACH; below zero by how deep a disc is in the box; -inf where a
            pose is not finite.
        """
        finite = np.isfinite(poses).all(axis=1)
        result = np.where(finite, REACH, -math.inf)
        if len(self) and finite.any():
            result[finite] = self._gaps(poses[finite], half)
        return result

    def _gaps(self, poses: Array, half: Array) -> Array:
        """The same at finite poses, one or more."""
        result = np.full(len(poses), REACH)
        cos, sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
        size = math.hypot(*half) + self.radius + REACH
        around = self._beside(poses[:, :2], size)
        for first in range(0, len(poses), CHUNK):
            part = slice(first, first + CHUNK)
            places = poses[part, :2]
            away = around._beside(places, size).centers - places[:, None]
            if not away.size:
                continue
            c, s = cos[part, None], sin[part, None]
            x = np.abs(c * away[..., 0] + s * away[..., 1]) - half[0]
            y = np.abs(c * away[..., 1] - s * away[..., 0]) - half[1]
            out = np.hypot(np.maximum(x, 0.0), np.maximum(y, 0.0))
            depth = np.minimum(np.maximum(x, y), 0.0)
            result[part] = np.minimum((out + depth).min(axis=1) - self.radius, REACH)
        return result

    def _beside(self, places: Array, size: float) -> "Walls":
        """Those that can be within `size` [m] of any of the places (K, 2)."""
        (x_min, y_min), (x_max, y_max) = places.min(axis=0) - size, places.max(axis=0) + size
        first = int(np.searchsorted(self.centers[:, 0], x_min, side="left"))
        last = int(np.searchsorted(self.centers[:, 0], x_max, side="right"))
        strip = self.centers[first:last]
        beside = (strip[:, 1] >= y_min) & (strip[:, 1] <= y_max)
        return Walls(strip[beside], self.radius)

    def swept(
        self, times: Array, poses: Array, velocities: Array, half: Array
    ) -> tuple[Array, Array]:
        """The same at samples, and over the intervals between them.

        The distance changes by no more than any point of the box travels, L: between two samples
        it is (g0 + g1 - L) / 2 or more.

        Args:
            times: (K,) increasing [s].
            poses: (K, 3) in odom [m, m, rad].
            velocities: (K, 3) in odom; between two samples no speed is above both its ends'.
            half: (2,) half length and half width of the box [m].

        Returns:
            `gaps` (K,) at the samples, and lower bounds (K - 1,) between them [m].
        """
        gaps = self.gaps(poses, half)
        speed = np.hypot(velocities[:, 0], velocities[:, 1])
        speed = speed + math.hypot(*half) * np.abs(velocities[:, 2])
        travel = np.diff(times) * np.maximum(speed[:-1], speed[1:])
        return gaps, 0.5 * (gaps[:-1] + gaps[1:] - travel)
