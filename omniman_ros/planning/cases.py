"""The three test cases of MPC 2021, section 4: where the robot begins, its goal, what is around.

The paper gives its cases as pictures only. Read here as:

* free: 6 m nearly sideways, the same heading at both ends, nothing in the way.
* corridor: four circles, the gaps between neighbours wider than the robot and shorter than it.
* moving: four circles that cross the way from both sides; the third changes its velocity.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Pose = tuple[float, float, float]
"""x, y [m], heading [rad] in `odom`."""

LENGTH, WIDTH = 0.8, 0.5
"""Of the robot that the cases are made for [m]."""
RADIUS = 0.3
"""Of all obstacles [m]."""
GAP = 0.72
"""Between neighbours of the corridor case: wider than the robot, shorter than it [m]."""
LEAN = 0.5
"""Angle of the corridor's row of circles from the y axis [rad]."""
SIDEWAYS = math.radians(70.0)
"""Direction of the goal of the free case, as seen from the robot [rad]."""


@dataclass(frozen=True)
class Turned:
    """Where something is that goes at one velocity until a time, then at another.

    Attributes:
        place, velocity: (x, y) at time 0 [m], and per second.
        time: When the velocity changes [s]; infinity for never.
        then: The velocity from then on [m/s].
    """

    place: tuple[float, float]
    velocity: tuple[float, float] = (0.0, 0.0)
    time: float = math.inf
    then: tuple[float, float] = (0.0, 0.0)

    def __call__(self, now: float) -> Array:
        """Its centre (2,) at a time [s]."""
        before = min(now, self.time)
        after = max(now - self.time, 0.0) if math.isfinite(self.time) else 0.0
        result: Array = (
            np.array(self.place) + before * np.array(self.velocity) + after * np.array(self.then)
        )
        return result

    def speed(self, now: float) -> tuple[float, float]:
        """Its velocity (x, y) at a time [m/s]."""
        return self.velocity if now < self.time else self.then


@dataclass(frozen=True)
class Case:
    """A test case.

    Attributes:
        name: Of the case.
        start, goal: Poses in odom [m, m, rad].
        ways: Where the obstacles, circles, are and go.
        radius: Of the circles [m].
    """

    name: str
    start: Pose
    goal: Pose
    ways: tuple[Turned, ...] = ()
    radius: float = RADIUS

    def fitting(self, length: float, width: float) -> "Case":
        """The case for a robot of another size [m]: all lengths and speeds grow with it."""
        factor = max(length / LENGTH, width / WIDTH)
        ways = tuple(
            Turned(_times(way.place, factor), _times(way.velocity, factor), way.time,
                   _times(way.then, factor))
            for way in self.ways
        )  # fmt: skip
        start, goal = ((*_times(pose[:2], factor), pose[2]) for pose in (self.start, self.goal))
        return Case(self.name, start, goal, ways, factor * self.radius)


def _times(pair: tuple[float, float], factor: float) -> tuple[float, float]:
    return pair[0] * factor, pair[1] * factor


def _row() -> tuple[Turned, ...]:
    """A leaning row of four circles across the way: the robot fits through lengthwise only."""
    along = np.array([math.sin(LEAN), math.cos(LEAN)])
    first = np.array([2.0, 0.1]) - 1.5 * (GAP + 2.0 * RADIUS) * along
    places = [first + k * (GAP + 2.0 * RADIUS) * along for k in range(4)]
    return tuple(Turned((float(x), float(y))) for x, y in places)


_CROSSING = (
    Turned((1.8, 1.6), (0.0, -0.45)),
    Turned((3.0, -2.2), (0.0, 0.45)),
    # This one darts down where the robot would pass.
    Turned((4.4, 1.7), (0.0, -0.15), 4.5, (0.0, -0.9)),
    Turned((5.4, -3.4), (0.0, 0.5)),
)

CASES: Mapping[str, Case] = MappingProxyType(
    {
        case.name: case
        for case in (
            # 6 m, so that the robot still drives in the paper's last snapshot.
            Case("free", (0.0, 0.0, -SIDEWAYS), (6.0, 0.0, -SIDEWAYS)),
            Case("corridor", (0.0, 0.0, 0.0), (4.5, 0.0, 0.0), _row()),
            Case("moving", (0.0, 0.0, 0.0), (6.5, 0.0, 0.0), _CROSSING),
        )
    }
)
"""By name."""
