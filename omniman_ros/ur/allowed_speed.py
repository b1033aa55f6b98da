"""Fraction of the joints' speed limits that is left, which falls no faster than a motion can."""

from collections import deque

from omniman_ros.core.arrays import Array
from omniman_ros.ur.joint_guard import JointLimits

#: Time in which the source of a motion may react to a lower fraction by itself [s]
REACTION_TIME = 0.1
#: Part of the allowed speed by which it may be exceeded, between two points of a preview
RELATIVE_TOLERANCE = 0.02
TOLERANCE = 1e-3  #: Fraction of the speed limits that counts as rest


class AllowedSpeed:
    """Follows a fraction of the speed limits that may fall suddenly.

    A source that obeys the fraction itself slows down on its path first. The value follows
    `REACTION_TIME` later. It falls from the speed in use as fast as the joints can brake.

    Attributes:
        target: Fraction that applies in the end, 0 to 1; may be changed at any time.
    """

    def __init__(self) -> None:
        self.target = self.value = 1.0
        self._targets = deque([1.0])

    def step(self, velocity: Array, limits: JointLimits, dt: float) -> None:
        """Let the time `dt` [s] pass, always the same; `velocity` (n,) in [rad/s]."""
        self._targets.append(self.target)
        while len(self._targets) * dt > REACTION_TIME + dt:
            self._targets.popleft()
        latest = max(self._targets)
        if latest < self.value:
            fall = float((limits.acceleration / limits.velocity).min()) * dt
            latest = max(latest, min(self.value, _used(velocity, limits)) - fall)
        self.value = latest

    def is_exceeded(self, velocity: Array, limits: JointLimits) -> bool:
        """Return whether joints with velocities (n,) [rad/s] are faster than is allowed."""
        if self.value >= 1.0:
            return False
        return _used(velocity, limits) > self.value * (1.0 + RELATIVE_TOLERANCE) + TOLERANCE


def _used(velocity: Array, limits: JointLimits) -> float:
    """Return the fraction of the speed limits that joints with velocities (n,) [rad/s] use."""
    return float((abs(velocity) / limits.velocity).max())
