"""A route over (x, y, heading): straight pieces, timed by the speeds they can be driven at."""

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core import plausible, se2
from omniman_ros.core.errors import InputError
from omniman_ros.planning.ellipses import Ellipses
from omniman_ros.planning.separation import Workspace, box_gap, outside_by

Array = NDArray[np.float64]
Index = NDArray[np.intp]

SPACING = 0.02
"""No point of the box moves by more than this between two poses that are looked at [m]."""
FINE_TURN = 0.5
"""Pieces that turn by more than this are projected on in parts [rad]."""
LEVER = 0.3
"""What a heading error of a radian counts for, next to a distance [m]."""
BACK, AHEAD = 0.5, 2.0
"""A pose is looked for so much before and after where it was last, along the route [s]."""
SAME = 1e-9
"""Times that are closer than this are one [s]."""
PAIRS = 50_000
"""So many pairs of pose and obstacle are looked at together, for memory's sake."""
FEW = 20
"""More obstacles than this are looked up by tiles."""
TILE, WIDE_TILE = 0.5, 4.0
"""Edges of the tiles, and of those that they are made from [m]."""
TOLD = 0.01
"""Gaps are told apart up to so much above what is asked for [m]."""


@dataclass(frozen=True)
class Route:
    """Poses joined by straight lines in (x, y, heading), from a start to a goal.

    The position along it is the least time of travel from its start [s]: translation and rotation
    are at the same time, the slower of the two at its speed.

    Attributes:
        poses: (K, 3) of base_link in odom, K >= 1, headings not wrapped [m, m, rad].
        speeds: (v, w) that the times are of [m/s, rad/s].
        times: (K,) of the poses, from 0 on [s].

    Raises:
        InputError: No pose, one that is not finite or huge, or a speed not above zero.
    """

    poses: Array
    speeds: tuple[float, float]
    times: Array = field(init=False)

    def __post_init__(self) -> None:
        poses = np.array(self.poses, dtype=np.float64)
        if poses.ndim != 2 or poses.shape[1] != 3 or not len(poses):
            raise InputError(f"route: poses of shape {poses.shape}, expected (K, 3)")
        plausible.demand(poses[:, :2], plausible.LENGTH, "route: position")
        plausible.demand(poses[:, 2], plausible.ANGLE, "route: heading")
        if not all(0.0 < speed < math.inf for speed in self.speeds):
            raise InputError(f"route: speeds {self.speeds} m/s, rad/s, expected above 0")
        times = np.concatenate([[0.0], np.cumsum(durations(np.diff(poses, axis=0), self.speeds))])
        for name, value in (("poses", poses), ("times", times)):
            value.setflags(write=False)
            object.__setattr__(self, name, value)

    @property
    def duration(self) -> float:
        """Least time of travel from start to goal [s]."""
        return float(self.times[-1])

    @property
    def length(self) -> float:
        """Length of the way of base_link [m]."""
        steps = np.diff(self.poses[:, :2], axis=0)
        return float(np.hypot(steps[:, 0], steps[:, 1]).sum())

    def at(self, times: Array) -> Array:
        """Poses (N, 3) at positions (N,) along the route [s]; its ends beyond them."""
        return np.column_stack([np.interp(times, self.times, axis) for axis in self.poses.T])

    def project(
        self, pose: Array, near: float | None = None, window: tuple[float, float] = (BACK, AHEAD)
    ) -> float:
        """Position along the route that is nearest to a pose.

        Nearest is by the distance of the positions and LEVER times the heading error together.

        Args:
            pose: (3,) in odom [m, m, rad]; its heading may be on any branch.
            near: Where the pose was last [s]; only a window around that is looked at, so that
                it can't jump to where the route comes by again or behind a wall. None: all of it.
            window: How far before and after that is looked [s].

        Returns:
            [s], the first of equal ones.
        """
        first, last = 0.0, self.duration
        if near is not None:
            near = min(max(near, 0.0), last)
            first, last = max(near - window[0], 0.0), min(near + window[1], last)
        knots = self._knots(first, last)
        points = self.at(knots)
        steps = np.diff(points, axis=0) * [1.0, 1.0, LEVER]
        away = pose - points[:-1]
        # Within a part the route turns by little: the branch at its begin is the right one.
        away[:, 2] = LEVER * (np.remainder(away[:, 2] + math.pi, math.tau) - math.pi)
        squares = (steps * steps).sum(axis=1)
        along = (away * steps).sum(axis=1)
        share = np.clip(along / np.maximum(squares, np.finfo(float).tiny), 0.0, 1.0)
        left = away - share[:, None] * steps
        best = int(np.argmin((left * left).sum(axis=1)))
        return float(knots[best] + share[best] * (knots[best + 1] - knots[best]))

    def samples(
        self, half: Array, first: float = 0.0, last: float = math.inf
    ) -> tuple[Array, Array]:
        """Positions (N,) [s] and poses (N, 3) of a part.

        No point of the box, half (2,) [m], moves by more than SPACING between two of them.
        """
        first = min(max(first, 0.0), self.duration)
        last = max(min(last, self.duration), first)
        knots = self._knots(first, last)
        fine = refined(self.at(knots), half)
        return np.interp(fine, np.arange(len(knots)), knots), along(self.at(knots), fine)

    def clear(
        self,
        half: Array,
        around: Ellipses,
        workspace: Workspace,
        margin: float = 0.0,
        first: float = 0.0,
        last: float = math.inf,
    ) -> bool:
        """Whether the box still keeps a gap on a part of the route.

        Args:
            half: (2,) half length and half width of the box [m].
            around: Obstacles, taken to stand where they are at their time.
            workspace: (x_min, y_min, x_max, y_max) in odom [m].
            margin: Gap [m] that is to be above this all the way, to both.
            first: From where on along the route [s] ...
            last: ... up to where [s].
        """
        _, poses = self.samples(half, first, last)
        clearance = Clearance(half, around, workspace, margin + TOLD)
        return bool((clearance.gaps(poses) > margin).all())

    def _knots(self, first: float, last: float) -> Array:
        """Positions [s] of a part's ends, of the poses between, and of parts of large turns."""
        inner = self.times[(self.times > first + SAME) & (self.times < last - SAME)]
        knots = np.concatenate([[first], inner, [last]])
        turns = np.abs(np.diff(self.at(knots)[:, 2]))
        return _divided(knots, np.ceil(turns / FINE_TURN))


def straight(start: Array, goal: Array, speeds: tuple[float, float]) -> Route:
    """The straight line from pose to pose (3,), turning the shorter way round.

    Raises:
        InputError: See `Route`.
    """
    turned = se2.wrap(float(goal[2] - start[2]))
    end = np.array([goal[0], goal[1], start[2] + turned])
    return Route(np.stack([start, end]), speeds)


def durations(steps: Array, speeds: tuple[float, float]) -> Array:
    """Least times (N,) [s] of steps (N, 3) [m, m, rad] at the speeds [m/s, rad/s]."""
    way = np.hypot(steps[:, 0], steps[:, 1])
    result: Array = np.maximum(way / speeds[0], np.abs(steps[:, 2]) / speeds[1])
    return result


class Clearance:
    """How far a box keeps from what stands around it; made for many poses among many obstacles.

    Obstacles are looked up by tiles of the floor, each made when a pose is first on it.

    Args:
        half: (2,) half length and half width of the box [m].
        around: M obstacles, where they are at their time.
        workspace: (x_min, y_min, x_max, y_max) in odom [m].
        reach: Obstacles further away than this need not be told apart from none [m].
    """

    def __init__(
        self, half: Array, around: Ellipses, workspace: Workspace, reach: float = math.inf
    ) -> None:
        self._half, self._around, self._workspace = half, around, workspace
        self._size = around.semi_axes.max(axis=1, initial=0.0) + reach + math.hypot(*half)
        self._tiled = len(around) > FEW and math.isfinite(reach)
        self._all = np.arange(len(around))
        self._tiles: dict[tuple[float, int, int], Index] = {}

    def gaps(self, poses: Array) -> Array:
        """The least gap at each pose.

        Args:
            poses: (K, 3) in odom [m, m, rad].

        Returns:
            (K,) [m]: of `box_gap` and of the distance to the workspace's edge; not above zero
            where the box touches something.
        """
        result: Array = -outside_by(poses, self._half, self._workspace)
        if not len(self._around):
            return result
        if not self._tiled or not np.isfinite(poses).all():
            size = max(16, PAIRS // len(self._around))
            for k in range(0, len(poses), size):
                self._lower(result[k : k + size], poses[k : k + size], self._all)
            return result
        tiles = np.floor(poses[:, :2] / TILE).astype(np.intp)
        turns = np.flatnonzero((np.diff(tiles, axis=0) != 0).any(axis=1)) + 1
        ends = [0, *turns.tolist(), len(poses)]
        for first, last in zip(ends[:-1], ends[1:], strict=True):
            which = self._tile(TILE, *tiles[first].tolist())
            if len(which):
                self._lower(result[first:last], poses[first:last], which)
        return result

    def _tile(self, edge: float, x: int, y: int) -> Index:
        """Indices of the obstacles that count somewhere on a tile."""
        key = edge, x, y
        if key not in self._tiles:
            many = self._all
            if edge < WIDE_TILE:
                ratio = round(WIDE_TILE / edge)
                many = self._tile(WIDE_TILE, x // ratio, y // ratio)
            size = self._size[many]
            away = np.abs(self._around.centers[many] - edge * (np.array([x, y]) + 0.5))
            beyond = np.maximum(away - 0.5 * edge, 0.0)
            self._tiles[key] = many[(beyond * beyond).sum(axis=1) <= size * size]
        return self._tiles[key]

    def _lower(self, result: Array, poses: Array, which: Index) -> None:
        """Lower gaps (K,) to those of obstacles of these indices."""
        away = poses[:, None, :2] - self._around.centers[which]
        size = self._size[which]
        near = ~((away * away).sum(axis=2) > size * size)  # NaN stays
        k, j = np.nonzero(near)
        if len(k):
            gap = _pairs(away[k, j], poses[k, 2], self._half, self._around, which[j])
            np.minimum.at(result, k, gap)


def _pairs(away: Array, headings: Array, half: Array, known: Ellipses, which: Index) -> Array:
    """Gaps (N,) [m] of boxes away (N, 2) from obstacles of these indices (N,)."""
    axes = known.semi_axes[which]
    turned = known.angles[which]
    gap = np.empty(len(away))
    disc = axes[:, 0] == axes[:, 1]
    if disc.any():  # a disc looks the same from all sides: what `box_gap` gives outside of it
        (x, y), heading = away[disc].T, headings[disc]
        c, s = np.cos(heading), np.sin(heading)
        ahead = np.maximum(np.abs(c * x + s * y) - half[0], 0.0)
        aside = np.maximum(np.abs(c * y - s * x) - half[1], 0.0)
        gap[disc] = np.hypot(ahead, aside) - axes[disc, 0]
    other = ~disc
    if other.any():  # each pair by itself, seen along the ellipse's axes
        (x, y), angle = away[other].T, turned[other]
        c, s = np.cos(angle), np.sin(angle)
        seen = np.column_stack([c * x + s * y, c * y - s * x, headings[other] - angle])
        flat = np.zeros((len(seen), 1, 2))
        gap[other] = box_gap(seen, half, flat, axes[other][:, None], np.zeros(1))[:, 0]
    return np.where(np.isfinite(gap), gap, -np.inf)


def along(poses: Array, index: Array) -> Array:
    """Poses (N, 3) at fractional indices (N,) of a polyline (K, 3)."""
    whole = np.arange(len(poses))
    return np.column_stack([np.interp(index, whole, axis) for axis in poses.T])


def refined(poses: Array, half: Array) -> Array:
    """Fractional indices (N,) of a polyline (K, 3), all whole ones among them.

    No point of the box, half (2,) [m], moves by more than SPACING between two of them.
    """
    steps = np.abs(np.diff(poses, axis=0))
    moved = np.hypot(steps[:, 0], steps[:, 1]) + math.hypot(*half) * steps[:, 2]
    return _divided(np.arange(len(poses), dtype=np.float64), np.ceil(moved / SPACING))


def _divided(knots: Array, parts: Array) -> Array:
    """Each span between two knots in so many equal parts, at least one."""
    count = np.maximum(parts, 1.0).astype(np.intp)
    share = (np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)) / np.repeat(
        count, count
    )
    inner = np.repeat(knots[:-1], count) + share * np.repeat(np.diff(knots), count)
    return np.append(inner, knots[-1])
