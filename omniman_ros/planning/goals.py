"""Where the robot is to go: a pose, a pose at a velocity, or a goal that moves."""

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core import plausible, se2
from omniman_ros.core.errors import InputError
from omniman_ros.core.preview import Preview

Array = NDArray[np.float64]


class Goal(Protocol):
    """A goal: where the robot should be at which time."""

    def targets(self, times: Array) -> tuple[Array, Array]:
        """Poses (N, 3) and velocities (N, 3) in odom that are wanted at times (N,) [s]."""

    @property
    def moves(self) -> bool:
        """Whether its velocity counts."""

    @property
    def until(self) -> float:
        """Time at which it has come to its end [s]; minus infinity if it only stands."""

    def near(self, heading: float) -> "Goal":
        """The same goal, with its heading on the branch nearest to a heading [rad]."""


def _pose(pose: Array) -> Array:
    if pose.shape != (3,):
        raise InputError(f"goal: a pose of {pose.size} numbers, expected 3")
    plausible.demand(pose[:2], plausible.LENGTH, "goal: position")
    plausible.demand(pose[2:], plausible.ANGLE, "goal: heading")
    return np.array(pose)


@dataclass(frozen=True)
class PoseGoal:
    """A pose (3,) in odom [m, m, rad], where the robot is to come to rest.

    Raises:
        InputError: Not finite or huge.
    """

    pose: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "pose", _pose(self.pose))

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

    def near(self, heading: float) -> "PoseGoal":
        """See `Goal`."""
        return PoseGoal(np.append(self.pose[:2], _branch(self.pose[2], heading)))


@dataclass(frozen=True)
class TrajectoryGoal:
    """A goal that moves along a preview; after its end it stays there.

    A pose that is to be passed at a velocity is a preview of one straight line.
    """

    preview: Preview
    turns: float = 0.0

    def targets(self, times: Array) -> tuple[Array, Array]:
        """See `Goal`."""
        points = [self.preview.sample(time) for time in times.tolist()]
        poses = np.array([point.pose for point in points])
        poses[:, 2] += self.turns
        return poses, np.array([point.velocity for point in points])

    @property
    def moves(self) -> bool:
        """See `Goal`."""
        return True

    @property
    def until(self) -> float:
        """See `Goal`."""
        return self.preview.end

    def near(self, heading: float) -> "TrajectoryGoal":
        """See `Goal`."""
        first = float(self.preview.sample(self.preview.start).pose[2])
        return TrajectoryGoal(self.preview, _branch(first, heading) - first)


@dataclass(frozen=True)
class StateGoal:
    """A pose (3,) to be passed at a velocity (3,), both in odom; when is the robot's choice.

    Attributes:
        arrival: When the pose is to be passed [s]; None until the robot is near enough to say.

    Raises:
        InputError: Not finite or huge.
    """

    pose: Array
    velocity: Array
    arrival: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "pose", _pose(self.pose))
        if self.velocity.shape != (3,):
            raise InputError(f"goal: a velocity of {self.velocity.size} numbers, expected 3")
        plausible.demand(self.velocity, plausible.SPEED, "goal: velocity")

    def arriving(self, time: float) -> "StateGoal":
        """The same goal, to be passed at a time [s]."""
        return StateGoal(self.pose, self.velocity, time)

    def targets(self, times: Array) -> tuple[Array, Array]:
        """See `Goal`: the line that passes the pose at its velocity."""
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

    def near(self, heading: float) -> "StateGoal":
        """See `Goal`."""
        pose = np.append(self.pose[:2], _branch(self.pose[2], heading))
        return StateGoal(pose, self.velocity, self.arrival)


def _branch(angle: float, near: float) -> float:
    """The angle, by whole turns as near as can be to another [rad]."""
    return near + se2.wrap(angle - near)
