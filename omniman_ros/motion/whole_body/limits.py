"""Limits of the nine axes, of the platform's velocity vectors, and of its wheels."""

from dataclasses import dataclass, field
from typing import Annotated, Self

import numpy as np

from omniman_ros.core import plausible
from omniman_ros.core.arm_parameters import ArmParameters
from omniman_ros.core.arrays import Array, Shape
from omniman_ros.core.errors import InputError
from omniman_ros.core.parameters import Range
from omniman_ros.motion.axes import PLATFORM_AXES
from omniman_ros.motion.path.axis_group import AxisGroup
from omniman_ros.motion.path.axis_limits import ROUND_OFF, AxisLimits
from omniman_ros.motion.path.parameters import TICK, PlatformMotionParameters
from omniman_ros.motion.path.time_profile import SpeedCap
from omniman_ros.motion.path.timed_curve import TimedCurve


@dataclass(frozen=True)
class WholeBodyLimits(AxisLimits):
    """Limits of odom_x, odom_y, odom_t and the arm's joints, with x and y limited as a vector.

    The platform's limits are always reduced by the reserve that paths leave to feedback.
    """

    #: (n, 3) matrix from a twist in base_link to wheel speeds [rad/s]
    wheels: Annotated[Array, Shape("n", 3)] = field(default_factory=lambda: np.zeros((0, 3)))
    #: Limit of the wheel speeds [rad/s]
    wheel_speed: Annotated[float, Range(low=0.0, unit="rad/s", finite=False)] = np.inf
    #: Linear and angular speed limits where times are computed [m/s, rad/s]
    path_speeds: Annotated[tuple[float, float], Range(low=0.0, finite=False)] = (np.inf, np.inf)

    @classmethod
    def of_whole_body(cls, path: PlatformMotionParameters, arm: ArmParameters) -> Self:
        """Create the limits from those of the platform on paths and those of the arm."""
        joints, limits = AxisLimits.of_arm(arm), path.limits
        scale = 1.0 - path.path.reserve
        linear, angular = (
            scale * min(pair)
            for pair in zip(limits.acceleration, limits.deceleration, strict=True)
        )
        ends = np.array([plausible.LENGTH, plausible.LENGTH, plausible.ANGLE])
        speed, yaw_rate = scale * limits.linear_velocity, scale * limits.angular_velocity
        jerk, yaw_jerk = scale * limits.linear_jerk, scale * limits.angular_jerk
        return cls(
            PLATFORM_AXES + joints.names,
            np.concatenate([-ends, joints.lower]),
            np.concatenate([ends, joints.upper]),
            np.concatenate([[speed, speed, yaw_rate], joints.velocity]),
            np.concatenate([[linear, linear, angular], joints.acceleration]),
            np.concatenate([[jerk, jerk, yaw_jerk], joints.jerk]),
            ("m", "m", "rad", *joints.units),
            path.kinematics.J,
            scale * path.robot.motor.max_speed,
            (path.path.linear_velocity, path.path.angular_velocity),
        )

    def groups(self, scale: float, tolerance: float) -> tuple[AxisGroup, ...]:
        """Return position and heading of the platform, then each joint; see the base class.

        The scale applies to the joints' limits only.
        """
        joints = super().groups(scale, tolerance)[len(PLATFORM_AXES) :]
        x, _, heading = super().groups(1.0, tolerance)[: len(PLATFORM_AXES)]
        linear, angular = self.path_speeds
        return (
            AxisGroup((0, 1), min(linear, x.velocity), x.acceleration, x.jerk, tolerance),
            AxisGroup(
                (2,), min(angular, heading.velocity), heading.acceleration, heading.jerk, tolerance
            ),
            *joints,
        )

    def speed_cap(self, scale: float) -> SpeedCap:
        """Return the bound on u' that keeps the wheel speed limit, which is not scaled."""

        def cap(q: Array, slopes: Array) -> Array:
            fastest = np.abs(self._wheel_speeds(q, slopes)).max(axis=1)
            largest: Array = self.wheel_speed / np.maximum(fastest, 1e-9)
            return largest

        return cap

    def require_kept(self, curve: TimedCurve, jerk_scale: float) -> None:
        """Require that a motion keeps all limits; those of vectors and wheels at ticks.

        Raises:
            InputError: The motion violates a limit; the message names the quantity, the time, the
                value and the limit.
        """
        super().require_kept(curve, jerk_scale)
        times: Array = TICK * np.arange(np.ceil(curve.duration / TICK) + 1.0)
        q, velocities, accelerations = curve.sample(times)
        for quantity, unit, values, limit in (
            ("speed", "m/s", np.hypot(*velocities[:, :2].T), self.velocity[0]),
            ("acceleration", "m/s^2", np.hypot(*accelerations[:, :2].T), self.acceleration[0]),
            (
                "wheel speed",
                "rad/s",
                np.abs(self._wheel_speeds(q, velocities)).max(axis=1),
                self.wheel_speed,
            ),
        ):
            k = int(values.argmax())
            if not values[k] <= limit * (1.0 + ROUND_OFF) + ROUND_OFF:
                raise InputError(
                    f"platform: {quantity} {values[k]:.4g} {unit} at {times[k]:.3f} s, the limit "
                    f"is {limit:.4g} {unit}"
                )

    def _wheel_speeds(self, q: Array, velocities: Array) -> Array:
        """Return wheel speeds (k, n) [rad/s], CCTA 2017 (8), for axes (k, 9) and their rates."""
        c, s = np.cos(q[:, 2]), np.sin(q[:, 2])
        x, y, w = velocities[:, :3].T
        result: Array = np.column_stack([c * x + s * y, c * y - s * x, w]) @ self.wheels.T
        return result
