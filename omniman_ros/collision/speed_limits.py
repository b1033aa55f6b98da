"""Limits of the speed of platform and arm, and motions as fractions of them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from omniman_ros.core.arrays import Array


@dataclass(frozen=True)
class SpeedLimits:
    """Limits of the platform's twist and of the joints' rates."""

    velocity: tuple[float, float]  #: Linear and angular velocity of the platform [m/s, rad/s]
    deceleration: tuple[float, float]  #: Its linear and angular deceleration [m/s^2, rad/s^2]
    rate: Sequence[float]  #: Largest rate (6,) of each joint [rad/s]
    braking: Sequence[float]  #: Largest deceleration (6,) of each joint [rad/s^2]

    def fraction(self, motion: Array) -> float:
        """Return the largest ratio of a motion (9,), twist and joint rates, to its limits.

        Args:
            motion: Twist of the platform in base_link and rates of the joints (9,) [m/s, m/s,
                rad/s, rad/s ...].
        """
        return _largest_ratio(motion, self.velocity, self.rate)

    def stop_time(self, motion: Array) -> float:
        """Return the time in which platform and arm come to rest from a motion (9,) [s]."""
        return _largest_ratio(motion, self.deceleration, self.braking)


def _largest_ratio(motion: Array, twist: tuple[float, float], joints: Sequence[float]) -> float:
    """Return the largest ratio of the parts of a motion (9,) to bounds of them."""
    x, y, angle = motion[:3].tolist()
    platform: float = max(math.hypot(x, y) / twist[0], abs(angle) / twist[1])
    arm: float = max(
        abs(rate) / limit for rate, limit in zip(motion[3:].tolist(), joints, strict=True)
    )
    return max(platform, arm)
