"""Parameters of the path interpolator, and the planner that they define."""

from dataclasses import dataclass

import numpy as np

from omniman_ros.control.kinematics import PlatformKinematics
from omniman_ros.control.limits import TwistLimits
from omniman_ros.core.arrays import Array
from omniman_ros.core.parameters import inline, parameter
from omniman_ros.core.platform import Platform
from omniman_ros.core.validated import Validated
from omniman_ros.motion.path.axis_group import AxisGroup
from omniman_ros.motion.path.planner import PathPlanner

TICK = 0.008  #: The time base, 125 Hz: the cycle of the UR controller, CCTA 2017 V.A [s]


@dataclass(frozen=True)
class PlatformSpeeds(Validated):
    """Speeds of the platform in planned motions, and what these leave of its limits."""

    linear_velocity: float = parameter(
        0.5, "Largest speed on a path, within the robot's limits.", unit="m/s", low=0.001, high=20
    )
    angular_velocity: float = parameter(
        0.8,
        "Largest yaw rate on a path, within the robot's limits.",
        unit="rad/s",
        low=0.001,
        high=50,
    )
    reserve: float = parameter(
        0.1,
        "Fraction of the limits on speed, acceleration and jerk that is left to feedback.",
        low=0,
        high=0.9,
    )


@dataclass(frozen=True)
class PathOptions(PlatformSpeeds):
    """Options of the platform's paths."""

    heading: str = parameter(
        "poses",
        "Heading of the robot: as in the poses of the path, or along the path.",
        choices=("poses", "along"),
    )
    corner_tolerance: float = parameter(
        0.05,
        "Largest distance by which corners are cut; with 0, the robot stops at each corner.",
        unit="m",
        low=0,
        high=10,
    )
    heading_tolerance: float = parameter(
        0.1,
        "Largest deviation of the heading from the path's at a corner; with 0, the robot stops.",
        unit="rad",
        low=0,
        high=3,
    )
    start_distance: float = parameter(
        1.0,
        "Largest distance from the robot to the start of a path; it drives straight there.",
        unit="m",
        low=0.001,
        high=1000,
    )
    settle: float = parameter(
        0.5,
        "Time for which the end of a path is sent, so that feedback removes the final error.",
        unit="s",
        low=0,
        high=60,
    )
    max_poses: int = parameter(20000, "Largest number of poses of a path.", low=2, high=1000000)


@dataclass(frozen=True, kw_only=True)
class PlatformMotionParameters(Validated):
    """Robot, limits and speeds of the platform in planned motions."""

    robot: Platform = inline()
    limits: TwistLimits
    path: PlatformSpeeds

    @property
    def kinematics(self) -> PlatformKinematics:
        """Kinematics of the robot's wheels."""
        return PlatformKinematics(self.robot.wheels)


@dataclass(frozen=True, kw_only=True)
class PathParameters(PlatformMotionParameters):
    """Robot, limits and options of the platform's paths."""

    path: PathOptions

    def groups(self) -> tuple[AxisGroup, AxisGroup]:
        """Return position and heading of the platform as groups of axes, less the reserve."""
        scale, limits, options = 1.0 - self.path.reserve, self.limits, self.path
        linear, angular = (
            scale * min(pair)
            for pair in zip(limits.acceleration, limits.deceleration, strict=True)
        )
        speed = min(options.linear_velocity, scale * limits.linear_velocity)
        yaw_rate = min(options.angular_velocity, scale * limits.angular_velocity)
        return (
            AxisGroup((0, 1), speed, linear, scale * limits.linear_jerk, options.corner_tolerance),
            AxisGroup(
                (2,), yaw_rate, angular, scale * limits.angular_jerk, options.heading_tolerance
            ),
        )

    def planner(self) -> PathPlanner:
        """Create the planner for x, y, theta of the platform."""
        kinematics = self.kinematics
        max_wheel_speed = (1.0 - self.path.reserve) * self.robot.motor.max_speed

        def cap(poses: Array, slopes: Array) -> Array:
            """Return the largest u' (k,) at which all wheels keep their speed limit."""
            c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
            x, y, w = slopes.T
            wheels = np.column_stack([c * x + s * y, c * y - s * x, w]) @ kinematics.J.T
            fastest = np.abs(wheels).max(axis=1)
            largest: Array = max_wheel_speed / np.maximum(fastest, 1e-9)
            return largest

        return PathPlanner(self.groups(), TICK, cap)
