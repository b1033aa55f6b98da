"""Position controller in the world frame with velocity feed-forward, CCTA 2017 V.B, Fig. 6."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core import se2
from omniman_ros.core.limits import clamp
from omniman_ros.core.parameters import parameter
from omniman_ros.core.preview import Setpoint

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PositionGains:
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
    """Error (3,) in odom, reference minus pose, heading on the short way round [m, m, rad]."""
    x, y, theta = reference.tolist()
    return np.array([x - pose[0], y - pose[1], se2.wrap(theta - pose[2])])


class PositionController:
    """x'_W = x'_ref + K (x_ref - x), the correction bounded in size, not in direction."""

    def __init__(self, gains: PositionGains) -> None:
        self.gains = gains

    def lost(self, error: Array) -> bool:
        """Whether the following error (3,) is beyond its limits."""
        x, y, angle = error.tolist()
        within = (
            math.hypot(x, y) <= self.gains.max_linear_error
            and abs(angle) <= self.gains.max_angular_error
        )
        return not within  # so that NaN is lost, too

    def velocity(self, reference: Setpoint, error: Array) -> Array:
        """World-frame velocity (3,) [m/s, m/s, rad/s] for a setpoint and the error (3,)."""
        g = self.gains
        correction = error * [g.k_xy, g.k_xy, g.k_theta]
        bounded = clamp(correction, (g.max_linear_correction, g.max_angular_correction))
        return reference.velocity + bounded
