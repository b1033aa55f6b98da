"""Inputs and results of a planning cycle, without the solver's library."""

import math
from dataclasses import dataclass
from enum import Enum
from typing import Annotated, Self

from omniman_ros.core import plausible, se2
from omniman_ros.core.arrays import Array, Shape
from omniman_ros.core.validated import Validated
from omniman_ros.planning.motion import HermiteTrajectory

AT_REST = 0.02  #: Speed below which the robot, or an obstacle, counts as standing [m/s, rad/s]


class PlannerState(Enum):
    """State of the planner; its values are those of the key `state` of `mpc/status`."""

    IDLE = "idle"
    DRIVING = "driving"
    BLOCKED = "blocked"
    PAUSED = "paused"
    ARRIVED = "arrived"


@dataclass(frozen=True)
class MeasuredState(Validated):
    """State of the robot according to odometry.

    Raises:
        InputError: The shape is wrong, or a value is not finite or implausibly large.
    """

    time: float  #: Time of the measurement [s]
    pose: Annotated[Array, Shape(3)]  #: (3,) pose of base_link in odom [m, m, rad]
    twist: Annotated[Array, Shape(3)]  #: (3,) twist in base_link [m/s, m/s, rad/s]

    def __post_init__(self) -> None:
        super().__post_init__()
        plausible.demand(self.pose[:2], plausible.LENGTH, "position")
        plausible.demand(self.pose[2:], plausible.ANGLE, "heading")
        plausible.demand(self.twist, plausible.SPEED, "twist")

    @classmethod
    def on(cls, motion: HermiteTrajectory, time: float) -> Self:
        """Return the state at a time [s] of a robot that follows a motion exactly."""
        pose, velocity = motion.sample(time)
        return cls(time, pose, se2.to_robot(float(pose[2]), velocity))


@dataclass(frozen=True)
class CycleReport:
    """Result of a planning cycle."""

    used: bool = False  #: Whether the robot follows the new plan
    reason: str = ""  #: Reason why it does not, or an empty string
    braking: bool = False  #: Whether the robot brakes because no other motion is free of contact
    slack: float = math.nan  #: Largest slack of the solution [m]
    cost: float = math.nan  #: Cost of the solution [J]
    #: Whether the motion that is followed keeps its clearance until it is at rest
    clear: bool = True
    #: Time until the first contact if robot and obstacles move as predicted [s]; infinity if the
    #: motion is clear.
    time_to_contact: float = math.inf
    #: Time by which the plan was ready after it was due [s]; negative if it was early
    lateness: float = math.nan
