"""Behaviour of a simulated ODrive axis: arming, errors, modes and limits."""

import math
from collections.abc import Callable
from dataclasses import dataclass

from omniman_ros.simulation.can_drives.motor import DriveMotor
from omniman_ros.simulation.can_drives.odrive.cansimple import (
    MODES,
    Control,
    Error,
    Input,
    OdriveAxisState,
    Result,
)
from omniman_ros.simulation.can_drives.odrive.settings import OdriveSettings

REVOLUTION = 2.0 * math.pi  #: Angle of one revolution [rad]
OVERSPEED = 1.2  #: Ratio of the speed at which the axis disarms itself to the limit


@dataclass(frozen=True, slots=True)
class AxisReadings:
    """Readings of an axis' hardware."""

    velocity: float  #: Velocity that the encoder measures [rev/s]
    supply: float  #: Supply voltage [V]
    has_driver_fault: bool  #: Whether the driver of the power stage reports a fault
    is_calibrated: bool  #: Whether the axis is calibrated; it cannot be armed otherwise


class SimulatedOdriveAxis:
    """Controller and power stage of an ODrive axis, without any frames.

    The axis is idle or in closed loop control. **A disarmed ODrive switches the power off: the
    axis becomes idle and the motor coasts; it neither ramps down nor holds.** The public documents
    describe no other reaction to errors, watchdog and Estop, but an output for a mechanical brake,
    which is engaged while the axis is idle (firmware 0.5, `Axis::run_idle_loop`):
    `brake_deceleration` models such a brake.

    Errors stay until Clear_Errors, and return at once if their cause persists: watchdog, Estop,
    supply below `min_supply`, speed over 1.2 times the velocity limit, a wrong encoder
    (SPINOUT_DETECTED), a fault of the driver (DRV_FAULT), an input that is not finite
    (MISSING_INPUT), a mode that is not modelled (BAD_CONFIG; firmware 0.5:
    ERROR_INVALID_INPUT_MODE). With an error the axis cannot be armed, which gives the result
    DISARMED. Inputs are kept when the axis is disarmed: a stale one moves the motor when the axis
    is armed again, as in firmware 0.5. They are 0 after a restart.

    Modelled: velocity control with feed-forward torque, torque control, both passed through or
    ramped; velocity clipped at the limit, torque at current limit times torque constant (in
    velocity control only the feed-forward: the loop is the motor's). Not modelled: calibration and
    other states (refused: INVALID_STATE), position control, gains, trajectories, INITIALIZING
    after a restart.

    Attributes:
        control: Control mode, whether it is modelled or not.
        input: Input mode, whether it is modelled or not.
        velocity: Input velocity [rev/s].
        torque: Input torque, or feed-forward torque [N m].
        velocity_limit: Velocity limit [rev/s].
        current_limit: Current limit [A].
    """

    def __init__(
        self, motor: DriveMotor, settings: OdriveSettings, read: Callable[[], AxisReadings]
    ) -> None:
        self._motor, self._settings, self._read = motor, settings, read
        self.restart(0.0)

    def restart(self, now: float) -> None:
        """Set the state as after power-up at `now` [s]."""
        self._driven_at = now
        self.errors = self.disarm_reason = Error.NONE
        self.result = Result.SUCCESS
        self.control, self.input = int(Control.VELOCITY), int(Input.PASSTHROUGH)
        self.velocity = self.torque = 0.0
        self._ramped_input = 0.0
        self.velocity_limit = self._settings.velocity_limit
        self.current_limit = self._settings.current_limit
        self._go_idle()

    def advance(self, now: float) -> None:
        """Check for errors, and command the motor if the axis is armed, at `now` [s]."""
        self._check_errors()
        self._drive(now)

    @property
    def is_armed(self) -> bool:
        """Whether the axis is in closed loop control."""
        return self.state is OdriveAxisState.CLOSED_LOOP

    def fail(self, error: Error, failed: bool = True) -> None:
        """Set an error if it is present (`failed`), and disarm the axis."""
        if not failed:
            return
        self.errors |= error
        if self.is_armed:
            self.disarm_reason |= error
            self.result = Result.DISARMED
            self._go_idle()

    def stop(self, now: float) -> None:
        """Disarm the axis with the error of an emergency stop."""
        self.fail(Error.ESTOP)

    def clear_errors(self, now: float) -> None:
        """Clear all errors; those whose causes are present return at once."""
        self.errors = self.disarm_reason = Error.NONE
        self._check_errors()

    def request_state(self, state: int, now: float) -> None:
        """Enter a state at `now` [s] if possible; `result` reports whether it was."""
        if state == OdriveAxisState.IDLE:
            self.result = Result.SUCCESS
            self._go_idle()
        elif state != OdriveAxisState.CLOSED_LOOP:
            self.result = Result.INVALID_STATE
        elif not self.is_armed:
            self._arm(now)

    def _arm(self, now: float) -> None:
        self._check_errors()
        if not self._read().is_calibrated:
            self.result = Result.NOT_CALIBRATED
        elif self.errors:
            self.result = Result.DISARMED
        else:
            self.state, self.result = OdriveAxisState.CLOSED_LOOP, Result.SUCCESS
            self._enter_mode(now)
            self.advance(now)

    def _go_idle(self) -> None:
        """Become idle: switch the motor's power off, and engage the brake if there is one."""
        self.state = OdriveAxisState.IDLE
        if self._settings.brake_deceleration:
            self._motor.halt(self._settings.brake_deceleration)
        else:
            self._motor.release()

    def _check_errors(self) -> None:
        readings = self._read()
        self.fail(Error.DRV_FAULT, readings.has_driver_fault)
        self.fail(Error.UNDER_VOLTAGE, readings.supply < self._settings.min_supply)
        self.fail(Error.SPINOUT, self._motor.lost)
        causes = (
            (Error.VELOCITY_LIMIT, abs(readings.velocity) > OVERSPEED * self.velocity_limit),
            (Error.BAD_CONFIG, (self.control, self.input) not in MODES),
            (Error.MISSING_INPUT, not math.isfinite(self.torque + self.velocity)),
        )
        for error, failed in causes:
            if self.is_armed:
                self.fail(error, failed)

    def set_mode(self, control: int, input_: int, now: float) -> None:
        """Set control mode and input mode, at `now` [s]."""
        if (control, input_) != (self.control, self.input):
            self.control, self.input = control, input_
            self._enter_mode(now)
        self.advance(now)

    def set_velocity(self, velocity: float, torque: float, now: float) -> None:
        """Set the input velocity [rev/s] with its feed-forward torque [N m], at `now` [s]."""
        self.velocity, self.torque = velocity, torque
        self.advance(now)

    def set_torque(self, torque: float, now: float) -> None:
        """Set the input torque [N m], at `now` [s]."""
        self.torque = torque
        self.advance(now)

    def set_limits(self, velocity: float, current: float, now: float) -> None:
        """Set the limits [rev/s, A], unless one is negative or not finite."""
        if 0.0 <= velocity < math.inf and 0.0 <= current < math.inf:
            self.velocity_limit, self.current_limit = velocity, current

    def _enter_mode(self, now: float) -> None:
        """Begin the ramps at the present speed or torque of the motor."""
        is_velocity = self.control == Control.VELOCITY
        self._ramped_input = self._read().velocity if is_velocity else self._motor.torque
        self._driven_at = now

    def _drive(self, now: float) -> None:
        dt, self._driven_at = max(now - self._driven_at, 0.0), now
        if not self.is_armed:
            return
        limit = self.current_limit * self._settings.torque_constant
        torque = min(max(self.torque, -limit), limit)
        if self.control == Control.TORQUE:
            if self.input == Input.TORQUE_RAMP:
                torque = self._ramp(torque, self._settings.torque_ramp * dt)
            self._motor.follow_torque(torque)
            return
        velocity = min(max(self.velocity, -self.velocity_limit), self.velocity_limit)
        if self.input == Input.VELOCITY_RAMP:
            velocity = self._ramp(velocity, self._settings.velocity_ramp * dt)
        self._motor.follow_velocity(velocity * REVOLUTION, torque)

    def _ramp(self, target: float, change: float) -> float:
        """Move the ramped input towards a target by at most `change`, and return it."""
        self._ramped_input += min(max(target - self._ramped_input, -change), change)
        return self._ramped_input
