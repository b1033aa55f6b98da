"""A drive as it was recorded: true poses, energy and true gaps, judged by the truth."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import OmnimanError
from omniman_ros.lab.studies.mpc_loop import Course, MovingObstacle
from omniman_ros.lab.studies.scene_gaps import wall_gap
from omniman_ros.lab.studies.scene_geometry import Box, Wall
from omniman_ros.planning.cases import Pose
from omniman_ros.planning.obstacles.separation import box_gap
from omniman_ros.planning.parameters import Arrival

SETTLE = 0.5
"""Time after the arrival during which consumed energy still counts [s]."""
AT_REST = 0.02
"""Speed below which the robot counts as being at rest, as for the planner [m/s, rad/s]."""
MOVING = 0.1
"""Speed above which the robot has a direction of travel [m/s]."""


class StudyError(OmnimanError):
    """A drive cannot be compared: its figures would mean nothing."""


@dataclass(frozen=True)
class Drive:
    """A recorded drive to a goal, with a row for each of K ticks of 5 ms.

    Attributes:
        times: (K,) time since the robot was sent off [s].
        poses: (K, 3) true poses in odom [m, m, rad].
        odometry: (K, 3) poses by odometry [m, m, rad].
        twists: (K, 3) twists in base_link, from the encoders [m/s, m/s, rad/s].
        energy: (K,) electric energy consumed since the robot was sent off, less the energy fed
            back [J].
        goal: Pose of the goal in odom [m, m, rad].
        tolerance: Tolerance of an arrival.
        gaps: (K, M) true gaps to the obstacles [m]; the last column is the gap to the nearest
            wall, where there are walls.
    """

    times: Array
    poses: Array
    odometry: Array
    twists: Array
    energy: Array
    goal: Pose
    tolerance: Arrival
    gaps: Array

    @staticmethod
    def of(
        course: Course,
        since: float,
        goal: Pose,
        tolerance: Arrival,
        half: Array,
        obstacles: Sequence[MovingObstacle] = (),
        walls: Sequence[Wall] = (),
    ) -> "Drive":
        """Make a drive of the part of a course that begins at a time.

        Args:
            course: What the robot did.
            since: Time at which the robot was sent off [s].
            goal: Pose of the goal in odom [m, m, rad].
            tolerance: Tolerance of an arrival.
            half: (2,) half length and half width of the robot [m].
            obstacles: Obstacles as they truly moved.
            walls: Walls.
        """
        rows = slice(int(np.searchsorted(course.times, since - 1e-9)), None)
        times, poses = np.array(course.times[rows]), np.array(course.poses[rows])
        energy = np.array(course.energy[rows])
        gaps = true_gaps(times, poses, half, obstacles)
        if walls:
            gaps = np.column_stack([gaps, wall_gaps(poses, half, walls)])
        return Drive(
            times - since,
            poses,
            np.array(course.odometry[rows]),
            np.array(course.twists[rows]),
            energy - energy[0],
            goal,
            tolerance,
            gaps,
        )

    @property
    def arrival(self) -> float:
        """Time at which the robot comes to rest at the goal and stays there [s]; inf if never.

        It is judged by odometry and encoders, as the planner judges it.
        """
        error = self.odometry - self.goal
        there = np.hypot(error[:, 0], error[:, 1]) <= self.tolerance.position
        there &= np.abs(_wrapped(error[:, 2])) <= self.tolerance.heading
        outside = np.flatnonzero(~there)
        first = int(outside[-1]) + 1 if len(outside) else 0
        rests = np.flatnonzero(np.abs(self.twists[first:]).max(axis=1, initial=0.0) < AT_REST)
        return float(self.times[first + rests[0]]) if len(rests) else math.inf

    @property
    def clearance(self) -> float:
        """Least true gap to any obstacle [m]; inf without one."""
        return float(self.gaps.min(initial=math.inf))

    @property
    def collided(self) -> bool:
        """Whether the robot truly touched an obstacle."""
        return not self.clearance > 0.0

    def energy_until_rest(self) -> float:
        """Return the energy from the start until `SETTLE` after the arrival [J].

        Raises:
            StudyError: The goal was not reached, or the recording ends earlier.
        """
        end = self.arrival + SETTLE
        if not end <= self.times[-1] + 1e-6:
            raise StudyError(
                f"the energy until rest is unknown: arrival {self.arrival:.2f} s, recorded until "
                f"{self.times[-1]:.2f} s"
            )
        return float(np.interp(end, self.times, self.energy))

    def travel_directions(self) -> tuple[Array, Array]:
        """Return the direction of travel in base_link where the robot is faster than `MOVING`.

        Returns:
            Times (k,) [s] and angles (k,) [rad], from the encoders.
        """
        moving = np.hypot(self.twists[:, 0], self.twists[:, 1]) > MOVING
        return self.times[moving], np.arctan2(self.twists[moving, 1], self.twists[moving, 0])


def _wrapped(angles: Array) -> Array:
    result: Array = (angles + math.pi) % math.tau - math.pi
    return result


def true_gaps(
    times: Array, poses: Array, half: Array, obstacles: Sequence[MovingObstacle]
) -> Array:
    """Compute the gaps between the robot's box and obstacles.

    Between two ticks of 5 ms the gaps may be smaller by no more than half of the relative travel,
    4 mm at 1.6 m/s.

    Args:
        times: (K,) [s].
        poses: (K, 3) true poses of the robot in odom [m, m, rad].
        half: (2,) half length and half width of the robot [m].
        obstacles: M obstacles.

    Returns:
        (K, M) gaps [m].
    """
    if not obstacles:
        return np.zeros((len(times), 0))
    centers = np.array([[o.place(time) for o in obstacles] for time in times.tolist()])
    axes = np.tile(np.array([o.semi_axes for o in obstacles]), (len(times), 1, 1))
    return box_gap(poses, half, centers, axes, np.array([o.angle for o in obstacles]))


def wall_gaps(poses: Array, half: Array, walls: Sequence[Wall]) -> Array:
    """Compute the gap between the robot's box and the nearest wall.

    Args:
        poses: (K, 3) true poses of the robot in odom [m, m, rad].
        half: (2,) half length and half width of the robot [m].
        walls: Walls, at least one.

    Returns:
        (K,) gaps [m].
    """
    box = Box(2.0 * float(half[0]), 2.0 * float(half[1]))
    rows = [np.array([wall.x, wall.y, wall.heading, wall.length, wall.width]) for wall in walls]
    count = len(poses)
    gaps = [wall_gap(poses, box, np.tile(row, (count, 1))) for row in rows]
    result: Array = np.min(gaps, axis=0)
    return result
