"""Follows a preview: from a pose, a reference and their error to a twist in base_link."""

import math

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core import se2
from omniman_ros.core.limits import TwistLimits, clamp, slew
from omniman_ros.core.odometry import Odometry
from omniman_ros.core.position_controller import PositionController, PositionGains, pose_error
from omniman_ros.core.preview import Preview

Array = NDArray[np.float64]


class FollowingError(Exception):
    """The platform is too far from its reference; the message says how far."""


class PreviewFollower:
    """Position controller and feed-forward along a preview, CCTA 2017 V.B, Fig. 6.

    Attributes:
        gains: Of the position controller, live.
        error: (3,) of the last step, in odom [m, m, rad].
    """

    def __init__(self, gains: PositionGains) -> None:
        self._position = PositionController(gains)
        self.error: Array = np.zeros(3)

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
        """Twist (3,) and its rate (3,), both in base_link.

        Args:
            preview: In odom.
            odometry: Pose and twist.
            measured: When these were measured [s].
            setpoint: (3,) twist of the last tick, in base_link [m/s, m/s, rad/s].
            limits: The twist keeps them.
            now, dt: Time, and since the last step [s].

        Raises:
            FollowingError: Beyond the largest error.
        """
        theta = odometry.pose[2]
        error = _error(preview, odometry, measured, now)
        if self._position.lost(error):
            distance = math.hypot(error[0], error[1])
            raise FollowingError(f"following error {distance:.3f} m, {error[2]:.3f} rad")
        self.error = error
        reference = preview.sample(now)
        wanted = clamp(self._position.velocity(reference, error), limits.velocity)
        # Where the velocity pointed a tick ago: the platform has turned below it since. Seen from
        # there its change is the acceleration in space, which is what the limits are for.
        before = se2.to_world(theta - dt * float(setpoint[2]), setpoint)
        twist = se2.to_robot(theta, slew(before, wanted, limits, dt))
        vx, vy, w = twist.tolist()
        turned = np.array([w * vy, -w * vx, 0.0])  # CCTA (20): the frame turns below the velocity
        top = tuple(map(max, limits.acceleration, limits.deceleration))
        planned = clamp(reference.acceleration, (top[0], top[1]))
        return twist, se2.to_robot(theta, planned) + turned


def _error(preview: Preview, odometry: Odometry, measured: float, now: float) -> Array:
    """Error (3,) in odom [m, m, rad].

    The pose is as old as its measurement: it is compared with the reference of that time, or,
    where the preview begins later, carried on to its begin.
    """
    lead = max(min(preview.start, now) - measured, 0.0)
    error = pose_error(preview.sample(measured + lead).pose, odometry.pose)
    if lead > 0.0:
        error -= lead * se2.to_world(odometry.pose[2], odometry.twist)
    return error
