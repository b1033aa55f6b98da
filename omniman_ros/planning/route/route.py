"""Route over (x, y, heading): straight pieces, timed by the speeds of the robot."""

import math
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from omniman_ros.collision.footprint import Footprint
from omniman_ros.collision.rectangles import Rectangles
from omniman_ros.core import plausible, se2
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.planning.obstacles.ellipses import Ellipses
from omniman_ros.planning.obstacles.pairs import Pairs
from omniman_ros.planning.obstacles.separation import Workspace, box_gap, outside_by

Index = NDArray[np.intp]
"""Array of indices of obstacles."""

SPACING = 0.02
"""Largest distance that a point of the robot moves between two poses that are checked [m]."""
FINE_TURN = 0.5
"""Rotation above which a piece is divided for the projection [rad]."""
LEVER = 0.3
"""Distance that counts as much as a heading error of one radian [m]."""
WINDOW_BACK = 0.5
"""Part of the route before the last position in which a pose is searched [s]."""
WINDOW_AHEAD = 2.0
"""Part of the route after the last position in which a pose is searched [s]."""
SAME_TIME = 1e-9
"""Difference below which times count as equal [s]."""
PAIRS = 50_000
"""Number of pairs of pose and obstacle that are processed together, to limit memory."""
UNTILED_OBSTACLES = 20
"""Number of obstacles above which these are looked up by tiles."""
TILE = 0.5
"""Edge of the tiles [m]."""
WIDE_TILE = 4.0
"""Edge of the tiles from which those are made [m]."""
REACH_RESERVE = 0.01
"""Difference above the margin up to which gaps are distinguished [m]."""


@dataclass(frozen=True)
class Route:
    """Poses joined by straight lines in (x, y, heading), from a start to a goal.

    A position along it is the shortest time of travel from its start [s]: translation and rotation
    happen at the same time, the slower of the two at its speed.

    Attributes:
        poses: (K, 3) poses of base_link in odom, K >= 1, headings not wrapped [m, m, rad].
        speeds: Linear [m/s] and angular speed [rad/s] for the times.
        times: (K,) times of the poses, from 0 on [s].

    Raises:
        InputError: There is no pose, a pose is not finite or implausibly large, or a speed is not
            above zero.
    """

    poses: Array
    speeds: tuple[float, float]
    times: Array = field(init=False)

    def __post_init__(self) -> None:
        poses = np.array(self.poses, dtype=np.float64)
        if poses.ndim != 2 or poses.shape[1] != 3 or not len(poses):
            raise InputError(f"route: poses have shape {poses.shape}, expected (K, 3)")
        plausible.demand(poses[:, :2], plausible.LENGTH, "route: position")
        plausible.demand(poses[:, 2], plausible.ANGLE, "route: heading")
        if not all(0.0 < speed < math.inf for speed in self.speeds):
            raise InputError(f"route: speeds {self.speeds} m/s, rad/s must be above 0")
        times = np.concatenate([[0.0], np.cumsum(durations(np.diff(poses, axis=0), self.speeds))])
        for name, value in (("poses", poses), ("times", times)):
            value.setflags(write=False)
            object.__setattr__(self, name, value)

    @property
    def duration(self) -> float:
        """Shortest time of travel from start to goal [s]."""
        return float(self.times[-1])

    @property
    def length(self) -> float:
        """Length of the path of base_link [m]."""
        return self.length_from(0.0)

    def length_from(self, time: float) -> float:
        """Return the length of the path [m] of base_link from a position on the route [s] on."""
        ahead = np.vstack([self.at(np.array([time])), self.poses[self.times > time]])
        steps = np.diff(ahead[:, :2], axis=0)
        return float(np.hypot(steps[:, 0], steps[:, 1]).sum())

    def at(self, times: Array) -> Array:
        """Return poses (N, 3) at positions (N,) along the route [s]; its ends beyond them."""
        return np.column_stack([np.interp(times, self.times, axis) for axis in self.poses.T])

    def project(
        self,
        pose: Array,
        near: float | None = None,
        window: tuple[float, float] = (WINDOW_BACK, WINDOW_AHEAD),
    ) -> float:
        """Return the position along the route that is nearest to a pose.

        The measure combines the distance and LEVER times the heading error.

        Args:
            pose: (3,) pose in odom [m, m, rad]; its heading may be on any branch.
            near: Last position [s]; only a window around it is searched, so that the result does
                not jump if the route passes again, or behind a wall. None means the whole route.
            window: Extent of the window before and after it [s].

        Returns:
            Position [s], the first of equally near ones.
        """
        first, last = 0.0, self.duration
        if near is not None:
            near = min(max(near, 0.0), last)
            first, last = max(near - window[0], 0.0), min(near + window[1], last)
        knots = self._knots(first, last)
        points = self.at(knots)
        steps = np.diff(points, axis=0) * [1.0, 1.0, LEVER]
        offset = pose - points[:-1]
        # The heading changes little within a part: the branch at its start is the right one.
        offset[:, 2] = LEVER * (np.remainder(offset[:, 2] + math.pi, math.tau) - math.pi)
        squares = (steps * steps).sum(axis=1)
        along = (offset * steps).sum(axis=1)
        share = np.clip(along / np.maximum(squares, np.finfo(float).tiny), 0.0, 1.0)
        remainder = offset - share[:, None] * steps
        best = int(np.argmin((remainder * remainder).sum(axis=1)))
        return float(knots[best] + share[best] * (knots[best + 1] - knots[best]))

    def samples(
        self, radius: float, first: float = 0.0, last: float = math.inf
    ) -> tuple[Array, Array]:
        """Return positions (N,) [s] and poses (N, 3) of a part of the route.

        No point within `radius` [m] of base_link moves by more than SPACING between two of them.
        """
        first = min(max(first, 0.0), self.duration)
        last = max(min(last, self.duration), first)
        knots = self._knots(first, last)
        fine = refined(self.at(knots), radius)
        return np.interp(fine, np.arange(len(knots)), knots), along(self.at(knots), fine)

    def clear(
        self,
        footprint: Footprint,
        around: Ellipses,
        workspace: Workspace,
        margin: float = 0.0,
        first: float = 0.0,
        last: float = math.inf,
    ) -> bool:
        """Return whether the robot keeps a gap on a part of the route.

        Args:
            footprint: Outline of the robot.
            around: Obstacles, which count as being at rest at their centres.
            workspace: (x_min, y_min, x_max, y_max) in odom [m].
            margin: Gap that both must exceed on all of the part [m].
            first: Position at which the part begins [s].
            last: Position at which it ends [s].
        """
        _, poses = self.samples(footprint.radius, first, last)
        clearance = Clearance(footprint, around, workspace, margin + REACH_RESERVE)
        return bool((clearance.gaps(poses) > margin).all())

    def _knots(self, first: float, last: float) -> Array:
        """Return positions [s] of a part's ends, of poses between, and within large rotations."""
        inner = self.times[(self.times > first + SAME_TIME) & (self.times < last - SAME_TIME)]
        knots = np.concatenate([[first], inner, [last]])
        rotations = np.abs(np.diff(self.at(knots)[:, 2]))
        return _divided(knots, np.ceil(rotations / FINE_TURN))


def straight(start: Array, goal: Array, speeds: tuple[float, float]) -> Route:
    """Return the straight line from pose to pose (3,), with the shorter rotation.

    Raises:
        InputError: See `Route`.
    """
    rotation = se2.wrap(float(goal[2] - start[2]))
    end = np.array([goal[0], goal[1], start[2] + rotation])
    return Route(np.stack([start, end]), speeds)


def durations(steps: Array, speeds: tuple[float, float]) -> Array:
    """Return the shortest times (N,) [s] of steps (N, 3) [m, m, rad] at speeds [m/s, rad/s]."""
    distance = np.hypot(steps[:, 0], steps[:, 1])
    result: Array = np.maximum(distance / speeds[0], np.abs(steps[:, 2]) / speeds[1])
    return result


class Clearance:
    """Gaps between the robot and static obstacles, fast for many poses among many obstacles.

    Obstacles are looked up by tiles of the ground, each created for the first pose on it.

    Args:
        footprint: Outline of the robot.
        around: M obstacles, which count as being at rest at their centres.
        workspace: (x_min, y_min, x_max, y_max) in odom [m].
        reach: Distance above which obstacles may be ignored [m].
    """

    def __init__(
        self,
        footprint: Footprint,
        around: Ellipses,
        workspace: Workspace,
        reach: float = math.inf,
    ) -> None:
        pairs = Pairs.of(footprint, around)
        self._whole, self._workspace = footprint.whole, workspace
        self._boxes, self._around = pairs.boxes, pairs.ellipses
        axes = self._around.semi_axes.max(axis=1, initial=0.0)
        self._size = axes + reach + self._boxes.radius
        self._tiled = len(pairs) > UNTILED_OBSTACLES and math.isfinite(reach)
        self._all = np.arange(len(pairs))
        self._tiles: dict[tuple[float, int, int], Index] = {}

    def gaps(self, poses: Array) -> Array:
        """Return the smallest gap at each pose.

        Args:
            poses: (K, 3) poses in odom [m, m, rad].

        Returns:
            (K,) smallest of `box_gap` and of the distance to the workspace's edge [m]; not above
            zero where the robot touches an obstacle or the edge.
        """
        result: Array = -outside_by(poses, self._whole, self._workspace)
        if not len(self._around):
            return result
        if not self._tiled or not np.isfinite(poses).all():
            size = max(16, PAIRS // len(self._around))
            for k in range(0, len(poses), size):
                self._lower(result[k : k + size], poses[k : k + size], self._all)
            return result
        tiles = np.floor(poses[:, :2] / TILE).astype(np.intp)
        changes = np.flatnonzero((np.diff(tiles, axis=0) != 0).any(axis=1)) + 1
        ends = [0, *changes.tolist(), len(poses)]
        for first, last in pairwise(ends):
            indices = self._tile(TILE, *tiles[first].tolist())
            if len(indices):
                self._lower(result[first:last], poses[first:last], indices)
        return result

    def _tile(self, edge: float, x: int, y: int) -> Index:
        """Return the indices of the obstacles within reach of any point of a tile."""
        key = edge, x, y
        if key not in self._tiles:
            indices = self._all
            if edge < WIDE_TILE:
                ratio = round(WIDE_TILE / edge)
                indices = self._tile(WIDE_TILE, x // ratio, y // ratio)
            size = self._size[indices]
            offset = np.abs(self._around.centers[indices] - edge * (np.array([x, y]) + 0.5))
            beyond = np.maximum(offset - 0.5 * edge, 0.0)
            self._tiles[key] = indices[(beyond * beyond).sum(axis=1) <= size * size]
        return self._tiles[key]

    def _lower(self, result: Array, poses: Array, indices: Index) -> None:
        """Lower gaps (K,) to those to the obstacles of these indices."""
        offset = poses[:, None, :2] - self._around.centers[indices]
        size = self._size[indices]
        near = ~((offset * offset).sum(axis=2) > size * size)  # NaN counts as near
        k, j = np.nonzero(near)
        if len(k):
            boxes = self._boxes.select(indices[j])
            gap = _pairs(offset[k, j], poses[k, 2], boxes, self._around, indices[j])
            np.minimum.at(result, k, gap)


def _pairs(
    offset: Array, headings: Array, boxes: Rectangles, obstacles: Ellipses, indices: Index
) -> Array:
    """Return gaps (N,) [m] of boxes, one or (N,), from obstacles of these indices (N,).

    Base_link is at offsets (N, 2) from the obstacles.
    """
    axes = obstacles.semi_axes[indices]
    angles = obstacles.angles[indices]
    gap = np.empty(len(offset))
    disc = axes[:, 0] == axes[:, 1]
    if disc.any():  # outside of a disc, this is the result of `box_gap`
        (x, y), heading = offset[disc].T, headings[disc]
        box = boxes.select(disc)
        c, s = np.cos(heading + box.yaw), np.sin(heading + box.yaw)
        ahead, beside = box.own_centre
        forward = np.maximum(np.abs(c * x + s * y + ahead) - box.half[..., 0], 0.0)
        lateral = np.maximum(np.abs(c * y - s * x + beside) - box.half[..., 1], 0.0)
        gap[disc] = np.hypot(forward, lateral) - axes[disc, 0]
    other = ~disc
    if other.any():  # each pair is expressed in the axes of its ellipse
        (x, y), angle = offset[other].T, angles[other]
        c, s = np.cos(angle), np.sin(angle)
        poses = np.column_stack([c * x + s * y, c * y - s * x, headings[other] - angle])
        centers = np.zeros((len(poses), 1, 2))
        box = boxes.select(other)
        if not box.is_single:  # a column
            box = box.select(np.arange(len(poses))[:, None])
        gap[other] = box_gap(poses, box, centers, axes[other][:, None], np.zeros(1))[:, 0]
    return np.where(np.isfinite(gap), gap, -np.inf)


def along(poses: Array, index: Array) -> Array:
    """Return poses (N, 3) at fractional indices (N,) of a polyline (K, 3)."""
    whole = np.arange(len(poses))
    return np.column_stack([np.interp(index, whole, axis) for axis in poses.T])


def refined(poses: Array, radius: float) -> Array:
    """Return fractional indices (N,) of a polyline (K, 3), all whole ones among them.

    No point within `radius` [m] of base_link moves by more than SPACING between two of them.
    """
    steps = np.abs(np.diff(poses, axis=0))
    moved = np.hypot(steps[:, 0], steps[:, 1]) + radius * steps[:, 2]
    return _divided(np.arange(len(poses), dtype=np.float64), np.ceil(moved / SPACING))


def _divided(knots: Array, parts: Array) -> Array:
    """Divide each span between two knots into a number of equal parts, at least one."""
    count = np.maximum(parts, 1.0).astype(np.intp)
    share = (np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)) / np.repeat(
        count, count
    )
    inner = np.repeat(knots[:-1], count) + share * np.repeat(np.diff(knots), count)
    return np.append(inner, knots[-1])
