"""The device profile of a simulated CiA 402 drive: power, modes of operation and measurements."""

import math
from dataclasses import dataclass

from omniman_ros.core.errors import ParameterError
from omniman_ros.drive.can.cia402_errors import (
    COMMUNICATION,
    HEARTBEAT,
    OVER_CURRENT,
    SENSOR,
    UNDER_VOLTAGE,
    Errors,
)
from omniman_ros.drive.can.cia402_machine import (
    FAULT_RESET,
    HALT,
    POWERED,
    TRANSITIONS,
    Command,
    State,
    command,
)
from omniman_ros.drive.can.cia402_objects import Key, Value
from omniman_ros.drive.can.motor import DriveFaults, Motor

TURN = 2.0 * math.pi
PROFILE_VELOCITY, PROFILE_TORQUE, SYNC_VELOCITY, SYNC_TORQUE = 3, 4, 9, 10
OTHER_MODE = 1
"""Profile position: what a drive shows that shows a wrong mode."""
LATEST = 1.0
"""A ramp to rest is given up when it is this late, s."""


@dataclass(frozen=True, kw_only=True)
class Cia402Settings:
    """What a drive has from its maker and its commissioning; at the motor's shaft.

    Attributes:
        counts: Units of 6064 per turn.
        velocity_scale: Units of 606C and 60FF per turn per second; of 6083 to 6085 the same per
            second.
        rated_torque, rated_current: 6076 and 6075, N m and A.
        quick_stop_deceleration, acceleration, deceleration: 6085, 6083 and 6084 after a start,
            rad/s^2.
        max_speed: Targets are clipped to it, rad/s.
        max_torque: The same, N m.
        undervoltage: Supply below which there is an error, V.
        standstill: Speed at which the motor is at rest, rad/s.
        modes: Modes of operation that it has: of 3, 4, 9 and 10.
        start_count: Of the encoder at the first start.
        boot_time: From power-on or a reset to the boot-up message, s.
        serial: Its serial number.
    """

    counts: float = 4096.0
    velocity_scale: float = 4096.0
    rated_torque: float = 1.0
    rated_current: float = 10.0
    quick_stop_deceleration: float = 100.0
    acceleration: float = 100.0
    deceleration: float = 100.0
    max_speed: float = math.inf
    max_torque: float = math.inf
    undervoltage: float = 0.0
    standstill: float = 1.0
    modes: tuple[int, ...] = (PROFILE_VELOCITY, PROFILE_TORQUE, SYNC_VELOCITY, SYNC_TORQUE)
    start_count: int = 0
    boot_time: float = 0.02
    serial: int = 0

    def __post_init__(self) -> None:
        for name in (
            "counts", "velocity_scale", "rated_torque", "rated_current", "acceleration",
            "quick_stop_deceleration", "deceleration", "max_speed", "max_torque", "standstill",
        ):  # fmt: skip
            if not getattr(self, name) > 0.0:
                raise ParameterError(name, getattr(self, name), "must be above 0")
        for mode in self.modes:
            if mode not in (PROFILE_VELOCITY, PROFILE_TORQUE, SYNC_VELOCITY, SYNC_TORQUE):
                raise ParameterError("modes", mode, "there are 3, 4, 9 and 10")


def wrapped(value: float, bits: int) -> int:
    """Return an integer as a counter of so many bits has it, signed."""
    half = 1 << (bits - 1)
    return (math.floor(value) + half) % (2 * half) - half


def clipped(value: float, bits: int, signed: bool = True) -> int:
    """Return an integer as near as so many bits allow."""
    low, high = (-(1 << (bits - 1)), (1 << (bits - 1)) - 1) if signed else (0, (1 << bits) - 1)
    return min(max(round(value), low), high)


class PowerDrive:
    """The part of the drive that knows of motion and of no frame.

    The torque limit 6072 holds in the torque modes. Setpoints are followed as they are, whenever
    they were given: a target velocity from before moves the motor as soon as it is enabled.

    Args:
        motor: The motor.
        settings: Of the drive.
        values: Values of all objects, which it reads and measures into.
        errors: Errors of the drive.

    Attributes:
        faults: Faults to play.
        state: Of the power state machine.
        mode: Mode of operation.
        remote: Whether the controlword is heard: the node is operational.
        connection_lost: Whether the host's heartbeat has failed and was not heard since.
    """

    def __init__(
        self, motor: Motor, settings: Cia402Settings, values: dict[Key, Value], errors: Errors
    ) -> None:
        self._motor, self._settings = motor, settings
        self._values, self._errors = values, errors
        self.faults = DriveFaults()
        self._origin = motor.position - settings.start_count * TURN / settings.counts
        self._now = -math.inf
        self._frozen: tuple[int, int] | None = None
        self._shown: int | None = None
        self.restart()

    def restart(self) -> None:
        """Begin anew: no power, objects of the profile as after a start."""
        s, values = self._settings, self._values
        scale = s.velocity_scale / TURN
        values[0x6075, 0] = clipped(1e3 * s.rated_current, 32, signed=False)
        values[0x6076, 0] = clipped(1e3 * s.rated_torque, 32, signed=False)
        values[0x6083, 0] = clipped(scale * s.acceleration, 32, signed=False)
        values[0x6084, 0] = clipped(scale * s.deceleration, 32, signed=False)
        values[0x6085, 0] = clipped(scale * s.quick_stop_deceleration, 32, signed=False)
        values[0x608F, 1] = clipped(s.counts, 32, signed=False)
        values[0x6502, 0] = sum(1 << (mode - 1) for mode in s.modes)
        self.state = State.SWITCH_ON_DISABLED
        self.mode = 0
        self.remote = self.connection_lost = False
        self._then: State | None = None
        self._ramp = (0.0, 0.0)
        self._word, self._commanded = 0, False
        self._reference = 0.0
        self._limited = False
        self._motor.release()

    def restart_count(self) -> None:
        """Let the encoder count from 0, where it is."""
        self._origin = self._motor.position

    # commands

    def write(self, index: int, value: int) -> None:
        """Take what was written into an object of the profile."""
        if index == 0x6060 and value in self._settings.modes:
            if value != self.mode:
                self._begin_mode(value)
        elif index == 0x6040:
            rising = value & ~self._word & FAULT_RESET
            self._word, self._commanded = value, True
            if rising and self.state is State.FAULT:
                self._reset()
            else:
                self._obey()

    def _begin_mode(self, mode: int) -> None:
        self.mode = mode
        torque = mode == PROFILE_TORQUE
        self._reference = self._motor.torque if torque else self._motor.velocity

    def _obey(self) -> None:
        """Do what the controlword says, one transition at a time."""
        asked = command(self._word)
        if self.state is State.ENABLED and self._then and asked is Command.ENABLE:
            self._then = None  # disabled by a ramp, which is not over: it goes on
            self._begin_mode(self.mode)
            return
        target = TRANSITIONS.get((self.state, asked))
        if target is None:
            return
        if self.state is State.QUICK_STOP:
            if self._then is State.FAULT:
                target = State.FAULT if asked is Command.DISABLE_VOLTAGE else None
            elif target is State.ENABLED and self._option(0x605A) < 5:
                target = None
            if target is None:
                return
        if target is State.ENABLED and self.faults.refuse_enable:
            return
        if self.state is State.ENABLED:
            option = {Command.SWITCH_ON: 0x605C, Command.SHUTDOWN: 0x605B}.get(asked)
            if option and self._option(option):
                if self._then is not target:
                    self._halt(0x6084, target)
                return
            if target is State.QUICK_STOP:
                self._quick_stop()
                return
        self._enter(target)

    def _enter(self, state: State) -> None:
        self.state, self._then = state, None
        if state is State.ENABLED:
            self._begin_mode(self.mode)
        elif state not in POWERED:
            self._motor.release()

    def _halt(self, deceleration: int, then: State | None) -> None:
        """Ramp to rest by an object's deceleration, and go over to a state; None: stay."""
        units = max(int(self._values[deceleration, 0]), 1)
        rate = units * TURN / self._settings.velocity_scale
        self._motor.halt(rate)
        self._then = then
        self._ramp = (self._now, abs(self._motor.velocity) / rate)

    def _quick_stop(self, then: State | None = None) -> None:
        option = self._option(0x605A)
        if option == 0:
            self._enter(then or State.SWITCH_ON_DISABLED)
            return
        self.state = State.QUICK_STOP
        if then is None and option in (1, 2):
            then = State.SWITCH_ON_DISABLED
        self._halt(0x6084 if option in (1, 5) else 0x6085, then)

    def _option(self, index: int) -> int:
        return int(self._values[index, 0])

    # errors

    def fault(self, code: int) -> None:
        """Go to fault, by the reaction that is configured (605E)."""
        self._errors.add(code)
        self._values[0x603F, 0] = code
        if self.state in (State.FAULT, State.FAULT_REACTION):
            return
        option = self._option(0x605E)
        if self.state not in POWERED or option == 0:
            self._enter(State.FAULT)
            return
        self.state = State.FAULT_REACTION
        self._halt(0x6084 if option == 1 else 0x6085, State.FAULT)

    def abort_connection(self, code: int = COMMUNICATION) -> None:
        """The host has gone, or has stopped the node: react as configured (6007)."""
        option = self._option(0x6007)
        if code == COMMUNICATION and self.state not in (State.ENABLED, State.QUICK_STOP):
            return  # a host may well stop a node that has no power
        self._commanded = option == 0  # what it has asked for counts no longer
        if option == 1:
            self.fault(code)
        elif option == 2 and self.state not in (State.FAULT, State.FAULT_REACTION):
            self._enter(State.SWITCH_ON_DISABLED)
        elif option == 3 and self.state in (State.ENABLED, State.QUICK_STOP):
            self._values[0x603F, 0] = code
            self._quick_stop(State.FAULT)
        elif option == 3 and self.state in (State.READY, State.SWITCHED_ON):
            self._enter(State.SWITCH_ON_DISABLED)

    def connection_failed(self) -> None:
        """The host's heartbeat was not heard in time."""
        self.connection_lost = True
        self._errors.add(HEARTBEAT)
        self.abort_connection(HEARTBEAT)

    def connection_back(self) -> None:
        """The host's heartbeat is heard again."""
        self.connection_lost = False
        if self.state is not State.FAULT and self._then is not State.FAULT:
            self._errors.remove(HEARTBEAT)

    def _causes(self) -> list[int]:
        """Errors that hold now."""
        causes = [OVER_CURRENT] if self.faults.fault else []
        if self.supply < self._settings.undervoltage:
            causes.append(UNDER_VOLTAGE)
        if self._motor.lost:
            causes.append(SENSOR)
        return causes

    def _reset(self) -> None:
        """Transition 15, if no error holds any more."""
        if self._causes() or self.connection_lost:
            return
        for code in tuple(self._errors.active):
            self._errors.remove(code)
        self._values[0x603F, 0] = 0
        self._enter(State.SWITCH_ON_DISABLED)

    # time

    def run(self, now: float) -> None:
        """Watch for errors, end ramps, do what the controlword says and follow the setpoints."""
        step, self._now = max(now - self._now, 0.0), max(now, self._now)
        for code in self._causes():
            if code not in self._errors.active:
                self.fault(code)
        begun, length = self._ramp
        if self._then is not None and self._now - begun >= length:
            late = self._now - begun - length > LATEST
            if late or abs(self._motor.velocity) < self._settings.standstill:
                self._enter(self._then)
        if self._commanded:
            self._obey()
        if self.state is State.ENABLED and self._then is None:
            self._follow(step if math.isfinite(step) else 0.0)

    def _follow(self, step: float) -> None:
        s, values = self._settings, self._values
        units = TURN / s.velocity_scale
        halted = bool(self._word & HALT)
        self._limited = False
        if self.mode == SYNC_VELOCITY:
            speed = units * (int(values[0x60FF, 0]) + int(values[0x60B1, 0]))
            self._motor.follow_velocity(self._bounded(speed, s.max_speed), self._torque(0x60B2))
        elif self.mode == PROFILE_VELOCITY:
            goal = 0.0 if halted else self._bounded(units * int(values[0x60FF, 0]), s.max_speed)
            slower = abs(goal) < abs(self._reference) or goal * self._reference < 0.0
            rate = units * int(values[0x6084 if slower else 0x6083, 0])
            self._reference = _towards(self._reference, goal, rate * step)
            self._motor.follow_velocity(self._reference)
        elif self.mode in (SYNC_TORQUE, PROFILE_TORQUE):
            limit = min(s.max_torque, 1e-3 * int(values[0x6072, 0]) * s.rated_torque)
            if self.mode == SYNC_TORQUE:
                self._reference = self._torque(0x6071) + self._torque(0x60B2)
            else:
                goal = 0.0 if halted else self._torque(0x6071)
                slope = 1e-3 * int(values[0x6087, 0]) * s.rated_torque
                self._reference = _towards(self._reference, goal, slope * step)
            self._motor.follow_torque(self._bounded(self._reference, limit))
        else:
            self._motor.follow_velocity(0.0)

    def _torque(self, index: int) -> float:
        return 1e-3 * int(self._values[index, 0]) * self._settings.rated_torque

    def _bounded(self, value: float, limit: float) -> float:
        self._limited = abs(value) > limit
        return min(max(value, -limit), limit)

    # measurements

    @property
    def supply(self) -> float:
        """Voltage of the supply, V."""
        return self.faults.supply or self._motor.supply

    def measure(self) -> None:
        """Bring the objects that tell of the drive up to date."""
        s, motor, values = self._settings, self._motor, self._values
        count = wrapped((motor.position - self._origin) * s.counts / TURN + 0.5, 32)
        speed = clipped(motor.velocity * s.velocity_scale / TURN, 32)
        if self.faults.frozen_encoder:
            self._frozen = self._frozen or (count, speed)
            count, speed = self._frozen
        else:
            self._frozen = None
        values[0x6064, 0], values[0x606C, 0] = count, speed
        values[0x6077, 0] = clipped(1e3 * motor.torque / s.rated_torque, 16)
        values[0x6078, 0] = clipped(1e3 * motor.current / s.rated_current, 16)
        values[0x6079, 0] = clipped(1e3 * self.supply, 32, signed=False)
        values[0x6061, 0] = OTHER_MODE if self.faults.wrong_mode else self.mode
        if not (self.faults.stuck_status and self._shown is not None):
            self._shown = self._statusword()
        values[0x6041, 0] = self._shown

    def _statusword(self) -> int:
        """CiA 402-2, 8.4.2; bits 10, 12 and 13 by mode."""
        word = self.state.value
        word |= 0x0010 if self.supply >= self._settings.undervoltage else 0
        word |= 0x0080 if self._errors.active and self.state is not State.FAULT else 0
        word |= 0x0200 if self.remote else 0
        enabled = self.state is State.ENABLED and self._then is None
        word |= 0x0800 if enabled and self._limited else 0
        if enabled and self.mode in (SYNC_VELOCITY, SYNC_TORQUE):
            word |= 0x1000  # follows the setpoint
        elif enabled and self.mode == PROFILE_VELOCITY:
            slow = abs(self._motor.velocity) < self._settings.standstill
            goal = int(self._values[0x60FF, 0]) * TURN / self._settings.velocity_scale
            near = abs(self._motor.velocity - goal) < self._settings.standstill
            word |= (0x1000 if slow else 0) | (0x0400 if near else 0)
        return word


def _towards(value: float, goal: float, change: float) -> float:
    """Return a value moved towards a goal by at most a change."""
    return min(max(goal, value - change), value + change)
