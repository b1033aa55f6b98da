"""A drive's integers in units of the motor's shaft, and the reverse."""

import math

from omniman_ros.can_drive.axis import AxisSettings


class Units:
    """How a drive counts.

    Args:
        settings: Of the drive.
        rated_torque: N m, of which torques are thousandths (6071, 6077, 60B2).
    """

    def __init__(self, settings: AxisSettings, rated_torque: float) -> None:
        self._settings, self._rated_torque = settings, rated_torque

    def position(self, count: int) -> float:
        """Angle of an unwrapped count [rad]."""
        return count * math.tau / self._settings.counts

    def velocity(self, units: int) -> float:
        """Speed that 606C stands for [rad/s]."""
        return units / self._settings.velocity_scale * math.tau

    def torque(self, thousandths: int) -> float:
        """Torque that 6077 stands for [N m]."""
        return 1e-3 * thousandths * self._rated_torque

    def from_velocity(self, velocity: float) -> int:
        """60FF for a speed in rad/s, clipped to the largest that is allowed, and to 32 bits."""
        velocity = _clip(velocity, self._settings.max_speed)
        return round(_clip(velocity / math.tau * self._settings.velocity_scale, 0x7FFF_FFFF))

    def from_torque(self, torque: float) -> int:
        """6071 or 60B2 for a torque in N m, clipped to the largest allowed, and to 16 bits."""
        torque = _clip(torque, self._settings.max_torque)
        return round(_clip(1e3 * torque / self._rated_torque, 0x7FFF))


def _clip(value: float, bound: float) -> float:
    return max(-bound, min(bound, value))
