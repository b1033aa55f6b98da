"""Between wheels and the shafts of their motors: gears, directions, and the motors' own law."""

import math
from dataclasses import dataclass

from omniman_ros.can_drive.axis import AxisSettings, Feedback, Setpoint
from omniman_ros.core.can_parameters import HEADROOM, CanParameters
from omniman_ros.core.robot import Robot
from omniman_ros.core.wheel_cascade import DriveMode


@dataclass(frozen=True)
class Transmission:
    """Gear and motor of one wheel, nominal values of the robot's data.

    Attributes:
        ratio: Turns of the motor per turn of the wheel, negative where it counts backwards.
        efficiency: Of the gear.
        torque_constant: K, N m/A or V s/rad at the motor.
        resistance: ohm.
        max_voltage: V.
        max_torque: At the wheel, N m.
    """

    ratio: float
    efficiency: float
    torque_constant: float
    resistance: float
    max_voltage: float
    max_torque: float

    def to_motor(self, torque: float, velocity: float) -> float:
        """Torque at the motor for one at the wheel that turns at `velocity`; N m, rad/s.

        The gear takes its loss from whatever drives (CCTA 2017 (21), (22) with the gear).
        """
        torque = min(max(torque, -self.max_torque), self.max_torque)
        share = 1.0 / self.efficiency if _drives(torque, velocity) else self.efficiency
        return torque * share / self.ratio

    def to_wheel(self, torque: float, velocity: float) -> float:
        """Torque at the wheel for one at the motor; N m, wheel speed in rad/s."""
        wheel = torque * self.ratio
        return wheel * self.efficiency if _drives(wheel, velocity) else wheel / self.efficiency

    def setpoint(self, mode: DriveMode, value: float, effort: float, velocity: float) -> Setpoint:
        """Setpoint at the motor's shaft.

        Args:
            mode: Of the command.
            value: Wheel speed, rad/s, where that is the mode.
            effort: Wheel torque (or feed-forward), N m; volts in voltage mode.
            velocity: Measured wheel speed, rad/s.
        """
        if mode is DriveMode.VELOCITY:
            return Setpoint(mode, value * self.ratio, self.to_motor(effort, value))
        if mode is DriveMode.TORQUE:
            return Setpoint(mode, self.to_motor(effort, velocity))
        return Setpoint(mode, math.copysign(1.0, self.ratio) * effort)

    def as_torque(self, setpoint: Setpoint, feedback: Feedback) -> Setpoint:
        """The torque that a voltage would make: tau = K (V - K w) / R (MPC 2021 (21), L = 0).

        The measured supply bounds the voltage, as it would at the motor itself.

        Args:
            setpoint: Voltage at the motor, V.
            feedback: Speed of the motor and supply.
        """
        supply = feedback.bus_voltage
        limit = min(supply, self.max_voltage) if supply > 0.0 else self.max_voltage
        volts = min(max(setpoint.value, -limit), limit)
        speed = feedback.velocity if math.isfinite(feedback.velocity) else 0.0
        k = self.torque_constant
        torque = k * (volts - k * speed) / self.resistance
        bound = self.max_torque / abs(self.ratio)
        return Setpoint(DriveMode.TORQUE, min(max(torque, -bound), bound))

    def electrical(self, feedback: Feedback) -> tuple[float, float]:
        """Voltage and current of the motor, V and A, in the wheel's direction; NaN if unknown.

        Where the drive does not tell the voltage it is what the motor's law asks: K w + R i.
        """
        sign = math.copysign(1.0, self.ratio)
        voltage = feedback.voltage
        if not math.isfinite(voltage):
            k = self.torque_constant
            voltage = k * feedback.velocity + self.resistance * feedback.current
        return sign * voltage, sign * feedback.current


def transmissions(robot: Robot, p: CanParameters) -> tuple[Transmission, ...]:
    """One per wheel, in the robot's order."""
    motor = robot.motor
    ratio = p.gear_ratio or motor.gear_ratio
    most = motor.max_current * motor.torque_constant * ratio * motor.gear_efficiency
    return tuple(
        Transmission(
            ratio=direction * ratio,
            efficiency=motor.gear_efficiency,
            torque_constant=motor.torque_constant,
            resistance=motor.resistance,
            max_voltage=motor.max_voltage,
            max_torque=p.max_torque or most,
        )
        for direction in p.directions(robot.wheel_count)
    )


def max_wheel_speed(robot: Robot, p: CanParameters) -> float:
    """Largest wheel speed that is taken, rad/s."""
    return p.max_speed or HEADROOM * robot.motor.max_speed


def axis_settings(robot: Robot, p: CanParameters) -> tuple[AxisSettings, ...]:
    """What each axis is told, wheels in the robot's order.

    Raises:
        ParameterError: The installation does not fit the robot.
    """
    p.check(robot)
    gears = transmissions(robot, p)
    speed = max_wheel_speed(robot, p)
    return tuple(
        AxisSettings(
            name=name,
            node=node,
            period=p.period,
            counts=p.counts,
            velocity_scale=p.velocity_scale or p.counts,
            pole_pairs=p.pole_pairs,
            torque_constant=robot.motor.torque_constant,
            rated_torque=p.rated_torque,
            mode=DriveMode(p.mode),
            feed_forward=p.feed_forward,
            max_speed=speed * abs(gear.ratio),
            max_torque=gear.max_torque / (abs(gear.ratio) * gear.efficiency),
            quick_stop_deceleration=p.quick_stop_deceleration * abs(gear.ratio),
            heartbeat_timeout=p.heartbeat_timeout,
            drive_heartbeat=p.drive_heartbeat,
            feedback_timeout=p.feedback_timeout,
        )
        for name, node, gear in zip(robot.wheels.names, p.nodes, gears, strict=True)
    )


def _drives(torque: float, velocity: float) -> bool:
    """Whether a torque drives what turns; by signs, as a product of the smallest numbers is 0."""
    return not (torque < 0.0 < velocity or velocity < 0.0 < torque)
