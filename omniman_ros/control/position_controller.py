"""Position controller in the world frame with velocity feed-forward, CCTA 2017 V.B, Fig. 6."""

import math
from dataclasses import dataclass

import numpy as np

from omniman_ros.control.limits import clamp
from omniman_ros.core import se2
from omniman_ros.core.arrays import Array
from omniman_ros.core.parameters import parameter
from omniman_ros.core.preview import Setpoint
from omniman_ros.core.validated import Validated


@dataclass(frozen=True)
class PositionGains(Validated):
    """Gains and bounds of the position controller."""

    k_xy: float = parameter(4.0, "Gain of the position error.", unit="1/s", low=0, high=50)
    k_theta: float = parameter(4.0, "Gain of the heading error.", unit="1/s", low=0, high=50)
    max_linear_correction: float = parameter(
        0.5, "Largest linear speed that corrects an error.", unit="m/s", low=0.001, high=20
    )
    max_angular_correction: float = parameter(
        0.8, "Largest yaw rate that corrects an error.", unit="rad/s", low=0.001, high=50
    )
    max_linear_error: float = parameter(
        0.5, "Following error at which the source is cancelled.", unit="m", low=1e-3, high=100
    )
    max_angular_error: float = parameter(
        0.8, "Following error at which the source is cancelled.", unit="rad", low=1e-3, high=3.2
    )


def pose_error(reference: Array, pose: tuple[float, float, float]) -> Array:
    """Return the error (3,) in odom: reference minus pose, heading wrapped [m, m, rad]."""
    x, y, theta = reference.tolist()
    return np.array([x - pose[0], y - pose[1], se2.wrap(theta - pose[2])])


class PositionController:
    """Control law x'_W = x'_ref + K (x_ref - x); limitation keeps the correction's direction."""

    def __init__(self, gains: PositionGains) -> None:
        self.gains = gains

    def lost(self, error: Array) -> bool:
        """Return whether the following error (3,) [m, m, rad] exceeds its limits."""
        x, y, angle = error.tolist()
        within = (
            math.hypot(x, y) <= self.gains.max_linear_error
            and abs(angle) <= self.gains.max_angular_error
        )
        return not within  # negated, so that NaN exceeds the limits, too

    def velocity(self, reference: Setpoint, error: Array) -> Array:
        """Return the world-frame velocity (3,) for a setpoint and the error (3,) [m/s, rad/s]."""
        g = self.gains
        correction = error * [g.k_xy, g.k_xy, g.k_theta]
        bounded = clamp(correction, (g.max_linear_correction, g.max_angular_correction))
        return reference.velocity + bounded
