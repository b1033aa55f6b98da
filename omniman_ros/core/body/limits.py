"""Limits of the nine axes, of the platform's as vectors, and of its wheels."""

from dataclasses import dataclass, field
from typing import Self

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core import plausible
from omniman_ros.core.arm_parameters import ArmParameters
from omniman_ros.core.body.model import PLATFORM_AXES
from omniman_ros.core.errors import InputError
from omniman_ros.core.path.axes import AxisGroup
from omniman_ros.core.path.axis_limits import ROUND_OFF, AxisLimits
from omniman_ros.core.path.parameters import TICK, PathParameters
from omniman_ros.core.path.time_profile import SpeedCap
from omniman_ros.core.path.timed_curve import TimedCurve

Array = NDArray[np.float64]


@dataclass(frozen=True)
class BodyLimits(AxisLimits):
    """Limits of odom_x, odom_y, odom_t and the arm's joints; x and y have theirs as a vector.

    Those of the platform are less than its own by what paths leave to feedback, always.

    Attributes:
        wheels: (n, 3) wheel speeds of a twist in base_link [rad/s].
        wheel_speed: Largest of them [rad/s].
        path_speeds: Largest linear and angular speed where times are computed [m/s, rad/s].
    """

    wheels: Array = field(default_factory=lambda: np.zeros((0, 3)))
    wheel_speed: float = np.inf
    path_speeds: tuple[float, float] = (np.inf, np.inf)

    @classmethod
    def of_body(cls, path: PathParameters, arm: ArmParameters) -> Self:
        """Those of a platform on paths and of an arm."""
        joints, limits = AxisLimits.of_arm(arm), path.limits
        share = 1.0 - path.path.reserve
        linear, angular = (
            share * min(pair)
            for pair in zip(limits.acceleration, limits.deceleration, strict=True)
        )
        ends = np.array([plausible.LENGTH, plausible.LENGTH, plausible.ANGLE])
        speed, turn = share * limits.linear_velocity, share * limits.angular_velocity
        jerk, turn_jerk = share * limits.linear_jerk, share * limits.angular_jerk
        return cls(
            PLATFORM_AXES + joints.names,
            np.concatenate([-ends, joints.lower]),
            np.concatenate([ends, joints.upper]),
            np.concatenate([[speed, speed, turn], joints.velocity]),
            np.concatenate([[linear, linear, angular], joints.acceleration]),
            np.concatenate([[jerk, jerk, turn_jerk], joints.jerk]),
            ("m", "m", "rad", *joints.units),
            path.kinematics.J,
            share * path.robot.motor.max_speed,
            (path.path.linear_velocity, path.path.angular_velocity),
        )

    def groups(self, share: float, tolerance: float) -> tuple[AxisGroup, ...]:
        """Position and heading of the platform, then each joint alone; see the base class.

        The share is one of the joints' limits.
        """
        joints = super().groups(share, tolerance)[len(PLATFORM_AXES) :]
        x, _, heading = super().groups(1.0, tolerance)[: len(PLATFORM_AXES)]
        linear, angular = self.path_speeds
        return (
            AxisGroup((0, 1), min(linear, x.velocity), x.acceleration, x.jerk, tolerance),
            AxisGroup(
                (2,), min(angular, heading.velocity), heading.acceleration, heading.jerk, tolerance
            ),
            *joints,
        )

    def cap(self, share: float) -> SpeedCap:
        """Largest u' at which no wheel is too fast; there is no share of that."""

        def cap(q: Array, slopes: Array) -> Array:
            used = np.abs(self._wheel_speeds(q, slopes)).max(axis=1)
            largest: Array = self.wheel_speed / np.maximum(used, 1e-9)
            return largest

        return cap

    def demand_kept(self, curve: TimedCurve, jerk_scale: float) -> None:
        """Demand that a motion keeps all limits; those of vectors are looked at on the ticks.

        Raises:
            InputError: It does not; the message names what, the time, the value and the limit.
        """
        super().demand_kept(curve, jerk_scale)
        times: Array = TICK * np.arange(np.ceil(curve.duration / TICK) + 1.0)
        q, velocities, accelerations = curve.sample(times)
        for what, unit, values, limit in (
            ("speed", "m/s", np.hypot(*velocities[:, :2].T), self.velocity[0]),
            ("acceleration", "m/s^2", np.hypot(*accelerations[:, :2].T), self.acceleration[0]),
            (
                "wheel speed", "rad/s", np.abs(self._wheel_speeds(q, velocities)).max(axis=1),
                self.wheel_speed,
            ),
        ):  # fmt: skip
            k = int(values.argmax())
            if not values[k] <= limit * (1.0 + ROUND_OFF) + ROUND_OFF:
                raise InputError(
                    f"platform: {what} {values[k]:.4g} {unit} at {times[k]:.3f} s, the limit is "
                    f"{limit:.4g} {unit}"
                )

    def _wheel_speeds(self, q: Array, velocities: Array) -> Array:
        """Wheel speeds (k, n) [rad/s], CCTA 2017 (8), of all axes (k, 9) and their rates."""
        c, s = np.cos(q[:, 2]), np.sin(q[:, 2])
        x, y, w = velocities[:, :3].T
        result: Array = np.column_stack([c * x + s * y, c * y - s * x, w]) @ self.wheels.T
        return result
