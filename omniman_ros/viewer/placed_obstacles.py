"""The obstacles that the page has placed: ellipses that move along their paths."""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core import plausible
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.planning.cases import TwoVelocityPath
from omniman_ros.viewer import obstacle_paths
from omniman_ros.viewer.obstacle_paths import ObstaclePath, PathKind, WaypointPath

Pair = tuple[float, float]  #: x, y: a position [m], a velocity [m/s] or semi-axes [m]


DEFAULT_RADIUS = 0.25  #: Radius of a new obstacle [m]
MIN_SEMI_AXIS = 0.02  #: Smallest semi-axis of an obstacle [m]
MAX_SEMI_AXIS = 5.0  #: Largest semi-axis of an obstacle [m]
MAX_VELOCITY = 3.0  #: Largest velocity of an obstacle, in x and in y [m/s]
MAX_OBSTACLES = 100  #: Largest number of obstacles of a page; further ones are refused


@dataclass(frozen=True)
class PlacedObstacle:
    """One obstacle."""

    number: int  #: Identifier, which is never used again
    semi_axes: Pair  #: Semi-axes along the obstacle's x and y axes [m]
    angle: float  #: Direction of the obstacle's x axis in `odom` [rad]
    home: ObstaclePath  #: Path that the obstacle follows from a restart on
    path: ObstaclePath  #: Path that the obstacle follows now, over the time since `since`
    since: float  #: Start of `path` in the obstacles' own time [s]

    def position(self, time: float) -> Pair:
        """Return the position (x, y) [m] at a time of the obstacles' own clock [s]."""
        x, y = self.path(time - self.since).tolist()
        return x, y

    def velocity(self, time: float) -> Pair:
        """Return the velocity (x, y) [m/s] at a time of the obstacles' own clock [s]."""
        return obstacle_paths.velocity(self.path, time - self.since)


@dataclass(frozen=True)
class ObstacleArrays:
    """All obstacles at one instant, in `odom`."""

    numbers: NDArray[np.int64]  #: (M,) identifiers
    centers: Array  #: (M, 2) positions [m]
    semi_axes: Array  #: (M, 2) semi-axes [m]
    angles: Array  #: (M,) directions of their x axes [rad]
    velocities: Array  #: (M, 2) velocities [m/s]; zero while the obstacles are paused
    resumed_velocities: Array | None = None  #: (M, 2) velocities after a pause; None: `velocities`
    placed: tuple[PlacedObstacle, ...] = ()  #: The M obstacles themselves

    @staticmethod
    def empty() -> "ObstacleArrays":
        """Return the arrays of no obstacle."""
        flat = np.zeros((0, 2))
        return ObstacleArrays(np.zeros(0, dtype=np.int64), flat, flat, np.zeros(0), flat)


class PlacedObstacles:
    """Obstacles that can be added, moved, resized, paused and moved back to their homes.

    They have a clock of their own, which stands still while they are paused. A change raises an
    InputError, and has no effect, if there is no such obstacle, or if a value is out of range.
    """

    def __init__(self) -> None:
        self._obstacles: dict[int, PlacedObstacle] = {}
        self._next_number = 0
        self._started_at = 0.0
        self._paused_time: float | None = None

    def __len__(self) -> int:
        return len(self._obstacles)

    def __contains__(self, number: object) -> bool:
        return number in self._obstacles

    def __getitem__(self, number: int) -> PlacedObstacle:
        """Return the obstacle of a number."""
        if number not in self._obstacles:
            raise InputError(f"there is no obstacle {number}")
        return self._obstacles[number]

    @property
    def paused(self) -> bool:
        """Whether all obstacles are paused."""
        return self._paused_time is not None

    def time(self, now: float) -> float:
        """Return the obstacles' own time [s] at a time `now` of any steady clock [s]."""
        return now - self._started_at if self._paused_time is None else self._paused_time

    def pause(self, now: float) -> None:
        """Pause all obstacles where they are."""
        self._paused_time = self.time(now)

    def resume(self, now: float) -> None:
        """Let all obstacles continue."""
        if self._paused_time is not None:
            self._started_at, self._paused_time = now - self._paused_time, None

    def restart(self, now: float) -> None:
        """Move all obstacles back to their homes; if they are paused, they remain so."""
        paused = self.paused
        self._started_at, self._paused_time = now, 0.0 if paused else None
        self._obstacles = {
            number: replace(obstacle, path=obstacle.home, since=0.0)
            for number, obstacle in self._obstacles.items()
        }

    def add(
        self,
        path: ObstaclePath,
        now: float,
        semi_axes: Pair = (DEFAULT_RADIUS, DEFAULT_RADIUS),
        angle: float = 0.0,
    ) -> int:
        """Add an obstacle whose path begins now, and return its number."""
        if len(self) >= MAX_OBSTACLES:
            raise InputError(f"there must be at most {MAX_OBSTACLES} obstacles")
        number = self._next_number
        self._store(PlacedObstacle(number, semi_axes, angle, path, path, self.time(now)))
        self._next_number += 1
        return number

    def move(self, number: int, position: Pair, now: float) -> None:
        """Move an obstacle to a position [m], where its whole path now begins, at its start."""
        obstacle = self[number]
        path = obstacle_paths.moved(obstacle.home, position)
        self._store(replace(obstacle, home=path, path=path, since=self.time(now)))

    def set_velocity(self, number: int, velocity: Pair, now: float) -> None:
        """Set the velocity (x, y) of an obstacle [m/s], for now and after a restart.

        A turn that it is to make comes its time after this change.
        """
        home = self[number].home
        if isinstance(home, WaypointPath):
            raise InputError(f"obstacle {number} follows way points: set its speed instead")
        self.set_path(number, replace(home, velocity=velocity), now)

    def set_motion(self, number: int, motion: PathKind, now: float) -> None:
        """Change the kind of motion of an obstacle, see :func:`obstacle_paths.converted`."""
        obstacle, time = self[number], self.time(now)
        position, velocity = obstacle.position(time), obstacle.velocity(time)
        path = obstacle_paths.converted(obstacle.home, position, velocity, motion)
        self.set_path(number, path, now)

    def set_path(self, number: int, path: ObstaclePath, now: float) -> None:
        """Set the path that an obstacle follows, for now and after a restart.

        Until a restart, it begins where the obstacle is; way points are followed from the place
        on their lines that is nearest to the obstacle.
        """
        obstacle, time = self[number], self.time(now)
        position = obstacle.position(time)
        if isinstance(path, WaypointPath):
            since = time - path.time_nearest(position)
            self._store(replace(obstacle, home=path, path=path, since=since))
        else:
            path_from_here = replace(path, position=position)
            self._store(replace(obstacle, home=path, path=path_from_here, since=time))

    def add_waypoint(self, number: int, position: Pair, now: float) -> None:
        """Append a way point (x, y) [m] to the path of an obstacle."""
        home = self[number].home
        if not isinstance(home, WaypointPath):
            raise InputError(f"obstacle {number} does not follow way points")
        self.set_path(number, replace(home, points=(*home.points, position)), now)

    def resize(self, number: int, semi_axes: Pair, angle: float) -> None:
        """Set the semi-axes [m] and the heading [rad] of an obstacle."""
        self._store(replace(self[number], semi_axes=semi_axes, angle=angle))

    def delete(self, number: int | None) -> None:
        """Delete an obstacle, or all of them if `number` is None."""
        if number is None:
            self._obstacles.clear()
        else:
            self._obstacles.pop(number, None)

    def arrays(self, now: float) -> ObstacleArrays:
        """Return all obstacles at a time `now` of the steady clock [s]."""
        obstacles, time = list(self._obstacles.values()), self.time(now)
        if not obstacles:
            return ObstacleArrays.empty()
        velocities = np.array([obstacle.velocity(time) for obstacle in obstacles])
        return ObstacleArrays(
            np.array([obstacle.number for obstacle in obstacles]),
            np.array([obstacle.position(time) for obstacle in obstacles]),
            np.array([obstacle.semi_axes for obstacle in obstacles]),
            np.array([obstacle.angle for obstacle in obstacles]),
            np.zeros_like(velocities) if self.paused else velocities,
            velocities,
            tuple(obstacles),
        )

    def _store(self, obstacle: PlacedObstacle) -> None:
        if not all(MIN_SEMI_AXIS <= axis <= MAX_SEMI_AXIS for axis in obstacle.semi_axes):
            raise InputError(
                f"semi-axes {obstacle.semi_axes} must be within "
                f"{MIN_SEMI_AXIS:g} to {MAX_SEMI_AXIS:g} m"
            )
        for path in (obstacle.home, obstacle.path):
            if isinstance(path, TwoVelocityPath):
                plausible.demand(np.array(path.position), plausible.LENGTH, "position")
                plausible.demand(np.array([path.velocity, path.then]), MAX_VELOCITY, "velocity")
                if not path.time >= 0.0:
                    raise InputError(f"time {path.time} of a turn must be at least 0 s")
        if not math.isfinite(obstacle.angle):
            raise InputError(f"angle {obstacle.angle} must be finite")
        self._obstacles[obstacle.number] = obstacle
