"""Polyline whose corners are rounded by parabolas: continuous slope, bounded curvature.

The parameter u is a time: at u' = 1 one group of coordinates moves at its velocity limit on each
straight, and none moves faster, so that u' <= 1 keeps every velocity limit.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.arrays import Array
from omniman_ros.motion.path.axis_group import AxisGroup, max_utilisation

#: Change of slope, relative to the velocity limit, up to which a corner counts as straight
STRAIGHT = 1e-9
MIN_PIECE = 1e-9  #: Length in u below which a piece is left out [s]


class Curve:
    """Curve q(u) with q' continuous and q'' constant between knots.

    Args:
        points: (k, d) distinct points of the polyline, k >= 2.
        groups: Limits of the coordinates; the velocity limits define the parameter.
        room: Distance by which corners may be cut, for each group [m or rad].
        free_first_corner: Whether the first corner may be cut without bound, as the first straight
            only leads out of the motion under way.

    Attributes:
        knots: (p + 1,) [s], from 0.
        values: (p + 1, d) q at the knots.
        slopes: (p + 1, d) q' at the knots.
        bends: (p, d) q'' between them.
    """

    def __init__(
        self,
        points: Array,
        groups: Sequence[AxisGroup],
        room: Sequence[float],
        free_first_corner: bool = False,
    ) -> None:
        steps = np.diff(points, axis=0)
        spans = max_utilisation(groups, steps, [group.velocity for group in groups])
        directions = steps / spans[:, None]
        corners = np.concatenate([[0.0], np.cumsum(spans)])
        reach = _reaches(spans, np.diff(directions, axis=0), groups, room, free_first_corner)
        rounded = reach > 0.0
        at, half = corners[1:-1][rounded], reach[rounded]
        slope_in, slope_out = directions[:-1][rounded], directions[1:][rounded]
        starts = points[1:-1][rounded] - slope_in * half[:, None]
        ends = points[1:-1][rounded] + slope_out * half[:, None]
        knots = np.concatenate([[0.0], np.stack([at - half, at + half], 1).ravel(), corners[-1:]])
        values = _framed(points[:1], starts, ends, points[-1:])
        slopes = _framed(directions[:1], slope_in, slope_out, directions[-1:])
        spans = np.diff(knots)
        kept = spans > MIN_PIECE  # parabolas that touch leave no straight between them
        self.knots = np.append(knots[:-1][kept], knots[-1])
        self.values = np.vstack([values[:-1][kept], values[-1:]])
        self.slopes = np.vstack([slopes[:-1][kept], slopes[-1:]])
        self.bends: Array = np.diff(slopes, axis=0)[kept] / spans[kept][:, None]

    @property
    def end(self) -> float:
        """Parameter of the last point [s]."""
        return float(self.knots[-1])

    def piece(self, u: Array) -> NDArray[np.intp]:
        """Return the index (k,) of the piece that contains each u (k,)."""
        index = np.searchsorted(self.knots, u, side="right") - 1
        return np.clip(index, 0, len(self.bends) - 1)

    def at(self, u: Array) -> Array:
        """Return the values q (k, d) at u (k,)."""
        i = self.piece(u)
        s = (u - self.knots[i])[:, None]
        value: Array = self.values[i] + s * (self.slopes[i] + 0.5 * s * self.bends[i])
        # Without round-off: the path ends exactly at its last point.
        value[u >= self.end] = self.values[-1]
        return value

    def slope(self, u: Array) -> Array:
        """Return the slopes q' (k, d) at u (k,)."""
        i = self.piece(u)
        value: Array = self.slopes[i] + (u - self.knots[i])[:, None] * self.bends[i]
        return value


def _framed(first: Array, before: Array, after: Array, last: Array) -> Array:
    inner = np.stack([before, after], axis=1).reshape(-1, first.shape[1])
    return np.vstack([first, inner, last])


def _reaches(
    spans: Array,
    changes: Array,
    groups: Sequence[AxisGroup],
    room: Sequence[float],
    free_first_corner: bool,
) -> Array:
    """Return half the duration (k - 2,) [s] of the parabola at each inner point.

    A parabola over +-h cuts the corner by h |dq'| / 4 and has q'' = dq' / (2 h), where dq' is the
    change of slope at the corner. It is as short as full speed allows, and no longer than the
    tolerance and the straights allow.
    """
    desired = np.zeros(len(changes))
    allowed = np.full(len(changes), np.inf)
    for group, tolerance in zip(groups, room, strict=True):
        change = group.norm(changes)
        desired = np.maximum(desired, change / (2.0 * group.acceleration))
        bent = change > STRAIGHT * group.velocity
        allowed[bent] = np.minimum(allowed[bent], 4.0 * tolerance / change[bent])
    if free_first_corner and len(allowed):
        allowed[0] = np.inf
    reach = np.minimum(desired, allowed)
    # Two parabolas share the straight between them in proportion to their desired lengths.
    combined = np.concatenate([[0.0], reach]) + np.concatenate([reach, [0.0]])
    scale = np.minimum(1.0, spans / np.maximum(combined, 1e-300))
    reach = reach * np.minimum(scale[:-1], scale[1:])
    relative = max_utilisation(groups, changes, [group.velocity for group in groups])
    return np.where(relative > STRAIGHT, reach, 0.0)
