"""Conversion between wheels and motor shafts by gear, direction of rotation and motor model."""

import math
from dataclasses import dataclass

from omniman_ros.can_drives.axis import AxisSettings, DriveSetpoint, Feedback
from omniman_ros.control.wheel_cascade import DriveMode
from omniman_ros.core.can_parameters import HEADROOM, CanParameters
from omniman_ros.core.platform import Platform


@dataclass(frozen=True)
class Transmission:
    """Gear and motor of one wheel, with the nominal values of the robot's parameters."""

    #: Motor revolutions per wheel revolution, negative if a rising motor position rotates the
    #: wheel backward.
    ratio: float
    efficiency: float  #: Efficiency of the gear
    torque_constant: float  #: K of the motor [N m/A] or [V s/rad]
    resistance: float  #: Resistance of the motor [ohm]
    max_voltage: float  #: Largest voltage of the motor [V]
    max_torque: float  #: Largest torque at the wheel [N m]

    def to_motor(self, torque: float, velocity: float) -> float:
        """Return the torque at the motor [N m] for a torque at the wheel.

        The side that drives, motor or wheel, supplies the gear's loss (CCTA 2017 (21), (22) with
        the gear).

        Args:
            torque: Torque at the wheel [N m]; it is clipped to `max_torque`.
            velocity: Speed of the wheel [rad/s].
        """
        torque = min(max(torque, -self.max_torque), self.max_torque)
        factor = 1.0 / self.efficiency if _is_driving(torque, velocity) else self.efficiency
        return torque * factor / self.ratio

    def to_wheel(self, torque: float, velocity: float) -> float:
        """Return the torque at the wheel for one at the motor [N m] and a wheel speed [rad/s]."""
        lossless = torque * self.ratio
        is_driving = _is_driving(lossless, velocity)
        return lossless * self.efficiency if is_driving else lossless / self.efficiency

    def setpoint(
        self, mode: DriveMode, value: float, effort: float, velocity: float
    ) -> DriveSetpoint:
        """Return the setpoint at the motor's shaft for a command to the wheel.

        Args:
            value: Wheel speed [rad/s] in velocity mode; unused in others.
            effort: Torque at the wheel [N m], the feed-forward in velocity mode and the command in
                torque mode; motor voltage [V] in voltage mode.
        """
        if mode is DriveMode.VELOCITY:
            return DriveSetpoint(mode, value * self.ratio, self.to_motor(effort, value))
        if mode is DriveMode.TORQUE:
            return DriveSetpoint(mode, self.to_motor(effort, velocity))
        return DriveSetpoint(mode, math.copysign(1.0, self.ratio) * effort)

    def voltage_to_torque(self, setpoint: DriveSetpoint, feedback: Feedback) -> DriveSetpoint:
        """Return the torque setpoint that replaces a voltage setpoint at the motor's shaft.

        The torque is tau = K (V - K w) / R (MPC 2021 (21), L = 0). The measured supply voltage
        limits the voltage, as it does at the motor.

        Args:
            setpoint: Setpoint of the motor voltage [V].
        """
        supply = feedback.bus_voltage
        limit = min(supply, self.max_voltage) if supply > 0.0 else self.max_voltage
        volts = min(max(setpoint.value, -limit), limit)
        speed = feedback.velocity if math.isfinite(feedback.velocity) else 0.0
        k = self.torque_constant
        torque = k * (volts - k * speed) / self.resistance
        max_motor_torque = self.max_torque / abs(self.ratio)
        torque = min(max(torque, -max_motor_torque), max_motor_torque)
        return DriveSetpoint(DriveMode.TORQUE, torque)

    def electrical(self, feedback: Feedback) -> tuple[float, float]:
        """Return voltage [V] and current [A] of the motor, in the wheel's direction of rotation.

        If the drive does not report its voltage, that of the motor model is returned, K w + R i.
        Unknown values are NaN.
        """
        sign = math.copysign(1.0, self.ratio)
        voltage = feedback.voltage
        if not math.isfinite(voltage):
            k = self.torque_constant
            voltage = k * feedback.velocity + self.resistance * feedback.current
        return sign * voltage, sign * feedback.current


def transmissions(robot: Platform, p: CanParameters) -> tuple[Transmission, ...]:
    """Return the transmission of each wheel, in the robot's order."""
    motor = robot.motor
    ratio = p.gear_ratio or motor.gear_ratio
    motor_max_torque = motor.max_current * motor.torque_constant * ratio * motor.gear_efficiency
    return tuple(
        Transmission(
            ratio=direction * ratio,
            efficiency=motor.gear_efficiency,
            torque_constant=motor.torque_constant,
            resistance=motor.resistance,
            max_voltage=motor.max_voltage,
            max_torque=p.max_torque or motor_max_torque,
        )
        for direction in p.directions(robot.wheel_count)
    )


def max_wheel_speed(robot: Platform, p: CanParameters) -> float:
    """Return the largest wheel speed that a command may have [rad/s]."""
    return p.max_speed or HEADROOM * robot.motor.max_speed


def axis_settings(robot: Platform, p: CanParameters) -> tuple[AxisSettings, ...]:
    """Return the axes' settings in the robot's order; raise ParameterError if they do not fit."""
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


def _is_driving(torque: float, velocity: float) -> bool:
    """Return whether a torque drives the motion or is not opposed to it.

    Signs are compared, because the product of tiny numbers would be 0.
    """
    return not (torque < 0.0 < velocity or velocity < 0.0 < torque)
