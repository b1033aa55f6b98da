"""Device profile of a simulated CiA 402 drive: power, modes of operation, measurements."""

import math
from dataclasses import dataclass

from omniman_ros.core.errors import ParameterError
from omniman_ros.simulation.can_drives.cia402 import indices
from omniman_ros.simulation.can_drives.cia402.errors import (
    COMMUNICATION,
    HEARTBEAT,
    OVER_CURRENT,
    SENSOR,
    UNDER_VOLTAGE,
    Errors,
)
from omniman_ros.simulation.can_drives.cia402.objects import Key, Value
from omniman_ros.simulation.can_drives.cia402.state_machine import (
    FAULT_RESET,
    HALT,
    POWERED,
    TRANSITIONS,
    Cia402State,
    ControlwordCommand,
    command,
)
from omniman_ros.simulation.can_drives.motor import DriveFaults, DriveMotor

REVOLUTION = 2.0 * math.pi  #: Angle of one revolution [rad]
PROFILE_VELOCITY = 3  #: Mode of operation: profile velocity
PROFILE_TORQUE = 4  #: Mode of operation: profile torque
SYNC_VELOCITY = 9  #: Mode of operation: cyclic synchronous velocity
SYNC_TORQUE = 10  #: Mode of operation: cyclic synchronous torque
OTHER_MODE = 1  #: Mode that is reported with the fault `wrong_mode`: profile position
RAMP_MARGIN = 1.0  #: Time beyond its calculated end after which a ramp to rest is given up [s]


@dataclass(frozen=True, kw_only=True)
class Cia402Settings:
    """Hardware and commissioning of a drive; quantities at the motor's shaft.

    Raises:
        ParameterError: A number is not above zero, or a mode is unknown.
    """

    counts: float = 4096.0  #: Units of the position actual value (object 6064) per revolution
    #: Units of velocities (objects 606C, 60FF) per revolution per second, and units of
    #: accelerations (objects 6083 to 6085) per revolution per second squared.
    velocity_scale: float = 4096.0
    rated_torque: float = 1.0  #: Rated torque of the motor, object 6076 [N m]
    rated_current: float = 10.0  #: Rated current of the motor, object 6075 [A]
    quick_stop_deceleration: float = 100.0  #: Object 6085 after a start [rad/s^2]
    acceleration: float = 100.0  #: Profile acceleration, object 6083, after a start [rad/s^2]
    deceleration: float = 100.0  #: Profile deceleration, object 6084, after a start [rad/s^2]
    max_speed: float = math.inf  #: Speed to which targets are clipped [rad/s]
    max_torque: float = math.inf  #: Torque to which targets are clipped [N m]
    undervoltage: float = 0.0  #: Supply voltage below which there is an error [V]
    standstill: float = 1.0  #: Speed below which the motor counts as standing [rad/s]
    #: Supported modes of operation, among 3, 4, 9 and 10
    modes: tuple[int, ...] = (PROFILE_VELOCITY, PROFILE_TORQUE, SYNC_VELOCITY, SYNC_TORQUE)
    start_count: int = 0  #: Count of the encoder at the first start
    boot_time: float = 0.02  #: Time from power-on or a reset to the boot-up message [s]
    serial: int = 0  #: Serial number

    def __post_init__(self) -> None:
        for name in (
            "counts",
            "velocity_scale",
            "rated_torque",
            "rated_current",
            "acceleration",
            "quick_stop_deceleration",
            "deceleration",
            "max_speed",
            "max_torque",
            "standstill",
        ):
            if not getattr(self, name) > 0.0:
                raise ParameterError(name, getattr(self, name), "must be above 0")
        for mode in self.modes:
            if mode not in (PROFILE_VELOCITY, PROFILE_TORQUE, SYNC_VELOCITY, SYNC_TORQUE):
                raise ParameterError("modes", mode, "must be 3, 4, 9 or 10")


def wrapped(value: float, bits: int) -> int:
    """Return the reading of a signed counter with a width in bits."""
    half = 1 << (bits - 1)
    return (math.floor(value) + half) % (2 * half) - half


def clipped(value: float, bits: int, signed: bool = True) -> int:
    """Return the nearest integer that fits into a number of bits."""
    low, high = (-(1 << (bits - 1)), (1 << (bits - 1)) - 1) if signed else (0, (1 << bits) - 1)
    return min(max(round(value), low), high)


class PowerDrive:
    """Power stage and motion of a drive, without any frames.

    The torque limit (max torque, object 6072) applies in the torque modes. Setpoints are followed
    regardless of their age: an old target velocity moves the motor as soon as the drive is
    enabled.

    Attributes:
        remote: Whether the controlword is obeyed, which requires an operational node.
        connection_lost: Whether the host's heartbeat is missing.
    """

    def __init__(
        self, motor: DriveMotor, settings: Cia402Settings, values: dict[Key, Value], errors: Errors
    ) -> None:
        self._motor, self._settings = motor, settings
        self._values, self._errors = values, errors
        self.faults = DriveFaults()  #: Faults to simulate
        self._origin = motor.position - settings.start_count * REVOLUTION / settings.counts
        self._now = -math.inf
        self._frozen: tuple[int, int] | None = None
        self._reported_statusword: int | None = None
        self.restart()

    def restart(self) -> None:
        """Restart: switch the power off, and set the profile's objects to their initial values."""
        s, values = self._settings, self._values
        scale = s.velocity_scale / REVOLUTION
        values[indices.RATED_CURRENT, 0] = clipped(1e3 * s.rated_current, 32, signed=False)
        values[indices.RATED_TORQUE, 0] = clipped(1e3 * s.rated_torque, 32, signed=False)
        values[indices.ACCELERATION, 0] = clipped(scale * s.acceleration, 32, signed=False)
        values[indices.DECELERATION, 0] = clipped(scale * s.deceleration, 32, signed=False)
        values[indices.QUICK_STOP_DECELERATION, 0] = clipped(
            scale * s.quick_stop_deceleration, 32, signed=False
        )
        values[indices.ENCODER_RESOLUTION, 1] = clipped(s.counts, 32, signed=False)
        values[indices.SUPPORTED_MODES, 0] = sum(1 << (mode - 1) for mode in s.modes)
        self.state = Cia402State.SWITCH_ON_DISABLED
        self.mode = 0
        self.remote = self.connection_lost = False
        self._state_after_ramp: Cia402State | None = None
        self._ramp = (0.0, 0.0)
        self._word, self._commanded = 0, False
        self._reference = 0.0
        self._limited = False
        self._motor.release()

    def restart_count(self) -> None:
        """Set the encoder's count to 0 at the present position."""
        self._origin = self._motor.position

    # ---- commands -----------------------------------------------------------------------------

    def write(self, index: int, value: int) -> None:
        """Act on a value written into an object of the profile."""
        if index == indices.MODE and value in self._settings.modes:
            if value != self.mode:
                self._begin_mode(value)
        elif index == indices.CONTROLWORD:
            rising = value & ~self._word & FAULT_RESET
            self._word, self._commanded = value, True
            if rising and self.state is Cia402State.FAULT:
                self._reset()
            else:
                self._obey()

    def _begin_mode(self, mode: int) -> None:
        self.mode = mode
        torque = mode == PROFILE_TORQUE
        self._reference = self._motor.torque if torque else self._motor.velocity

    def _obey(self) -> None:
        word = command(self._word)
        if (
            self.state is Cia402State.ENABLED
            and self._state_after_ramp
            and word is ControlwordCommand.ENABLE
        ):
            self._state_after_ramp = None  # the ramp that would disable the drive is cancelled
            self._begin_mode(self.mode)
            return
        target = self._target(word)
        if target is None:
            return
        if self.state is Cia402State.ENABLED:
            self._leave_enabled(word, target)
        else:
            self._enter(target)

    def _target(self, word: ControlwordCommand) -> Cia402State | None:
        """Return the state to which a command leads now, or None if it leads to none."""
        target = TRANSITIONS.get((self.state, word))
        if self.state is Cia402State.QUICK_STOP and target is not None:
            if self._state_after_ramp is Cia402State.FAULT:
                return Cia402State.FAULT if word is ControlwordCommand.DISABLE_VOLTAGE else None
            if target is Cia402State.ENABLED and self._option(indices.QUICK_STOP_OPTION) < 5:
                return None
        return None if target is Cia402State.ENABLED and self.faults.refuse_enable else target

    def _leave_enabled(self, word: ControlwordCommand, target: Cia402State) -> None:
        """Leave ENABLED at once, by a ramp, or by a quick stop, as configured."""
        option = {
            ControlwordCommand.SWITCH_ON: indices.DISABLE_OPTION,
            ControlwordCommand.SHUTDOWN: indices.SHUTDOWN_OPTION,
        }.get(word)
        if option and self._option(option):
            if self._state_after_ramp is not target:
                self._halt(indices.DECELERATION, target)
        elif target is Cia402State.QUICK_STOP:
            self._quick_stop()
        else:
            self._enter(target)

    def _enter(self, state: Cia402State) -> None:
        self.state, self._state_after_ramp = state, None
        if state is Cia402State.ENABLED:
            self._begin_mode(self.mode)
        elif state not in POWERED:
            self._motor.release()

    def _halt(self, deceleration_index: int, next_state: Cia402State | None) -> None:
        """Ramp to rest at the deceleration of an object, then enter a state unless it is None."""
        units = max(int(self._values[deceleration_index, 0]), 1)
        rate = units * REVOLUTION / self._settings.velocity_scale
        self._motor.halt(rate)
        self._state_after_ramp = next_state
        self._ramp = (self._now, abs(self._motor.velocity) / rate)

    def _quick_stop(self, next_state: Cia402State | None = None) -> None:
        option = self._option(indices.QUICK_STOP_OPTION)
        if option == 0:
            self._enter(next_state or Cia402State.SWITCH_ON_DISABLED)
            return
        self.state = Cia402State.QUICK_STOP
        if next_state is None and option in (1, 2):
            next_state = Cia402State.SWITCH_ON_DISABLED
        self._halt(
            indices.DECELERATION if option in (1, 5) else indices.QUICK_STOP_DECELERATION,
            next_state,
        )

    def _option(self, index: int) -> int:
        return int(self._values[index, 0])

    # ---- errors -------------------------------------------------------------------------------

    def fault(self, code: int) -> None:
        """Enter FAULT by the configured fault reaction (object 605E)."""
        self._errors.add(code)
        self._values[indices.ERROR_CODE, 0] = code
        if self.state in (Cia402State.FAULT, Cia402State.FAULT_REACTION):
            return
        option = self._option(indices.FAULT_REACTION_OPTION)
        if self.state not in POWERED or option == 0:
            self._enter(Cia402State.FAULT)
            return
        self.state = Cia402State.FAULT_REACTION
        self._halt(
            indices.DECELERATION if option == 1 else indices.QUICK_STOP_DECELERATION,
            Cia402State.FAULT,
        )

    def abort_connection(self, code: int = COMMUNICATION) -> None:
        """React to the loss of the host, or to its NMT stop, as configured (object 6007)."""
        option = self._option(indices.ABORT_OPTION)
        if code == COMMUNICATION and self.state not in (
            Cia402State.ENABLED,
            Cia402State.QUICK_STOP,
        ):
            return  # a host may stop a node that has no power
        self._commanded = option == 0  # otherwise its commands no longer apply
        if option == 1:
            self.fault(code)
        elif option == 2 and self.state not in (Cia402State.FAULT, Cia402State.FAULT_REACTION):
            self._enter(Cia402State.SWITCH_ON_DISABLED)
        elif option == 3 and self.state in (Cia402State.ENABLED, Cia402State.QUICK_STOP):
            self._values[indices.ERROR_CODE, 0] = code
            self._quick_stop(Cia402State.FAULT)
        elif option == 3 and self.state in (Cia402State.READY, Cia402State.SWITCHED_ON):
            self._enter(Cia402State.SWITCH_ON_DISABLED)

    def connection_failed(self) -> None:
        """React to a missing heartbeat of the host."""
        self.connection_lost = True
        self._errors.add(HEARTBEAT)
        self.abort_connection(HEARTBEAT)

    def connection_back(self) -> None:
        """Record that the host's heartbeat has returned."""
        self.connection_lost = False
        if self.state is not Cia402State.FAULT and self._state_after_ramp is not Cia402State.FAULT:
            self._errors.remove(HEARTBEAT)

    def _causes(self) -> list[int]:
        """Return the codes of the errors whose cause is present."""
        causes = [OVER_CURRENT] if self.faults.fault else []
        if self.supply < self._settings.undervoltage:
            causes.append(UNDER_VOLTAGE)
        if self._motor.lost:
            causes.append(SENSOR)
        return causes

    def _reset(self) -> None:
        """Reset the fault (transition 15) unless a cause is still present."""
        if self._causes() or self.connection_lost:
            return
        for code in tuple(self._errors.active):
            self._errors.remove(code)
        self._values[indices.ERROR_CODE, 0] = 0
        self._enter(Cia402State.SWITCH_ON_DISABLED)

    # ---- time ---------------------------------------------------------------------------------

    def run(self, now: float) -> None:
        """Detect errors, end ramps, obey the controlword and follow setpoints up to a time [s]."""
        step, self._now = max(now - self._now, 0.0), max(now, self._now)
        for code in self._causes():
            if code not in self._errors.active:
                self.fault(code)
        start, duration = self._ramp
        if self._state_after_ramp is not None and self._now - start >= duration:
            is_late = self._now - start - duration > RAMP_MARGIN
            if is_late or abs(self._motor.velocity) < self._settings.standstill:
                self._enter(self._state_after_ramp)
        if self._commanded:
            self._obey()
        if self.state is Cia402State.ENABLED and self._state_after_ramp is None:
            self._follow(step if math.isfinite(step) else 0.0)

    def _follow(self, step: float) -> None:
        s, values = self._settings, self._values
        units = REVOLUTION / s.velocity_scale
        is_halted = bool(self._word & HALT)
        self._limited = False
        if self.mode == SYNC_VELOCITY:
            speed = units * (
                int(values[indices.TARGET_VELOCITY, 0]) + int(values[indices.VELOCITY_OFFSET, 0])
            )
            self._motor.follow_velocity(
                self._bounded(speed, s.max_speed), self._torque(indices.TORQUE_OFFSET)
            )
        elif self.mode == PROFILE_VELOCITY:
            target = units * int(values[indices.TARGET_VELOCITY, 0])
            goal = 0.0 if is_halted else self._bounded(target, s.max_speed)
            is_slower = abs(goal) < abs(self._reference) or goal * self._reference < 0.0
            rate_index = indices.DECELERATION if is_slower else indices.ACCELERATION
            rate = units * int(values[rate_index, 0])
            self._reference = _towards(self._reference, goal, rate * step)
            self._motor.follow_velocity(self._reference)
        elif self.mode in (SYNC_TORQUE, PROFILE_TORQUE):
            limit = min(s.max_torque, 1e-3 * int(values[indices.MAX_TORQUE, 0]) * s.rated_torque)
            if self.mode == SYNC_TORQUE:
                self._reference = self._torque(indices.TARGET_TORQUE) + self._torque(
                    indices.TORQUE_OFFSET
                )
            else:
                goal = 0.0 if is_halted else self._torque(indices.TARGET_TORQUE)
                slope = 1e-3 * int(values[indices.TORQUE_SLOPE, 0]) * s.rated_torque
                self._reference = _towards(self._reference, goal, slope * step)
            self._motor.follow_torque(self._bounded(self._reference, limit))
        else:
            self._motor.follow_velocity(0.0)

    def _torque(self, index: int) -> float:
        return 1e-3 * int(self._values[index, 0]) * self._settings.rated_torque

    def _bounded(self, value: float, limit: float) -> float:
        self._limited = abs(value) > limit
        return min(max(value, -limit), limit)

    # ---- measurements -------------------------------------------------------------------------

    @property
    def supply(self) -> float:
        """Supply voltage [V]."""
        return self.faults.supply or self._motor.supply

    def measure(self) -> None:
        """Update the objects that report the state of the drive."""
        s, motor, values = self._settings, self._motor, self._values
        count = wrapped((motor.position - self._origin) * s.counts / REVOLUTION + 0.5, 32)
        speed = clipped(motor.velocity * s.velocity_scale / REVOLUTION, 32)
        if self.faults.frozen_encoder:
            self._frozen = self._frozen or (count, speed)
            count, speed = self._frozen
        else:
            self._frozen = None
        values[indices.POSITION, 0], values[indices.VELOCITY, 0] = count, speed
        values[indices.TORQUE, 0] = clipped(1e3 * motor.torque / s.rated_torque, 16)
        values[indices.CURRENT, 0] = clipped(1e3 * motor.current / s.rated_current, 16)
        values[indices.SUPPLY_VOLTAGE, 0] = clipped(1e3 * self.supply, 32, signed=False)
        values[indices.MODE_DISPLAY, 0] = OTHER_MODE if self.faults.wrong_mode else self.mode
        if not (self.faults.stuck_status and self._reported_statusword is not None):
            self._reported_statusword = self._statusword()
        values[indices.STATUSWORD, 0] = self._reported_statusword

    def _statusword(self) -> int:
        """Return the statusword (CiA 402-2, 8.4.2); bits 10, 12 and 13 depend on the mode."""
        word = self.state.value
        word |= 0x0010 if self.supply >= self._settings.undervoltage else 0
        word |= 0x0080 if self._errors.active and self.state is not Cia402State.FAULT else 0
        word |= 0x0200 if self.remote else 0
        enabled = self.state is Cia402State.ENABLED and self._state_after_ramp is None
        word |= 0x0800 if enabled and self._limited else 0
        if enabled and self.mode in (SYNC_VELOCITY, SYNC_TORQUE):
            word |= 0x1000  # the drive follows the setpoint
        elif enabled and self.mode == PROFILE_VELOCITY:
            is_standing = abs(self._motor.velocity) < self._settings.standstill
            goal = (
                int(self._values[indices.TARGET_VELOCITY, 0])
                * REVOLUTION
                / self._settings.velocity_scale
            )
            has_reached_target = abs(self._motor.velocity - goal) < self._settings.standstill
            word |= (0x1000 if is_standing else 0) | (0x0400 if has_reached_target else 0)
        return word


def _towards(value: float, goal: float, change: float) -> float:
    return min(max(goal, value - change), value + change)
