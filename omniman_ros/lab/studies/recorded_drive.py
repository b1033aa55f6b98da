"""A recorded drive to a goal: true poses, energy and true gaps, and figures derived from them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from omniman_ros.collision.rectangles import Rectangles
from omniman_ros.core.arrays import Array
from omniman_ros.lab.studies.closed_loop import StudyError
from omniman_ros.lab.studies.mpc_loop import MotionRecord, MovingObstacle
from omniman_ros.lab.studies.scene_gaps import wall_gap
from omniman_ros.lab.studies.scene_geometry import Box, Wall
from omniman_ros.planning.cases import Pose
from omniman_ros.planning.obstacles.separation import box_gap
from omniman_ros.planning.parameters import Arrival

SETTLING_TIME = 0.5  # time after the arrival for which consumed energy still counts [s]
REST_SPEED = 0.02
"""Speed below which the robot counts as at rest, the same as in the planner [m/s, rad/s]."""


@dataclass(frozen=True)
class Drive:
    """A recorded drive to a goal, with a row for each of K ticks of 5 ms.

    Attributes:
        energy: (K,) electric energy consumed since the goal was sent, less the energy fed back
            [J].
        gaps: (K, M) true gaps to the obstacles [m]; the last column is the gap to the nearest
            wall, where there are walls.
    """

    times: Array  # (K,) times since the goal was sent [s]
    poses: Array  # (K, 3) true poses in odom [m, m, rad]
    odometry: Array  # (K, 3) poses by odometry [m, m, rad]
    twists: Array  # (K, 3) twists in base_link, from the encoders [m/s, m/s, rad/s]
    energy: Array
    goal: Pose  # pose of the goal in odom [m, m, rad]
    tolerance: Arrival  # largest errors of position and heading with which the robot has arrived
    gaps: Array

    @staticmethod
    def of(
        record: MotionRecord,
        since: float,
        goal: Pose,
        tolerance: Arrival,
        half: Array,
        obstacles: Sequence[MovingObstacle] = (),
        walls: Sequence[Wall] = (),
    ) -> "Drive":
        """Return the drive that a motion record contains from a time on.

        Args:
            half: (2,) half length and half width of the robot [m].
        """
        rows = slice(int(np.searchsorted(record.times, since - 1e-9)), None)
        times, poses = np.array(record.times[rows]), np.array(record.poses[rows])
        energy = np.array(record.energy[rows])
        gaps = true_gaps(times, poses, half, obstacles)
        if walls:
            gaps = np.column_stack([gaps, wall_gaps(poses, half, walls)])
        return Drive(
            times - since,
            poses,
            np.array(record.odometry[rows]),
            np.array(record.twists[rows]),
            energy - energy[0],
            goal,
            tolerance,
            gaps,
        )

    @property
    def arrival(self) -> float:
        """Time at which the robot comes to rest at the goal for good [s]; inf if it never does.

        Like in the planner, odometry and encoders decide.
        """
        error = self.odometry - self.goal
        there = np.hypot(error[:, 0], error[:, 1]) <= self.tolerance.position
        there &= np.abs(_wrapped(error[:, 2])) <= self.tolerance.heading
        outside = np.flatnonzero(~there)
        first = int(outside[-1]) + 1 if len(outside) else 0
        rests = np.flatnonzero(np.abs(self.twists[first:]).max(axis=1, initial=0.0) < REST_SPEED)
        return float(self.times[first + rests[0]]) if len(rests) else math.inf

    @property
    def clearance(self) -> float:
        """Smallest true gap to any obstacle or wall [m]; inf if there is none."""
        return float(self.gaps.min(initial=math.inf))

    @property
    def collided(self) -> bool:
        """Whether the robot truly touched an obstacle or a wall; a gap that is NaN counts."""
        return not self.clearance > 0.0

    def energy_until_rest(self) -> float:
        """Return the energy consumed until `SETTLING_TIME` after the arrival [J]."""
        end = self.arrival + SETTLING_TIME
        if not end <= self.times[-1] + 1e-6:
            raise StudyError(
                f"the energy until rest is unknown: arrival {self.arrival:.2f} s, recorded until "
                f"{self.times[-1]:.2f} s"
            )
        return float(np.interp(end, self.times, self.energy))


def _wrapped(angles: Array) -> Array:
    """Return angles wrapped to [-pi, pi) [rad]."""
    result: Array = (angles + math.pi) % math.tau - math.pi
    return result


def true_gaps(
    times: Array, poses: Array, half: Array, obstacles: Sequence[MovingObstacle]
) -> Array:
    """Compute the gaps between the robot's box and each obstacle.

    Between two ticks of 5 ms, a gap may be smaller by at most half of the relative travel: 4 mm
    at 1.6 m/s.

    Args:
        times: (K,) times [s].
        poses: (K, 3) true poses of the robot in odom [m, m, rad].
        half: (2,) half length and half width of the robot [m].

    Returns:
        (K, M) gaps [m].
    """
    if not obstacles:
        return np.zeros((len(times), 0))
    centers = np.array([[o.place(time) for o in obstacles] for time in times.tolist()])
    axes = np.tile(np.array([o.semi_axes for o in obstacles]), (len(times), 1, 1))
    return box_gap(
        poses, Rectangles.centred(half), centers, axes, np.array([o.angle for o in obstacles])
    )


def wall_gaps(poses: Array, half: Array, walls: Sequence[Wall]) -> Array:
    """Compute the gap between the robot's box and the nearest wall.

    Args:
        poses: (K, 3) true poses of the robot in odom [m, m, rad].
        half: (2,) half length and half width of the robot [m].

    Returns:
        (K,) gaps [m].
    """
    box = Box(2.0 * float(half[0]), 2.0 * float(half[1]))
    rows = [np.array([wall.x, wall.y, wall.heading, wall.length, wall.width]) for wall in walls]
    count = len(poses)
    gaps = [wall_gap(poses, box, np.tile(row, (count, 1))) for row in rows]
    result: Array = np.min(gaps, axis=0)
    return result
