"""The shaft of one wheel's motor, on the plant: what a drive on a bus turns and measures."""

import math

from omniman_ros.core.errors import ParameterError
from omniman_ros.core.robot import Robot
from omniman_ros.drive.wheelset import Wheelset


class MotorShaft:
    """Converts between a wheel and its motor; a `Motor`.

    Torque at the motor is its torque constant times its current, before the gear's losses. The
    encoder is the robot's: its steps are seen through the gear.

    Args:
        wheels: The wheels.
        wheel: Number of this one.
        robot: The robot, for its motor.
        gear_ratio: Turns of the motor per turn of the wheel; 0 takes the robot's. The torque
            constant is then such that the wheel's is the robot's.
        direction: 1 where the wheel turns forward with positive turns of the motor, else -1.

    Attributes:
        gear_ratio: Turns of the motor per turn of the wheel, never negative.
        torque_constant: At the motor, N m/A.

    Raises:
        ParameterError: The gear ratio is negative or not finite, or the direction not 1 or -1.
    """

    def __init__(
        self,
        wheels: Wheelset,
        wheel: int,
        robot: Robot,
        gear_ratio: float = 0.0,
        direction: float = 1.0,
    ) -> None:
        if not (math.isfinite(gear_ratio) and gear_ratio >= 0.0):
            raise ParameterError("can.gear_ratio", gear_ratio, "0, or turns per turn of the wheel")
        if abs(direction) != 1.0:
            raise ParameterError("can.direction", direction, "1 or -1")
        self._wheels, self._wheel = wheels, wheel
        self._motor = robot.motor
        self.gear_ratio = gear_ratio or robot.motor.gear_ratio
        self._turns = direction * self.gear_ratio
        self._direction = direction
        self.torque_constant = (
            robot.motor.torque_constant * robot.motor.gear_ratio / self.gear_ratio
        )

    # measurements

    @property
    def position(self) -> float:
        """Angle, rad, not wrapped."""
        return self._turns * self._wheels.position(self._wheel)

    @property
    def velocity(self) -> float:
        """Speed, rad/s."""
        return self._turns * self._wheels.velocity(self._wheel)

    @property
    def torque(self) -> float:
        """Torque, N m, from the current."""
        return self.torque_constant * self.current

    @property
    def current(self) -> float:
        """Current, A."""
        return self._direction * self._wheels.current(self._wheel)

    @property
    def voltage(self) -> float:
        """Voltage at the motor, V."""
        return self._direction * self._wheels.voltage(self._wheel)

    @property
    def supply(self) -> float:
        """Voltage of the supply, V: the largest that the motor can be given."""
        return self._motor.max_voltage

    @property
    def lost(self) -> bool:
        """Whether the encoder is found to mislead."""
        return self._wheels.lost(self._wheel)

    # commands

    def follow_velocity(self, velocity: float, torque: float = 0.0) -> None:
        """Close the velocity loop: rad/s, with a feed-forward torque in N m."""
        self._wheels.command_velocity(self._wheel, velocity / self._turns, self._at_wheel(torque))

    def follow_torque(self, torque: float) -> None:
        """Close the current loop: N m."""
        self._wheels.command_torque(self._wheel, self._at_wheel(torque))

    def follow_voltage(self, voltage: float) -> None:
        """Give a voltage: V."""
        self._wheels.command_voltage(self._wheel, self._direction * voltage)

    def halt(self, deceleration: float) -> None:
        """Ramp to rest, rad/s^2, and hold."""
        self._wheels.halt(self._wheel, deceleration / self.gear_ratio)

    def release(self) -> None:
        """Take the power off: the motor turns freely."""
        self._wheels.release(self._wheel)

    def _at_wheel(self, torque: float) -> float:
        """Torque at the wheel whose current is that of a torque at the motor, N m."""
        current = self._direction * torque / self.torque_constant
        return self._wheels.units[self._wheel].torque_of(
            current, self._wheels.velocity(self._wheel)
        )
