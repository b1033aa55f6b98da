"""Goals of the robot: a pose, a pose to pass at a velocity, or a trajectory."""

import math
from dataclasses import dataclass
from typing import Annotated, Protocol

import numpy as np

from omniman_ros.core import plausible, round_off, se2
from omniman_ros.core.arrays import Array, Shape
from omniman_ros.core.preview import Preview
from omniman_ros.core.rigid import PlanarPose
from omniman_ros.core.validated import Validated


class PlanTarget(Protocol):
    """Desired poses of the robot over time, at which a plan aims."""

    def targets(self, times: Array) -> tuple[Array, Array]:
        """Return the desired poses (N, 3) and velocities (N, 3) in odom at times (N,) [s]."""

    @property
    def moves(self) -> bool:
        """Whether the desired velocities count."""

    @property
    def until(self) -> float:
        """Time at which the goal ends [s]; minus infinity if it does not move."""


class Goal(PlanTarget, Protocol):
    """Goal of the robot: desired poses over time, which may move with their frame."""

    def near(self, heading: float, time: float) -> "Goal":
        """Return the same goal, its heading at a time [s] on the branch nearest to a heading.

        Args:
            heading: Heading of the robot [rad].
        """

    def displaced(self, frame: PlanarPose) -> "Goal":
        """Return a goal that is given in a frame, by the pose of that frame [m, m, rad]."""


def _require_pose(pose: Array) -> None:
    plausible.demand(pose[:2], plausible.LENGTH, "goal: position")
    plausible.demand(pose[2:], plausible.ANGLE, "goal: heading")


@dataclass(frozen=True)
class PoseGoal(Validated):
    """Pose at which the robot comes to rest.

    Raises:
        InputError: The pose is not finite or implausibly large.
    """

    pose: Annotated[Array, Shape(3)]  #: (3,) pose in odom [m, m, rad]

    def __post_init__(self) -> None:
        super().__post_init__()
        _require_pose(self.pose)

    def targets(self, times: Array) -> tuple[Array, Array]:
        """See `Goal`."""
        return np.tile(self.pose, (len(times), 1)), np.zeros((len(times), 3))

    @property
    def moves(self) -> bool:
        """See `Goal`."""
        return False

    @property
    def until(self) -> float:
        """See `Goal`."""
        return -math.inf

    def near(self, heading: float, time: float) -> "PoseGoal":
        """See `Goal`."""
        return PoseGoal(np.append(self.pose[:2], _branch(self.pose[2], heading)))

    def displaced(self, frame: PlanarPose) -> "PoseGoal":
        """See `Goal`."""
        return PoseGoal(se2.displaced(self.pose, frame))


@dataclass(frozen=True)
class TrajectoryGoal:
    """Goal that moves along a preview, and rests at its end."""

    preview: Preview  #: Future motion to follow
    turns: float = 0.0  #: Angle that is added to its headings, a multiple of 2 pi [rad]
    #: Pose in odom of the frame in which the preview is given [m, m, rad]
    frame: PlanarPose = (0.0, 0.0, 0.0)

    def targets(self, times: Array) -> tuple[Array, Array]:
        """See `Goal`."""
        points = [self.preview.sample(time) for time in times.tolist()]
        poses = se2.displaced(np.array([point.pose for point in points]), self.frame)
        poses[:, 2] += self.turns
        velocities = [se2.to_world(self.frame[2], point.velocity) for point in points]
        return poses, np.array(velocities)

    @property
    def moves(self) -> bool:
        """See `Goal`."""
        return True

    @property
    def until(self) -> float:
        """See `Goal`."""
        return self.preview.end

    def near(self, heading: float, time: float) -> "TrajectoryGoal":
        """See `Goal`."""
        there = float(self.preview.sample(time).pose[2]) + self.frame[2]
        return TrajectoryGoal(self.preview, _branch(there, heading) - there, self.frame)

    def displaced(self, frame: PlanarPose) -> "TrajectoryGoal":
        """See `Goal`."""
        return TrajectoryGoal(self.preview, self.turns, se2.compose(frame, self.frame))


@dataclass(frozen=True)
class StateGoal(Validated):
    """Pose to pass at a velocity, at a time that the robot chooses.

    Raises:
        InputError: A value is not finite or implausibly large.
    """

    pose: Annotated[Array, Shape(3)]  #: (3,) pose in odom [m, m, rad]
    velocity: Annotated[Array, Shape(3)]  #: (3,) velocity in odom [m/s, m/s, rad/s]
    #: Time at which the pose is passed [s]; None until the robot is near enough
    arrival: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        _require_pose(self.pose)
        plausible.demand(self.velocity, plausible.SPEED, "goal: velocity")

    def arriving(self, time: float) -> "StateGoal":
        """Return the same goal, to be passed at a time [s]."""
        return StateGoal(self.pose, self.velocity, time)

    def targets(self, times: Array) -> tuple[Array, Array]:
        """See `Goal`: targets on the line that passes the pose at its velocity."""
        if self.arrival is None:
            return np.tile(self.pose, (len(times), 1)), np.zeros((len(times), 3))
        ahead = (times - self.arrival)[:, None]
        return self.pose + ahead * self.velocity, np.tile(self.velocity, (len(times), 1))

    @property
    def moves(self) -> bool:
        """See `Goal`."""
        return self.arrival is not None

    @property
    def until(self) -> float:
        """See `Goal`."""
        return math.inf if self.arrival is None else self.arrival

    def near(self, heading: float, time: float) -> "StateGoal":
        """See `Goal`."""
        pose = np.append(self.pose[:2], _branch(self.pose[2], heading))
        return StateGoal(pose, self.velocity, self.arrival)

    def displaced(self, frame: PlanarPose) -> "StateGoal":
        """See `Goal`."""
        velocity = se2.to_world(frame[2], self.velocity)
        return StateGoal(se2.displaced(self.pose, frame), velocity, self.arrival)


def goal_of_state(pose: Array, velocity: Array) -> PoseGoal | StateGoal:
    """Return the goal to pass a pose (3,) at a velocity (3,); without a velocity, to rest there.

    Raises:
        InputError: A value is not finite or implausibly large.
    """
    goal = StateGoal(pose, velocity)
    return PoseGoal(pose) if round_off.is_rest(velocity) else goal


def _branch(angle: float, near: float) -> float:
    """Return the angle shifted by whole revolutions to be nearest to another angle [rad]."""
    return near + se2.wrap(angle - near)
