"""A calibration campaign: runs of the wheels, and the measured poses between them."""

import math
from dataclasses import dataclass, replace

import numpy as np

from omniman_ros.core import plausible
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.core.platform import Wheels

Pose = tuple[float, float, float]  #: Position and heading of base_link on the floor [m, m, rad]


@dataclass(frozen=True)
class CalibrationRun:
    """The motion of the wheels between two measured poses."""

    name: str  #: Name of the run, for messages
    positions: Array  #: (k, n) wheel positions, not wrapped, k >= 1 [rad]


@dataclass(frozen=True)
class Accuracy:
    """Standard deviations of a measured pose; one not above 0 raises an InputError."""

    position: float = 0.003  #: Standard deviation of each coordinate [m]
    heading: float = math.radians(0.3)  #: Standard deviation of the heading [rad]

    def __post_init__(self) -> None:
        if not (0.0 < self.position < math.inf and 0.0 < self.heading < math.inf):
            raise InputError(
                f"the accuracy of a measured pose must be above 0: {self.position} m, "
                f"{self.heading} rad"
            )


@dataclass(frozen=True)
class Campaign:
    """Runs in the order in which they were driven, and the measured poses between them.

    Raises:
        InputError: Sizes do not match, a number is not finite, or fewer than two poses were
            measured.
    """

    wheels: Wheels  #: The wheels as configured, without calibration
    runs: tuple[CalibrationRun, ...]  #: N runs; the robot does not move between them
    #: N + 1 measured poses of base_link [m, m, rad] in one frame of the floor: before the first
    #: run, between the runs, and after the last; None where the pose was not measured. Headings
    #: may be wrapped.
    poses: tuple[Pose | None, ...]
    accuracy: Accuracy  #: Accuracy of the poses

    def __post_init__(self) -> None:
        n = len(self.wheels.names)
        if len(self.poses) != len(self.runs) + 1:
            raise InputError(
                f"there are {len(self.poses)} poses for {len(self.runs)} runs, expected one more"
            )
        for run in self.runs:
            shape = run.positions.shape
            if len(shape) != 2 or shape[0] < 1 or shape[1] != n:
                raise InputError(f"run '{run.name}': positions of shape {shape}, {n} wheels")
            plausible.demand(run.positions, plausible.WHEEL_ANGLE, f"run '{run.name}': positions")
        for pose in self.poses:
            if pose is not None:
                plausible.demand(np.array(pose), plausible.ANGLE, "measured pose")
        if len(self.stations) < 2:
            raise InputError("fewer than two measured poses: the odometry cannot be calibrated")

    @property
    def stations(self) -> tuple[int, ...]:
        """Indices of the poses that were measured."""
        return tuple(i for i, pose in enumerate(self.poses) if pose is not None)

    def station_name(self, index: int) -> str:
        """Describe the position in the campaign of the pose with an index, for the user."""
        return f"after '{self.runs[index - 1].name}'" if index else "at the start"

    def without(self, index: int) -> "Campaign":
        """Return the campaign without one measured pose; the runs around it are joined."""
        poses = list(self.poses)
        poses[index] = None
        return replace(self, poses=tuple(poses))
