"""Share of the joints' speed limits that is left, which falls no faster than a motion can."""

from omniman_ros.core.arrays import Array
from omniman_ros.ur.joint_guard import JointLimits

REACTION_TIME = 0.1
"""Time in which the source of a motion may react to a lower share by itself [s]."""
RELATIVE_TOLERANCE = 0.02
"""Part of the allowed speed by which it may be exceeded, between two points of a preview."""
TOLERANCE = 1e-3
"""Share of the speed limits that counts as rest."""


class AllowedSpeed:
    """Follows a share of the speed limits that may fall suddenly.

    A source that obeys the share itself, and slows down on its path, is left to do so: the share
    falls after `REACTION_TIME`, and then as fast as the joints can brake.

    Attributes:
        target: Share that applies in the end, 0 to 1; may be changed at any time.
        value: Share that applies now.
    """

    def __init__(self) -> None:
        self.target = self.value = 1.0
        self._time_left = REACTION_TIME

    def step(self, limits: JointLimits, dt: float) -> None:
        """Let a time pass [s]; the joints brake within their limits."""
        if self.target >= self.value:
            self.value, self._time_left = self.target, REACTION_TIME
        elif self._time_left > 0.0:
            self._time_left -= dt
        else:
            fall = float((limits.acceleration / limits.velocity).min()) * dt
            self.value = max(self.target, self.value - fall)

    def is_exceeded(self, velocity: Array, limits: JointLimits) -> bool:
        """Return whether joints with velocities (n,) [rad/s] are faster than is allowed."""
        if self.value >= 1.0:
            return False
        used = float((abs(velocity) / limits.velocity).max())
        return used > self.value * (1.0 + RELATIVE_TOLERANCE) + TOLERANCE
