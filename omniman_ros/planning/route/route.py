"""Route over (x, y, heading): straight pieces, timed by the speeds of the robot."""

import math
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np

from omniman_ros.collision.footprint import Footprint
from omniman_ros.core import plausible, se2
from omniman_ros.core.arrays import Array, Shape
from omniman_ros.core.errors import InputError
from omniman_ros.core.validated import Validated
from omniman_ros.planning.obstacles.clearance import Clearance
from omniman_ros.planning.obstacles.separation import Workspace
from omniman_ros.surroundings.ellipses import Ellipses

#: Largest distance that a point of the robot moves between two poses that are checked [m]
SPACING = 0.02
MAX_PIECE_ROTATION = 0.5  #: Rotation above which a piece is divided for the projection [rad]
HEADING_ERROR_LENGTH = 0.3  #: Distance that counts as much as a heading error of one radian [m]
WINDOW_BACK = 0.5  #: Part of the route before the last position in which a pose is searched [s]
WINDOW_AHEAD = 2.0  #: Part of the route after the last position in which a pose is searched [s]
SAME_TIME = 1e-9  #: Difference below which times count as equal [s]
GAP_RESERVE = 0.01  #: Difference above the margin up to which gaps are distinguished [m]


@dataclass(frozen=True)
class Route(Validated):
    """Poses joined by straight lines in (x, y, heading), from a start to a goal.

    A position along it is the shortest time of travel from its start [s]: translation and rotation
    happen at the same time, the slower of the two at its speed.

    Raises:
        InputError: There is no pose, a pose is not finite or implausibly large, or a speed is not
            above zero.
    """

    #: (K, 3) poses of base_link in odom, K >= 1, headings not wrapped [m, m, rad]
    poses: Annotated[Array, Shape("K", 3)]
    speeds: tuple[float, float]  #: Linear [m/s] and angular speed [rad/s] for the times
    times: Array = field(init=False)  #: (K,) times of the poses, from 0 on [s]

    def __post_init__(self) -> None:
        super().__post_init__()
        poses = self.poses
        if not len(poses):
            raise InputError(f"route: poses have shape {poses.shape}, expected at least one")
        plausible.demand(poses[:, :2], plausible.LENGTH, "route: position")
        plausible.demand(poses[:, 2], plausible.ANGLE, "route: heading")
        if not min(self.speeds) > 0.0:
            raise InputError(f"route: speeds {self.speeds} m/s, rad/s must be above 0")
        times = np.concatenate([[0.0], np.cumsum(durations(np.diff(poses, axis=0), self.speeds))])
        times.setflags(write=False)
        object.__setattr__(self, "times", times)

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

    def between(self, first: float, last: float) -> "Route":
        """Return the part between two positions [s], the second one not before the first."""
        inner = (self.times > first + SAME_TIME) & (self.times < last - SAME_TIME)
        begin, end = self.at(np.array([first, last]))
        return Route(np.vstack([begin, self.poses[inner], end]), self.speeds)

    def project(
        self,
        pose: Array,
        near: float | None = None,
        window: tuple[float, float] = (WINDOW_BACK, WINDOW_AHEAD),
    ) -> float:
        """Return the position along the route that is nearest to a pose on any branch [s].

        The measure combines the distance and LEVER times the heading error; the first of equally
        near positions counts. Only a window before and after the last position `near` is searched,
        so that the result does not jump if the route passes again, or behind a wall. None means
        the whole route.

        Args:
            pose: (3,) pose in odom [m, m, rad]; its heading may be on any branch.
        """
        first, last = 0.0, self.duration
        if near is not None:
            near = min(max(near, 0.0), last)
            first, last = max(near - window[0], 0.0), min(near + window[1], last)
        knots = self._knots(first, last)
        points = self.at(knots)
        steps = np.diff(points, axis=0) * [1.0, 1.0, HEADING_ERROR_LENGTH]
        offset = pose - points[:-1]
        # The heading changes little within a part: the branch at its start is the right one.
        offset[:, 2] = HEADING_ERROR_LENGTH * (
            np.remainder(offset[:, 2] + math.pi, math.tau) - math.pi
        )
        squares = (steps * steps).sum(axis=1)
        along = (offset * steps).sum(axis=1)
        fraction = np.clip(along / np.maximum(squares, np.finfo(float).tiny), 0.0, 1.0)
        remainder = offset - fraction[:, None] * steps
        best = int(np.argmin((remainder * remainder).sum(axis=1)))
        return float(knots[best] + fraction[best] * (knots[best + 1] - knots[best]))

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
        """Return whether the robot keeps a gap of more than a margin [m] on a part of the route.

        Obstacles count as being at rest at their centres; the part is between two positions [s].
        """
        _, poses = self.samples(footprint.radius, first, last)
        clearance = Clearance(footprint, around, workspace, margin + GAP_RESERVE)
        return bool((clearance.gaps(poses) > margin).all())

    def _knots(self, first: float, last: float) -> Array:
        """Return positions [s] of a part's ends, of poses between, and within large rotations."""
        inner = self.times[(self.times > first + SAME_TIME) & (self.times < last - SAME_TIME)]
        knots = np.concatenate([[first], inner, [last]])
        rotations = np.abs(np.diff(self.at(knots)[:, 2]))
        return _divided(knots, np.ceil(rotations / MAX_PIECE_ROTATION))


def straight(start: Array, goal: Array, speeds: tuple[float, float]) -> Route:
    """Return the straight line from pose to pose (3,), with the shorter rotation."""
    rotation = se2.wrap(float(goal[2] - start[2]))
    end = np.array([goal[0], goal[1], start[2] + rotation])
    return Route(np.stack([start, end]), speeds)


def durations(steps: Array, speeds: tuple[float, float]) -> Array:
    """Return the shortest times (N,) [s] of steps (N, 3) [m, m, rad] at speeds [m/s, rad/s]."""
    distance = np.hypot(steps[:, 0], steps[:, 1])
    result: Array = np.maximum(distance / speeds[0], np.abs(steps[:, 2]) / speeds[1])
    return result


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
    fraction = (np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)) / np.repeat(
        count, count
    )
    inner = np.repeat(knots[:-1], count) + fraction * np.repeat(np.diff(knots), count)
    return np.append(inner, knots[-1])
