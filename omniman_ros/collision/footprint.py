"""Outline of the robot from above at given heights: its platform, and its arm in a posture."""

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from omniman_ros.collision.convex_search import Indices
from omniman_ros.collision.rectangles import Rectangles
from omniman_ros.collision.upright_obstacles import Mask
from omniman_ros.core.arrays import Array, Shape
from omniman_ros.core.validated import Validated

HEIGHT_STEP = 0.01  #: Step to which the heights of obstacles are rounded, outwards [m]
#: Height that counts as above everything, and as below everything with a minus [steps]
MAX_STEPS = 10_000
MOST_SPANS = 1000  #: Largest number of pairs of heights whose rectangles are remembered
#: Directions of which the one with the smallest rectangle is used [rad]
DIRECTIONS = np.arange(36) * (0.5 * math.pi / 36)
INSIDE = 1e-9  #: Tolerance for round-off when a rectangle is compared with the platform [m]


@dataclass(frozen=True)
class Limbs(Validated):
    """Parts of the arm, its tool and its load, as line segments with a radius, in groups."""

    start: Annotated[Array, Shape(3, "S")]  #: Starts (3, S) of the segments in base_link [m]
    end: Annotated[Array, Shape(3, "S")]  #: Ends (3, S) [m]
    #: Radii (S,) of the capsules around them [m]
    radius: Annotated[Array, Shape("S", low=0.0, unit="m")]
    #: Numbers (S,) of their groups; a group is bounded by one rectangle
    group: Annotated[Indices, Shape("S")]


class Footprint:
    """Bounds of the robot from above, at any heights.

    What the robot has between two heights is bounded by rectangles: those of the platform, whose
    union contains it, and one for each group of limbs. Parts outside of these heights do not
    count; up to a vertical gap, the margin [m], an obstacle counts as being at the height of a
    part. A rectangle contains its part, so a distance from the rectangles is never above that from
    the robot.

    Attributes:
        whole: (P,) or one: bounds of the robot at all heights.
        radius: Distance of the farthest point from the origin of base_link [m].
    """

    def __init__(
        self,
        platform: Rectangles,
        heights: tuple[float, float] = (-math.inf, math.inf),
        limbs: Limbs | None = None,
        margin: float = 0.0,
    ) -> None:
        self.platform = platform
        self._heights, self._limbs, self._margin = heights, limbs, margin
        self._known: dict[tuple[int, int], Rectangles] = {}
        everywhere = np.array([-math.inf]), np.array([math.inf])
        self.whole, _ = self.against(*everywhere)
        self.radius = float(self.whole.radius.max())

    @property
    def is_symmetric(self) -> bool:
        """Whether the robot covers the same area after half a revolution."""
        return self.whole.is_single

    def against(self, lower: Array, upper: Array) -> tuple[Rectangles, Indices]:
        """Return (N,) rectangles, or one for all, at the heights (M,) of obstacles [m].

        The number (N,) of the obstacle of each is the second result.
        """
        if self._limbs is None and self.platform.is_single:
            return self.platform, np.flatnonzero(self._is_beside_platform(lower, upper))
        low = np.clip(np.floor(lower / HEIGHT_STEP), -MAX_STEPS, MAX_STEPS).astype(np.intp)
        high = np.clip(np.ceil(upper / HEIGHT_STEP), -MAX_STEPS, MAX_STEPS).astype(np.intp)
        spans = list(zip(low.tolist(), high.tolist(), strict=True))
        parts = [self._at(span) for span in spans]
        index = np.repeat(np.arange(len(parts)), [len(part.yaw) for part in parts])
        empty = [self.platform.rows[:0]]
        rows = np.concatenate([*empty, *(part.rows for part in parts)])
        return Rectangles.of_rows(rows), index

    def _is_beside_platform(self, lower: Array, upper: Array) -> Mask:
        """Return whether obstacles (M,) are at the height of the platform."""
        bottom, top = self._heights
        result: Mask = (lower <= top + self._margin) & (upper >= bottom - self._margin)
        return result

    def _at(self, span: tuple[int, int]) -> Rectangles:
        """Return the rectangles (P,) between two heights [steps]; each is computed once."""
        if span not in self._known:
            if len(self._known) >= MOST_SPANS:
                self._known.clear()
            low, high = (HEIGHT_STEP * height for height in span)
            rows = self._limb_rows(low - self._margin, high + self._margin)
            if self._is_beside_platform(np.array([low]), np.array([high]))[0]:
                rows = rows[~self._is_on_platform(rows)]
                rows = np.concatenate([self.platform.rows, rows])
            self._known[span] = Rectangles.of_rows(rows)
        return self._known[span]

    def _is_on_platform(self, rows: Array) -> Mask:
        """Return which rectangles (P, 5) lie within one of the platform's."""
        corners = Rectangles.of_rows(rows).corners
        within = [self.platform.contain(each, INSIDE).any() for each in corners]
        return np.array(within, dtype=bool)

    def _limb_rows(self, low: float, high: float) -> Array:
        """Return the rectangles (P, 5) around the limbs between two heights [m].

        The part of a capsule between two heights lies within the capsule around the part of its
        axis between these heights, less and plus its radius.
        """
        limbs = self._limbs
        if limbs is None:
            return np.zeros((0, 5))
        first, last = low - limbs.radius, high + limbs.radius
        z, rise = limbs.start[2], limbs.end[2] - limbs.start[2]
        level = np.abs(rise) < 1e-12
        slope = np.where(level, 1.0, rise)
        at_first, at_last = (first - z) / slope, (last - z) / slope
        enter = np.where(level, 0.0, np.clip(np.minimum(at_first, at_last), 0.0, None))
        leave = np.where(level, 1.0, np.clip(np.maximum(at_first, at_last), None, 1.0))
        present: Mask = np.asarray(np.where(level, (z >= first) & (z <= last), enter <= leave))
        along = limbs.end[:2] - limbs.start[:2]
        ends = np.stack([limbs.start[:2] + enter * along, limbs.start[:2] + leave * along])
        rows = [
            _smallest(ends[:, :, here], limbs.radius[here])
            for number in range(int(limbs.group.max(initial=-1)) + 1)
            if (here := present & (limbs.group == number)).any()
        ]
        return np.array(rows).reshape(-1, 5)


def _smallest(ends: Array, radius: Array) -> Array:
    """Return the smallest rectangle (5,) around discs, starts and ends (2, 2, S), radii (S,)."""
    c, s = np.cos(DIRECTIONS)[:, None, None], np.sin(DIRECTIONS)[:, None, None]
    x, y = ends[:, 0], ends[:, 1]
    u, v = c * x + s * y, c * y - s * x
    low = np.stack([(axis - radius).min(axis=(1, 2)) for axis in (u, v)])
    high = np.stack([(axis + radius).max(axis=(1, 2)) for axis in (u, v)])
    size = high - low
    k = int((size[0] * size[1]).argmin())
    middle, yaw = 0.5 * (low + high)[:, k], DIRECTIONS[k]
    c0, s0 = math.cos(yaw), math.sin(yaw)
    centre = c0 * middle[0] - s0 * middle[1], s0 * middle[0] + c0 * middle[1]
    return np.array([*centre, yaw, *(0.5 * size[:, k])])
