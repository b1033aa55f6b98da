"""What goes into a cycle of the planner, and what is said of it; without the solver's library."""

import math
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core import plausible
from omniman_ros.core.errors import InputError

Array = NDArray[np.float64]


class PlannerState(Enum):
    """What the planner does."""

    IDLE = "idle"
    DRIVING = "driving"
    BLOCKED = "blocked"
    PAUSED = "paused"
    ARRIVED = "arrived"


@dataclass(frozen=True)
class Measured:
    """The robot as odometry has it.

    Attributes:
        time: When that was [s].
        pose: (3,) in odom [m, m, rad].
        twist: (3,) in base_link [m/s, m/s, rad/s].

    Raises:
        InputError: Wrong size, not finite or huge.
    """

    time: float
    pose: Array
    twist: Array

    def __post_init__(self) -> None:
        if self.pose.shape != (3,) or self.twist.shape != (3,):
            raise InputError("a measured state has a pose of three numbers and a twist of three")
        plausible.demand(self.pose[:2], plausible.LENGTH, "position")
        plausible.demand(self.pose[2:], plausible.ANGLE, "heading")
        plausible.demand(self.twist, plausible.SPEED, "twist")


@dataclass(frozen=True)
class Report:
    """What came of a cycle.

    Attributes:
        used: Whether the new plan is followed.
        why: Why not, or empty.
        braking: Whether the robot brakes because nothing else is free of contact.
        slack: Largest slack of the answer [m].
        cost: Of the answer [J].
        clear: Whether what is followed keeps its distance all the way to rest.
        contact: Where it does not: time until the robot is touched, if all goes on as now [s].
        late: By how much the answer came after it was due [s]; below zero, that much before.
    """

    used: bool = False
    why: str = ""
    braking: bool = False
    slack: float = math.nan
    cost: float = math.nan
    clear: bool = True
    contact: float = math.inf
    late: float = math.nan
