"""Gaps of the whole body for the search, which looks at thousands of poses at once."""

import math

import numpy as np
from numpy.typing import NDArray

from omniman_ros.collision.rectangles import Rectangles
from omniman_ros.collision.signed_gaps import point_gap_values, rectangle_gaps
from omniman_ros.collision.upright_obstacles import Mask, UprightObstacles
from omniman_ros.core.arrays import Array
from omniman_ros.planning.whole_body.body_gaps import BodyGaps

CELL = 0.01  #: Edge of the cells of the distance field [m]
SPACING = 0.04  #: Largest distance between two points on the platform's outline [m]
#: Gap of the platform below which it counts as touching [m]: what is that deep in a corner of its
#: outline may be seen from the outline alone
LEAST_GAP = 0.05
BATCH = 2_000_000  #: Number of pairs of spheres and obstacles that are looked at together


class DistanceField:
    """Horizontal distances from obstacles, on a grid.

    A place is looked up in constant time, whatever the number of obstacles. No distance is
    overestimated, and none below the reach is underestimated by more than the diagonal of a cell.

    Args:
        low, high: Corners (2,) of the area [m].
        reach: Largest distance [m].
    """

    def __init__(self, obstacles: UprightObstacles, low: Array, high: Array, reach: float) -> None:
        self._low = low
        columns, rows = (np.ceil((high - low) / CELL).astype(np.intp) + 1).tolist()
        values: NDArray[np.float32] = np.full((rows, columns), reach, dtype=np.float32)
        x, y = ((CELL * (np.arange(count) + 0.5)).astype(np.float32) for count in (columns, rows))
        outer = np.hypot(*obstacles.half) + obstacles.rounding + reach
        centre = obstacles.centre - low[:, None]
        first = np.maximum((centre - outer) / CELL, 0.0).astype(np.intp)
        last = np.maximum((centre + outer) / CELL + 1.0, 0.0)
        for k, (j, i, m, n) in enumerate(np.vstack([first, last.astype(np.intp)]).T.tolist()):
            part = values[i:n, j:m]
            if not part.size:
                continue
            c, s = np.float32(math.cos(obstacles.yaw[k])), np.float32(math.sin(obstacles.yaw[k]))
            dx = x[j:m] - np.float32(centre[0, k])
            dy = y[i:n, None] - np.float32(centre[1, k])
            length, width = obstacles.half[:, k].astype(np.float32)
            beyond_x = np.maximum(np.abs(c * dx + s * dy) - length, 0.0)
            beyond_y = np.maximum(np.abs(c * dy - s * dx) - width, 0.0)
            distance = np.sqrt(beyond_x * beyond_x + beyond_y * beyond_y)
            np.minimum(part, distance - np.float32(obstacles.rounding[k]), out=part)
        values -= np.float32(0.5 * math.sqrt(2.0) * CELL)
        self._values, self._columns = values.ravel(), columns

    def at(self, x: Array, y: Array) -> NDArray[np.float32]:
        """Return the distances at places within the area [m]."""
        row = ((y - self._low[1]) * (1.0 / CELL)).astype(np.intp)
        column = ((x - self._low[0]) * (1.0 / CELL)).astype(np.intp)
        row *= self._columns
        row += column
        result: NDArray[np.float32] = self._values[row]
        return result


class CoarseGaps:
    """Gaps of a body to what stands in an area: most of it is one field of distances.

    No gap is overestimated. Those to what the platform or parts of the arm pass below or above are
    exact.

    Args:
        low, high: Corners (2,) of the area that the body does not leave [m].
        heights: Least and largest height of the spheres' centres [m].
        wide: Gap above which a wider one may be returned as this [m].
    """

    def __init__(
        self,
        gaps: BodyGaps,
        obstacles: UprightObstacles,
        low: Array,
        high: Array,
        heights: tuple[float, float],
        wide: float,
    ) -> None:
        self._gaps, self._wide = gaps, wide
        self._outlines = [_Outline(each) for each in gaps.rectangles]
        cover = max([float(gaps.spheres.radius.max()), *(o.cover for o in self._outlines)])
        reach = wide + cover + CELL
        extent = np.hypot(*obstacles.half) + obstacles.rounding + reach
        is_near = (obstacles.centre + extent >= low[:, None]).all(axis=0)
        is_near &= (obstacles.centre - extent <= high[:, None]).all(axis=0)
        near = obstacles.select(np.flatnonzero(is_near))
        bottom, top = gaps.heights
        beside_deck, beside_arm = _spans(near, top, bottom), _spans(near, *heights)
        self._not_deck, self._not_arm = (
            near.select(np.flatnonzero(~mask)) for mask in (beside_deck, beside_arm)
        )

        def field(mask: Mask) -> DistanceField | None:
            chosen = near.select(np.flatnonzero(mask))
            return DistanceField(chosen, low, high, reach) if len(chosen) else None

        self._deck_field = field(beside_deck)
        is_same = (beside_deck == beside_arm).all()
        self._arm_field = self._deck_field if is_same else field(beside_arm)

    def platform(self, poses: Array) -> Array:
        """Return the least gaps (k,) of the platform at poses (k, 3) [m]."""
        result = np.full(len(poses), np.inf)
        for each, outline in zip(self._gaps.rectangles, self._outlines, strict=True):
            at = each.poses(poses)
            if len(self._not_deck):
                gaps = rectangle_gaps(self._not_deck, at, each.half, self._gaps.heights)
                np.minimum(result, gaps.min(axis=1), out=result)
            if self._deck_field is not None:
                np.minimum(result, outline.gaps(at, self._deck_field, self._wide), out=result)
        return result

    def arm(self, centre: Array) -> Array:
        """Return the least gaps (k,) of spheres with centres (3, k, S) [m]."""
        radius, (_, count, spheres) = self._gaps.spheres.radius, centre.shape
        result = np.full(count, np.inf)
        if self._arm_field is not None:
            result = (self._arm_field.at(centre[0], centre[1]) - radius).min(axis=1)
        if len(self._not_arm):
            rows = max(1, BATCH // (spheres * len(self._not_arm)))
            for first in range(0, count, rows):
                part = slice(first, first + rows)
                gap = point_gap_values(self._not_arm, centre[:, part]).min(axis=-1) - radius
                result[part] = np.minimum(result[part], gap.min(axis=1))
        return result


class _Outline:
    """Points of a rectangle that see whatever comes near it.

    Discs around inner points, as large as they fit, cover the rectangle but for what is
    `LEAST_GAP` from its sides. Points on the sides see what is outside.

    Attributes:
        cover: Largest distance of the sides from the nearest inner point [m].
    """

    def __init__(self, rectangle: Rectangles) -> None:
        half = rectangle.half
        # In a corner, a disc of radius r leaves (1 - 1 / sqrt 2) r.
        inset = min(float(half.min()), LEAST_GAP / (1.0 - math.sqrt(0.5)))
        x, y = (_line(length - inset, inset) for length in half.tolist())
        self._inner = np.stack(np.meshgrid(x, y, indexing="ij")).reshape(2, -1)
        self._depth = (half[:, None] - np.abs(self._inner)).min(axis=0)
        self.cover = inset * math.sqrt(2.0)
        (x, y), (length, width) = (_line(each, SPACING) for each in half.tolist()), half.tolist()
        sides = [(x, np.full_like(x, sign * width)) for sign in (-1.0, 1.0)]
        sides += [(np.full_like(y, sign * length), y) for sign in (-1.0, 1.0)]
        self._outer = np.hstack([np.stack(side) for side in sides])

    def gaps(self, poses: Array, field: DistanceField, wide: float) -> Array:
        """Return the gaps (k,) of the rectangle at poses (k, 3), up to a wide one [m]."""
        distance = field.at(*_placed(poses, self._inner))
        touches = (distance < self._depth).any(axis=1)
        chosen = np.flatnonzero(~touches & (distance.min(axis=1) < wide + self.cover))
        distance = field.at(*_placed(poses[chosen], self._outer)).min(axis=1)
        # The nearest point of a side is at most half the spacing from one of these.
        square = np.maximum(distance, 0.0) ** 2 - (0.5 * SPACING) ** 2
        result = np.where(touches, -LEAST_GAP, wide)
        result[chosen] = np.sqrt(np.maximum(square, 0.0))
        result[result < LEAST_GAP] = -LEAST_GAP
        return result


def _line(half: float, spacing: float) -> Array:
    """Return points from -half to half, at most `spacing` apart [m]."""
    points: Array = np.linspace(-half, half, math.ceil(2.0 * half / spacing - 1e-9) + 1)
    return points


def _placed(poses: Array, points: Array) -> tuple[Array, Array]:
    """Return x and y (k, n) of points (2, n) at poses (k, 3)."""
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    x, y = points
    # One product each: there are millions of points.
    along = np.column_stack([poses[:, 0], c, -s]) @ np.stack([np.ones_like(x), x, y])
    across = np.column_stack([poses[:, 1], c, s]) @ np.stack([np.ones_like(x), y, x])
    return along, across


def _spans(obstacles: UprightObstacles, above: float, below: float) -> Mask:
    """Return which obstacles begin below a height and end above another one [m]."""
    result: Mask = (obstacles.lower <= above) & (obstacles.upper >= below)
    return result
