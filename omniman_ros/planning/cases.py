"""The three test cases of MPC 2021, section 4: start, goal and obstacles.

The paper shows its cases in figures only. They are interpreted as follows:

* free: 6 m nearly sideways, the same heading at both ends, no obstacles.
* corridor: four circles; the gaps between neighbours are wider than the robot is wide, and
  narrower than it is long.
* moving: four circles that cross the path from both sides; the third changes its velocity.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from omniman_ros.core.arrays import Array

Pose = tuple[float, float, float]  #: Pose x, y, heading in `odom` [m, m, rad]

LENGTH = 0.8  #: Length of the robot that the cases are made for [m]
WIDTH = 0.5  #: Width of the robot that the cases are made for [m]
RADIUS = 0.3  #: Radius of all obstacles [m]
GAP = 0.72  #: Gap between neighbours in the corridor case [m]
LEAN = 0.5  #: Angle of the corridor's row of circles from the y axis [rad]
#: Direction of the goal of the free case, as seen from the robot [rad]
SIDEWAYS = math.radians(70.0)


@dataclass(frozen=True)
class TwoVelocityPath:
    """Path of a point that moves at one velocity until a time, then at another one."""

    position: tuple[float, float]  #: (x, y) at time 0 [m]
    velocity: tuple[float, float] = (0.0, 0.0)  #: (x, y) velocity from time 0 on [m/s]
    time: float = math.inf  #: Time at which the velocity changes [s]; infinity if it never does
    then: tuple[float, float] = (0.0, 0.0)  #: (x, y) velocity from that time on [m/s]

    def __call__(self, now: float) -> Array:
        """Return the position (2,) [m] at a time [s]."""
        before = min(now, self.time)
        after = max(now - self.time, 0.0) if math.isfinite(self.time) else 0.0
        result: Array = (
            np.array(self.position)
            + before * np.array(self.velocity)
            + after * np.array(self.then)
        )
        return result

    def speed(self, now: float) -> tuple[float, float]:
        """Return the velocity (x, y) [m/s] at a time [s]."""
        return self.velocity if now < self.time else self.then


@dataclass(frozen=True)
class PlanningCase:
    """A test case."""

    name: str  #: Name of the case
    start: Pose  #: Pose of the robot at the start, in odom [m, m, rad]
    goal: Pose  #: Goal of the robot, in odom [m, m, rad]
    paths: tuple[TwoVelocityPath, ...] = ()  #: Paths of the obstacles, which are circles
    radius: float = RADIUS  #: Radius of the obstacles [m]

    def fitting(self, length: float, width: float) -> "PlanningCase":
        """Return the case for a robot of another size [m]: lengths and speeds scale with it."""
        factor = max(length / LENGTH, width / WIDTH)
        paths = tuple(
            TwoVelocityPath(
                _times(path.position, factor),
                _times(path.velocity, factor),
                path.time,
                _times(path.then, factor),
            )
            for path in self.paths
        )
        start, goal = ((*_times(pose[:2], factor), pose[2]) for pose in (self.start, self.goal))
        return PlanningCase(self.name, start, goal, paths, factor * self.radius)


def _times(pair: tuple[float, float], factor: float) -> tuple[float, float]:
    return pair[0] * factor, pair[1] * factor


def _row() -> tuple[TwoVelocityPath, ...]:
    """Return an oblique row of four circles across the path: the robot fits through lengthwise."""
    along = np.array([math.sin(LEAN), math.cos(LEAN)])
    first = np.array([2.0, 0.1]) - 1.5 * (GAP + 2.0 * RADIUS) * along
    centres = [first + k * (GAP + 2.0 * RADIUS) * along for k in range(4)]
    return tuple(TwoVelocityPath((float(x), float(y))) for x, y in centres)


_CROSSING = (
    TwoVelocityPath((1.8, 1.6), (0.0, -0.45)),
    TwoVelocityPath((3.0, -2.2), (0.0, 0.45)),
    # This obstacle suddenly moves into the robot's path.
    TwoVelocityPath((4.4, 1.7), (0.0, -0.15), 4.5, (0.0, -0.9)),
    TwoVelocityPath((5.4, -3.4), (0.0, 0.5)),
)  #: Paths of the obstacles of the moving case

CASES: Mapping[str, PlanningCase] = MappingProxyType(
    {
        case.name: case
        for case in (
            # 6 m, so that the robot still drives in the paper's last snapshot.
            PlanningCase("free", (0.0, 0.0, -SIDEWAYS), (6.0, 0.0, -SIDEWAYS)),
            PlanningCase("corridor", (0.0, 0.0, 0.0), (4.5, 0.0, 0.0), _row()),
            PlanningCase("moving", (0.0, 0.0, 0.0), (6.5, 0.0, 0.0), _CROSSING),
        )
    }
)  #: Test cases by name
