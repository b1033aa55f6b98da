"""A polyline whose corners are rounded by parabolas: continuous slope, bounded curvature.

The parameter u is a time: at u' = 1 the fastest group of coordinates has its largest velocity on
each straight, so that u' <= 1 keeps every velocity limit.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.path.axes import AxisGroup, largest

Array = NDArray[np.float64]

STRAIGHT = 1e-9
"""Change of slope, over the largest velocity, that counts as none."""
SHORTEST = 1e-9
"""Pieces shorter than this are left out [s]."""


class Curve:
    """q(u) with q' continuous and q'' constant between knots.

    Args:
        points: (k, d) distinct points, k >= 2.
        groups: Limits; the velocities set the parameter.
        room: For each group, how far a corner may be cut [m or rad].
        head: Whether the first straight may be cut at will: the way out of a motion.

    Attributes:
        knots: (p + 1,) [s], from 0.
        values: (p + 1, d) q at the knots.
        slopes: (p + 1, d) q' at the knots.
        bends: (p, d) q'' between them.
    """

    def __init__(
        self, points: Array, groups: Sequence[AxisGroup], room: Sequence[float], head: bool = False
    ) -> None:
        steps = np.diff(points, axis=0)
        spans = largest(groups, steps, [group.velocity for group in groups])
        directions = steps / spans[:, None]
        corners = np.concatenate([[0.0], np.cumsum(spans)])
        reach = _reaches(spans, np.diff(directions, axis=0), groups, room, head)
        inner = reach > 0.0
        at, half = corners[1:-1][inner], reach[inner]
        turn_in, turn_out = directions[:-1][inner], directions[1:][inner]
        starts = points[1:-1][inner] - turn_in * half[:, None]
        ends = points[1:-1][inner] + turn_out * half[:, None]
        knots = np.concatenate([[0.0], np.stack([at - half, at + half], 1).ravel(), corners[-1:]])
        values = _framed(points[:1], starts, ends, points[-1:])
        slopes = _framed(directions[:1], turn_in, turn_out, directions[-1:])
        spans = np.diff(knots)
        real = spans > SHORTEST  # no straight is left between parabolas that touch
        self.knots = np.append(knots[:-1][real], knots[-1])
        self.values = np.vstack([values[:-1][real], values[-1:]])
        self.slopes = np.vstack([slopes[:-1][real], slopes[-1:]])
        self.bends: Array = np.diff(slopes, axis=0)[real] / spans[real][:, None]

    @property
    def end(self) -> float:
        """Largest u [s]."""
        return float(self.knots[-1])

    def piece(self, u: Array) -> NDArray[np.intp]:
        """Index of the piece that u (k,) is in."""
        found = np.searchsorted(self.knots, u, side="right") - 1
        return np.clip(found, 0, len(self.bends) - 1)

    def at(self, u: Array) -> Array:
        """Values q (k, d) at u (k,)."""
        i = self.piece(u)
        s = (u - self.knots[i])[:, None]
        value: Array = self.values[i] + s * (self.slopes[i] + 0.5 * s * self.bends[i])
        value[u >= self.end] = self.values[-1]  # without round-off: a path ends where it says
        return value

    def slope(self, u: Array) -> Array:
        """Slopes q' (k, d) at u (k,)."""
        i = self.piece(u)
        value: Array = self.slopes[i] + (u - self.knots[i])[:, None] * self.bends[i]
        return value


def _framed(first: Array, before: Array, after: Array, last: Array) -> Array:
    """Rows of `before` and `after` by turns, between the first and the last row."""
    inner = np.stack([before, after], axis=1).reshape(-1, first.shape[1])
    return np.vstack([first, inner, last])


def _reaches(
    spans: Array, turns: Array, groups: Sequence[AxisGroup], room: Sequence[float], head: bool
) -> Array:
    """Half the duration (k - 2,) [s] of the parabola at each inner point.

    A parabola over +-h leaves the corner by h |turn| / 4 and has q'' = turn / (2 h). It is as
    short as full speed allows, and no longer than the tolerance and the straights allow.
    """
    wanted = np.zeros(len(turns))
    allowed = np.full(len(turns), np.inf)
    for group, tolerance in zip(groups, room, strict=True):
        turn = group.norm(turns)
        wanted = np.maximum(wanted, turn / (2.0 * group.acceleration))
        bent = turn > STRAIGHT * group.velocity
        allowed[bent] = np.minimum(allowed[bent], 4.0 * tolerance / turn[bent])
    if head and len(allowed):
        allowed[0] = np.inf
    reach = np.minimum(wanted, allowed)
    # Two parabolas share the straight between them in proportion to what they want.
    both = np.concatenate([[0.0], reach]) + np.concatenate([reach, [0.0]])
    share = np.minimum(1.0, spans / np.maximum(both, 1e-300))
    reach = reach * np.minimum(share[:-1], share[1:])
    scale = largest(groups, turns, [group.velocity for group in groups])
    return np.where(scale > STRAIGHT, reach, 0.0)
