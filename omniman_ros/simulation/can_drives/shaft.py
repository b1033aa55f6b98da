"""Motor shaft of one wheel of the plant, which a simulated drive moves and measures."""

import math

from omniman_ros.core.errors import ParameterError
from omniman_ros.core.platform import Platform
from omniman_ros.simulation.plant.driven_wheels import DrivenWheels


class MotorShaft:
    """Converts between a wheel and its motor; it implements `Motor`.

    The torque at the motor is its torque constant times its current, before the gear's losses. The
    encoder is that of the wheel: its steps are multiplied by the gear ratio.

    Args:
        gear_ratio: Revolutions of the motor per revolution of the wheel; 0 selects the robot's.
            The torque constant at the motor is adapted, so that the one at the wheel stays the
            same.
        direction: 1 if positive rotation of the motor moves the wheel forward, else -1.

    Raises:
        ParameterError: The gear ratio is negative or not finite, or the direction not 1 or -1.
    """

    def __init__(
        self,
        wheels: DrivenWheels,
        wheel: int,
        robot: Platform,
        gear_ratio: float = 0.0,
        direction: float = 1.0,
    ) -> None:
        if not (math.isfinite(gear_ratio) and gear_ratio >= 0.0):
            raise ParameterError("can.gear_ratio", gear_ratio, "must be finite and >= 0")
        if abs(direction) != 1.0:
            raise ParameterError("can.direction", direction, "must be 1 or -1")
        self._wheels, self._wheel = wheels, wheel
        self._motor = robot.motor
        #: Revolutions of the motor per revolution of the wheel, never negative
        self.gear_ratio = gear_ratio or robot.motor.gear_ratio
        self._signed_ratio = direction * self.gear_ratio
        self._direction = direction
        #: Torque constant at the motor [N m/A]
        self.torque_constant = (
            robot.motor.torque_constant * robot.motor.gear_ratio / self.gear_ratio
        )

    @property
    def position(self) -> float:
        """Unwrapped angle [rad]."""
        return self._signed_ratio * self._wheels.position(self._wheel)

    @property
    def velocity(self) -> float:
        """Speed [rad/s]."""
        return self._signed_ratio * self._wheels.velocity(self._wheel)

    @property
    def torque(self) -> float:
        """Torque, derived from the current [N m]."""
        return self.torque_constant * self.current

    @property
    def current(self) -> float:
        """Current [A]."""
        return self._direction * self._wheels.current(self._wheel)

    @property
    def voltage(self) -> float:
        """Voltage at the motor [V]."""
        return self._direction * self._wheels.voltage(self._wheel)

    @property
    def supply(self) -> float:
        """Supply voltage: the largest that the motor can get [V]."""
        return self._motor.max_voltage

    @property
    def lost(self) -> bool:
        """Whether the encoder is detected to be wrong."""
        return self._wheels.lost(self._wheel)

    def follow_velocity(self, velocity: float, torque: float = 0.0) -> None:
        """Close the velocity loop at a speed [rad/s], with a feed-forward torque [N m]."""
        self._wheels.command_velocity(
            self._wheel, velocity / self._signed_ratio, self._at_wheel(torque)
        )

    def follow_torque(self, torque: float) -> None:
        """Close the current loop at a torque [N m]."""
        self._wheels.command_torque(self._wheel, self._at_wheel(torque))

    def follow_voltage(self, voltage: float) -> None:
        """Apply a voltage [V]."""
        self._wheels.command_voltage(self._wheel, self._direction * voltage)

    def halt(self, deceleration: float) -> None:
        """Ramp to rest at a deceleration [rad/s^2], and hold."""
        self._wheels.halt(self._wheel, deceleration / self.gear_ratio)

    def release(self) -> None:
        """Switch the power off: the motor rotates freely."""
        self._wheels.release(self._wheel)

    def _at_wheel(self, torque: float) -> float:
        """Return the torque at the wheel [N m] for a torque at the motor [N m]."""
        current = self._direction * torque / self.torque_constant
        return self._wheels.units[self._wheel].torque_of(
            current, self._wheels.velocity(self._wheel)
        )
