"""Pace at which a motion keeps to fractions of the limits of speed."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from omniman_ros.core.arrays import Array, Shape
from omniman_ros.core.validated import Validated

HEADROOM = 0.95  #: Part of the allowed speed that the motion uses; the rest is left to feedback


@dataclass(frozen=True)
class SpeedBound(Validated):
    """Limits of speed to which the fractions of a motion limit refer."""

    linear: float  #: Linear speed of the platform [m/s]
    angular: float  #: Yaw rate [rad/s]
    #: Rate (6,) of each joint of the arm [rad/s]
    rates: Annotated[Array, Shape("j", low=0.0, unit="rad/s")]

    def pace(self, velocities: Array, platform: float, arm: float) -> float:
        """Return the largest pace, 0 to 1, at which platform and arm keep to their shares.

        The velocities (k, 9) of platform and joints are those at full pace [m/s, rad/s].

        Args:
            velocities: Velocities (k, 9) of platform and joints at full pace [m/s, m/s, rad/s,
                rad/s ...].
        """
        v = np.abs(velocities)
        linear = float(np.hypot(v[:, 0], v[:, 1]).max())
        platform_use = max(linear / self.linear, float(v[:, 2].max()) / self.angular)
        arm_use = float((v[:, 3:] / self.rates).max())
        pace = 1.0
        for use, fraction in ((platform_use, platform), (arm_use, arm)):
            if fraction < 1.0 and use > 0.0:
                pace = min(pace, HEADROOM * fraction / use)
        return pace
