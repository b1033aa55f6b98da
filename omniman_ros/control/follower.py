"""Control law by which the platform follows a preview of poses."""

import math

import numpy as np

from omniman_ros.control.limits import TwistLimits, clamp, slew
from omniman_ros.control.odometry import Odometry
from omniman_ros.control.position_controller import PositionController, PositionGains, pose_error
from omniman_ros.core import se2
from omniman_ros.core.arrays import Array
from omniman_ros.core.preview import Preview


class FollowingError(Exception):
    """The platform is too far from its reference; the message says how far."""


class PreviewFollower:
    """Follows a preview by position control and feed-forward, CCTA 2017 V.B, Fig. 6.

    Attributes:
        gains: Gains of the position controller; may be changed at any time.
        error: Following error (3,) of the last step in odom [m, m, rad].
        target: Twist (3,) in base_link that the last step aimed for [m/s, m/s, rad/s].
    """

    def __init__(self, gains: PositionGains) -> None:
        self._position = PositionController(gains)
        self.error: Array = np.zeros(3)
        self.target: Array = np.zeros(3)

    @property
    def gains(self) -> PositionGains:
        """Gains of the position controller."""
        return self._position.gains

    @gains.setter
    def gains(self, gains: PositionGains) -> None:
        self._position.gains = gains

    def step(
        self,
        preview: Preview,
        odometry: Odometry,
        measured: float,
        setpoint: Array,
        limits: TwistLimits,
        now: float,
        dt: float,
    ) -> tuple[Array, Array]:
        """Return the twist (3,) and its rate (3,), both in base_link [m/s, rad/s and per second].

        Args:
            measured: Time of their measurement [s].
            setpoint: Twist (3,) of the last tick in base_link [m/s, m/s, rad/s].

        Raises:
            FollowingError: The following error exceeds its limits.
        """
        theta = odometry.pose[2]
        error = _error(preview, odometry, measured, now)
        if self._position.lost(error):
            distance = math.hypot(error[0], error[1])
            raise FollowingError(
                f"following error {distance:.3f} m, {error[2]:.3f} rad exceeds its limits"
            )
        self.error = error
        reference = preview.sample(now)
        target = clamp(self._position.velocity(reference, error), limits.velocity)
        self.target = se2.to_robot(theta, target)
        # The velocity in the world frame one tick ago; the platform has rotated since. Its change
        # in that frame is the acceleration in space, to which the limits apply.
        before = se2.to_world(theta - dt * float(setpoint[2]), setpoint)
        twist = se2.to_robot(theta, slew(before, target, limits, dt))
        vx, vy, w = twist.tolist()
        frame_rate = np.array([w * vy, -w * vx, 0.0])  # CCTA (20): base_link rotates
        linear, angular = map(max, limits.acceleration, limits.deceleration)
        acceleration = clamp(reference.acceleration, (linear, angular))
        return twist, se2.to_robot(theta, acceleration) + frame_rate


def _error(preview: Preview, odometry: Odometry, measured: float, now: float) -> Array:
    """Return the following error (3,) in odom [m, m, rad].

    The pose is as old as its measurement: it is compared with the reference at that time or, if
    the preview begins later, extrapolated to its beginning.
    """
    lead = max(min(preview.start, now) - measured, 0.0)
    error = pose_error(preview.sample(measured + lead).pose, odometry.pose)
    if lead > 0.0:
        error -= lead * se2.to_world(odometry.pose[2], odometry.twist)
    return error
