"""Everything the path interpolator is set by, declared once, and what follows from it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.kinematics import PlatformKinematics
from omniman_ros.core.limits import TwistLimits
from omniman_ros.core.parameters import inline, parameter
from omniman_ros.core.path.axes import AxisGroup
from omniman_ros.core.path.planner import PathPlanner
from omniman_ros.core.robot import Robot

Array = NDArray[np.float64]

TICK = 0.008
"""The time base, 125 Hz: the cycle of the UR controller, CCTA 2017 V.A [s]."""


@dataclass(frozen=True)
class PathOptions:
    """How paths are taken."""

    heading: str = parameter(
        "poses", "Where the robot looks: as the path's poses say, or along the path.",
        choices=("poses", "along"),
    )  # fmt: skip
    linear_velocity: float = parameter(
        0.5, "Largest speed on a path, within the robot's limits.", unit="m/s", low=0.001, high=20
    )
    angular_velocity: float = parameter(
        0.8, "Largest yaw rate on a path, within the robot's limits.",
        unit="rad/s", low=0.001, high=50,
    )  # fmt: skip
    corner_tolerance: float = parameter(
        0.05, "How far corners are cut at most; 0: the robot stops at each.",
        unit="m", low=0, high=10,
    )  # fmt: skip
    heading_tolerance: float = parameter(
        0.1, "How far the heading may be off the path's at a corner; 0: the robot stops.",
        unit="rad", low=0, high=3,
    )  # fmt: skip
    reserve: float = parameter(
        0.1, "Share of the limits on speed, acceleration and jerk that is left to feedback.",
        low=0, high=0.9,
    )  # fmt: skip
    start_distance: float = parameter(
        1.0, "How far from the robot a path may begin; it drives straight there.",
        unit="m", low=0.001, high=1000,
    )  # fmt: skip
    settle: float = parameter(
        0.5, "How long the end of a path is held, for feedback to take out what is left.",
        unit="s", low=0, high=60,
    )  # fmt: skip
    max_poses: int = parameter(20000, "Most poses of a path.", low=2, high=1000000)


@dataclass(frozen=True, kw_only=True)
class PathParameters:
    """Robot, limits and options of the platform's paths."""

    robot: Robot = inline()
    limits: TwistLimits
    path: PathOptions

    @property
    def kinematics(self) -> PlatformKinematics:
        """Of the robot's wheels."""
        return PlatformKinematics(self.robot.wheels)

    def groups(self) -> tuple[AxisGroup, AxisGroup]:
        """Position and heading of the platform as axes."""
        share, limits, options = 1.0 - self.path.reserve, self.limits, self.path
        linear, angular = (
            share * min(pair)
            for pair in zip(limits.acceleration, limits.deceleration, strict=True)
        )
        speed = min(options.linear_velocity, share * limits.linear_velocity)
        turn = min(options.angular_velocity, share * limits.angular_velocity)
        return (
            AxisGroup((0, 1), speed, linear, share * limits.linear_jerk, options.corner_tolerance),
            AxisGroup((2,), turn, angular, share * limits.angular_jerk, options.heading_tolerance),
        )

    def planner(self) -> PathPlanner:
        """The planner for x, y, theta of the platform."""
        kinematics = self.kinematics
        fastest = (1.0 - self.path.reserve) * self.robot.motor.max_speed

        def cap(poses: Array, slopes: Array) -> Array:
            """Largest u' (k,) at which no wheel is too fast."""
            c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
            x, y, w = slopes.T
            wheels = np.column_stack([c * x + s * y, c * y - s * x, w]) @ kinematics.J.T
            used = np.abs(wheels).max(axis=1)
            largest: Array = fastest / np.maximum(used, 1e-9)
            return largest

        return PathPlanner(self.groups(), TICK, cap)
