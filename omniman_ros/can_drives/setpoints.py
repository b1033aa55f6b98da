"""Setpoints of all motors, from a fresh command to the wheels or else from a ramp to rest."""

import math
from collections.abc import Sequence

import numpy as np

from omniman_ros.can_drives.axis import REST, DriveAxis, DriveSetpoint
from omniman_ros.can_drives.transmission import Transmission, max_wheel_speed, transmissions
from omniman_ros.control.wheel_cascade import DriveMode, WheelCommand
from omniman_ros.core.arrays import Array
from omniman_ros.core.can_parameters import CanParameters
from omniman_ros.core.errors import InputError
from omniman_ros.core.platform import Platform


class SpeedRamp:
    """Ramps the speeds of all wheels in proportion, so that the robot stays on its curve."""

    def __init__(self, n: int) -> None:
        self._speeds: Array = np.zeros(n)
        self._at: float | None = None
        self._is_catching_up = True

    def rest(self) -> None:
        """Set all speeds to zero; the next command is approached by a ramp."""
        self._speeds = np.zeros_like(self._speeds)
        self._at, self._is_catching_up = None, True

    def begin(self, speeds: Array, at: float | None = None) -> None:
        """Start from speeds (n,) [rad/s] of a time [s], or else of the next call's."""
        self._speeds, self._at, self._is_catching_up = speeds, at, True

    def step_to_rest(self, deceleration: float, now: float) -> Array:
        """Return the next speeds (n,) [rad/s] of the ramp to rest of the fastest wheel.

        Args:
            deceleration: Deceleration of the fastest wheel [rad/s^2].
        """
        step, fastest = self._step(deceleration, now), float(np.abs(self._speeds).max())
        self._is_catching_up = True
        scale = 1.0 - step / fastest if fastest > step else 0.0
        self._speeds = self._speeds * scale
        return self._speeds

    def step_towards(self, target: Array, acceleration: float, now: float) -> Array:
        """Return the next speeds (n,) [rad/s] on the ramp to a command, then the command.

        Args:
            acceleration: Acceleration of the wheel with the largest change [rad/s^2].
        """
        step = self._step(acceleration, now)
        if self._is_catching_up:
            change = target - self._speeds
            largest = float(np.abs(change).max())
            if largest > step:
                self._speeds = self._speeds + change * (step / largest)
                return self._speeds
            self._is_catching_up = False
        self._speeds = target
        return target

    def _step(self, rate: float, now: float) -> float:
        last, self._at = self._at, now
        return rate * max(now - last, 0.0) if last is not None else 0.0


class SetpointGenerator:
    """Converts wheel commands into setpoints at the motors.

    A stale command becomes a ramp to rest on the curve that the robot is on.
    """

    def __init__(
        self, axes: Sequence[DriveAxis], robot: Platform, parameters: CanParameters
    ) -> None:
        self._axes = axes
        self._ramp = SpeedRamp(len(axes))
        self._command: WheelCommand | None = None
        self._commanded_at = -math.inf
        self.update_parameters(robot, parameters)

    def update_parameters(self, robot: Platform, parameters: CanParameters) -> None:
        """Replace limits and timeouts."""
        self._parameters = parameters
        self._gears: tuple[Transmission, ...] = transmissions(robot, parameters)
        self._mode = DriveMode(parameters.mode)
        self.max_speed = max_wheel_speed(robot, parameters)

    def check(self, command: WheelCommand, at: float, now: float) -> None:
        """Check that a command is valid and fresh.

        Raises:
            InputError: The command is stale, its mode is not the installation's, or it has values
                that are not finite or beyond the limits.
        """
        values = command.effort if command.velocity is None else command.velocity
        if self._is_stale(at, now):
            raise InputError(f"the command is stale, {now - at:.3f} s old")
        if command.mode not in (DriveMode.VELOCITY, self._mode):
            raise InputError(
                f"it is a {command.mode.value} command; can.mode is {self._mode.value}"
            )
        if values.shape != (len(self._axes),) or command.effort.shape != values.shape:
            raise InputError(f"must be {len(self._axes)} values, one per wheel, got {values.size}")
        if not (np.isfinite(values).all() and np.isfinite(command.effort).all()):
            raise InputError(f"must be finite: {values.tolist()} {command.effort.tolist()}")
        if command.velocity is not None:
            fastest = float(np.abs(command.velocity).max())
            if fastest > self.max_speed:
                raise InputError(
                    f"fastest wheel {fastest:.1f} rad/s; the limit is {self.max_speed:.1f} rad/s"
                )

    def set_command(self, command: WheelCommand, at: float) -> None:
        """Follow a checked command, whose age counts from the time `at` [s], until it is stale."""
        self._command, self._commanded_at = command, at

    def drop_command(self) -> None:
        """Discard the last command, and rest: no earlier command moves a wheel afterwards."""
        self._command, self._commanded_at = None, -math.inf
        self._ramp.rest()

    def _is_stale(self, at: float, now: float) -> bool:
        return now - at > self._parameters.command_timeout

    def begin_ramp(self, speeds: Array, at: float | None = None) -> None:
        """Begin a ramp at wheel speeds (n,) [rad/s], at a time [s] or, if None, the next call."""
        self._ramp.begin(speeds, at)

    def resting(self) -> list[DriveSetpoint]:
        """Return setpoints of zero velocity, without a ramp."""
        self._ramp.rest()
        return [REST] * len(self._axes)

    def stopping(self, now: float) -> list[DriveSetpoint]:
        """Return the setpoints of a quick stop."""
        return self._from_speeds(
            self._ramp.step_to_rest(self._parameters.quick_stop_deceleration, now)
        )

    def driving(self, speeds: Array, now: float) -> list[DriveSetpoint]:
        """Return the setpoints that follow the command, or ramp to rest if it is stale.

        Args:
            speeds: Measured wheel speeds (n,) [rad/s], at which a ramp after torques or voltages
                begins.
        """
        p = self._parameters
        command = self._command
        if command is None or self._is_stale(self._commanded_at, now):
            self._command = None
            return self._from_speeds(self._ramp.step_to_rest(p.deceleration, now))
        if command.velocity is not None:
            targets = self._ramp.step_towards(command.velocity, p.acceleration, now)
            return self._from_speeds(targets, command.effort)
        self._ramp.begin(speeds)  # a ramp that follows begins at the measured speeds
        return self._from_efforts(command)

    def _from_speeds(self, speeds: Array, efforts: Array | None = None) -> list[DriveSetpoint]:
        targets = speeds.tolist()
        torques = [0.0] * len(targets) if efforts is None else efforts.tolist()
        return [
            gear.setpoint(DriveMode.VELOCITY, speed, torque, 0.0)
            for gear, speed, torque in zip(self._gears, targets, torques, strict=True)
        ]

    def _from_efforts(self, command: WheelCommand) -> list[DriveSetpoint]:
        setpoints = []
        efforts = command.effort.tolist()
        for gear, axis, value in zip(self._gears, self._axes, efforts, strict=True):
            speed = axis.feedback.velocity / gear.ratio
            setpoint = gear.setpoint(command.mode, 0.0, value, speed)
            if setpoint.mode not in axis.modes:
                setpoint = gear.voltage_to_torque(setpoint, axis.feedback)
            setpoints.append(setpoint)
        return setpoints
