"""Paths that the obstacles of the page follow: straight on, with one turn, or along way points."""

import math
from dataclasses import dataclass, replace
from enum import Enum
from functools import cached_property

import numpy as np

from omniman_ros.core import plausible
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.planning.cases import TwoVelocityPath

Pair = tuple[float, float]  #: x, y: a position [m] or a velocity [m/s]

MIN_SPEED = 0.05  #: Smallest speed along way points [m/s]
MAX_SPEED = 3.0  #: Largest speed along way points [m/s]
MAX_WAYPOINTS = 50  #: Largest number of way points of an obstacle
DEFAULT_SPEED = 0.5  #: Speed along way points of an obstacle that stood still before [m/s]
DEFAULT_REVOLUTION_TIME = 3.0  #: Time after which an obstacle turns, until another is entered [s]
MIN_SHOWN_ROTATION = 2.0  #: Time for which the course after a turn is drawn [s]


class PathKind(Enum):
    """Kinds of paths."""

    STRAIGHT = "straight"
    ONE_TURN = "one turn"
    WAYPOINTS = "way points"


class AtEnd(Enum):
    """What an obstacle does when it has reached its last way point."""

    LOOP = "loop"
    BACK_AND_FORTH = "back and forth"
    ONCE = "once"


@dataclass(frozen=True)
class WaypointPath:
    """Path of a point that passes way points at a constant speed, on straight lines.

    It stands still if all its way points coincide.

    Raises:
        InputError: There are no or too many points, one is not plausible, or the speed is out of
            range.
    """

    #: Positions (x, y) in `odom` in the order of passing [m]; the path begins at the first one
    points: tuple[Pair, ...]
    speed: float = DEFAULT_SPEED  #: Speed [m/s]
    at_end: AtEnd = AtEnd.LOOP  #: Whether it then goes to the first point, back, or stops

    def __post_init__(self) -> None:
        if not 1 <= len(self.points) <= MAX_WAYPOINTS:
            raise InputError(f"{len(self.points)} way points must be 1 to {MAX_WAYPOINTS}")
        plausible.demand(np.array(self.points), plausible.LENGTH, "way points")
        if not MIN_SPEED <= self.speed <= MAX_SPEED:
            raise InputError(
                f"speed {self.speed} must be within {MIN_SPEED:g} to {MAX_SPEED:g} m/s"
            )

    @property
    def position(self) -> Pair:
        """Position (x, y) at time 0 [m]."""
        return self.points[0]

    @cached_property
    def course(self) -> Array:
        """Corners (k, 2) of one round, k >= 2, until the path ends or repeats itself [m]."""
        closing = {
            AtEnd.LOOP: self.points[:1],
            AtEnd.BACK_AND_FORTH: self.points[-2::-1],
            AtEnd.ONCE: self.points[-1:],
        }[self.at_end]
        return np.array([*self.points, *(closing or self.points)])

    @cached_property
    def _arc_lengths(self) -> Array:
        """Arc length (k,) at each corner of the course [m]."""
        return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(self.course, axis=0).T))])

    def __call__(self, now: float) -> Array:
        """Return the position (2,) [m] at a time >= 0 [s]."""
        s = self._arc_length(now)
        return np.array([np.interp(s, self._arc_lengths, axis) for axis in self.course.T])

    def velocity_at(self, now: float) -> Pair:
        """Return the velocity (x, y) [m/s] at a time >= 0 [s]; at a corner, that after it."""
        s, arc_lengths = self._arc_length(now), self._arc_lengths
        if s >= arc_lengths[-1]:
            return 0.0, 0.0
        leg = int(np.searchsorted(arc_lengths, s, side="right"))
        begin, end = self.course[leg - 1], self.course[leg]
        vx, vy = self.speed * ((end - begin) / (arc_lengths[leg] - arc_lengths[leg - 1]))
        return float(vx), float(vy)

    def _arc_length(self, now: float) -> float:
        length = float(self._arc_lengths[-1])
        s = self.speed * now
        if self.at_end is AtEnd.ONCE or length == 0.0:
            return min(s, length)
        return s % length

    def time_nearest(self, position: Pair) -> float:
        """Return the first time at which the path is nearest to a position (x, y) [s]."""
        begin, legs = self.course[:-1], np.diff(self.course, axis=0)
        squares = np.maximum((legs**2).sum(axis=1), np.finfo(float).tiny)
        ratios = np.clip(((np.array(position) - begin) * legs).sum(axis=1) / squares, 0.0, 1.0)
        distances = np.hypot(*(begin + ratios[:, None] * legs - position).T)
        leg = int(distances.argmin())
        s = self._arc_lengths[leg] + ratios[leg] * math.sqrt(squares[leg])
        return float(s / self.speed)

    def moved_to(self, position: Pair) -> "WaypointPath":
        """Return the path with all way points shifted, so that it begins at `position` [m]."""
        dx, dy = position[0] - self.position[0], position[1] - self.position[1]
        return replace(self, points=tuple((x + dx, y + dy) for x, y in self.points))

    def with_point(self, index: int, point: Pair) -> "WaypointPath":
        """Return the path with the way point of an index >= 0 moved to another position [m]."""
        return replace(self, points=(*self.points[:index], point, *self.points[index + 1 :]))


ObstaclePath = TwoVelocityPath | WaypointPath  #: Path of an obstacle


def motion(path: ObstaclePath) -> PathKind:
    """Return the kind of a path."""
    if isinstance(path, WaypointPath):
        return PathKind.WAYPOINTS
    return PathKind.ONE_TURN if math.isfinite(path.time) else PathKind.STRAIGHT


def velocity(path: ObstaclePath, now: float) -> Pair:
    """Return the velocity (x, y) on a path [m/s] at a time [s]."""
    return path.velocity_at(now) if isinstance(path, WaypointPath) else path.speed(now)


def moved(path: ObstaclePath, position: Pair) -> ObstaclePath:
    """Return a path of the same shape that begins at another place (x, y) [m]."""
    if isinstance(path, WaypointPath):
        return path.moved_to(position)
    return replace(path, position=position)


def converted(
    home: ObstaclePath, position: Pair, velocity: Pair, wanted: PathKind
) -> ObstaclePath:
    """Return the path of an obstacle after its kind of motion was changed.

    Way points begin at its position, with this position as the only one. Otherwise it keeps its
    home and its velocity; a turn is one to the left by 90 degrees until another one is entered.

    Args:
        position: Its position (x, y) [m].
        velocity: Its velocity (x, y) [m/s].
    """
    if wanted is motion(home):
        return home
    if wanted is PathKind.WAYPOINTS:
        speed = math.hypot(*velocity)
        speed = min(max(speed, MIN_SPEED), MAX_SPEED) if speed > 0.0 else DEFAULT_SPEED
        return WaypointPath((position,), speed)
    if not isinstance(home, WaypointPath):
        velocity = home.velocity
    if wanted is PathKind.STRAIGHT:
        return TwoVelocityPath(home.position, velocity)
    return TwoVelocityPath(
        home.position, velocity, DEFAULT_REVOLUTION_TIME, (-velocity[1], velocity[0])
    )


def drawn_course(path: ObstaclePath) -> Array:
    """Return the corners (k, 2) of a path to be drawn on the floor [m].

    k is 0 for a straight path, which the arrow of the velocity shows. After a turn, the next
    `MIN_SHOWN_ROTATION` are drawn.
    """
    if isinstance(path, WaypointPath):
        return path.course
    if not math.isfinite(path.time):
        return np.zeros((0, 2))
    return np.array([path(time) for time in (0.0, path.time, path.time + MIN_SHOWN_ROTATION)])
