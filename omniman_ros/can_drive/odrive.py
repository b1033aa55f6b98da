"""ODrive on CAN: the CANSimple protocol of firmware 0.5 and 0.6.

Source: docs.odriverobotics.com, "CAN Protocol"; Firmware/communication/can/can_simple.cpp, github.
com/odriverobotics/ODrive. 11-bit ids, node << 5 | command; little-endian, 8 bytes. What the drive
has to be told beforehand, by USB: node id and bit rate, `heartbeat_rate_ms` as `can.drive_
heartbeat` (its default is 100 ms), `encoder_rate_ms` as `can.feedback_period`, and its watchdog.

The watchdog is fed by any frame to the axis, requests too (do_command, axis.watchdog_feed): it
tells that this host ticks, not that its setpoints are fresh. A host with nothing fresh to say
has to fall silent altogether, or to say zero. Without `enable_watchdog` and `watchdog_timeout` in
the drive it goes on with the last setpoint for ever when the host dies.

Nothing is acknowledged: what was asked for is asked for again where the heartbeat shows that it
did not happen. The controller's mode cannot be read back; it is sent before each enabling.
"""

import math
import struct
from collections.abc import Callable, Collection
from enum import IntEnum

from omniman_ros.can_drive.axis import (
    AxisSettings,
    AxisState,
    Demand,
    Feedback,
    Receipt,
    Setpoint,
)
from omniman_ros.can_drive.checks import clipped, positive, reachable
from omniman_ros.can_drive.frame import Frame
from omniman_ros.core.wheel_cascade import DriveMode


class Command(IntEnum):
    """Lower five bits of an id."""

    VERSION = 0x00
    HEARTBEAT = 0x01
    ERROR = 0x03
    ENCODER_ERROR = 0x04
    SDO = 0x05
    AXIS_STATE = 0x07
    ENCODER = 0x09
    ENCODER_COUNT = 0x0A
    CONTROLLER_MODE = 0x0B
    INPUT_POSITION = 0x0C
    INPUT_VELOCITY = 0x0D
    INPUT_TORQUE = 0x0E
    LIMITS = 0x0F
    IQ = 0x14
    TEMPERATURE = 0x15
    REBOOT = 0x16
    BUS = 0x17
    CLEAR_ERRORS = 0x18
    ABSOLUTE_POSITION = 0x19
    TORQUES = 0x1C
    POWERS = 0x1D


COMMANDS = (
    Command.AXIS_STATE, Command.CONTROLLER_MODE, Command.INPUT_POSITION, Command.INPUT_VELOCITY,
    Command.INPUT_TORQUE, Command.LIMITS, Command.REBOOT, Command.CLEAR_ERRORS,
    Command.ABSOLUTE_POSITION,
)  # fmt: skip
"""What only a host sends; an emergency stop (0x02) may come from anyone."""

OTHERS = (
    Command.VERSION, Command.ERROR, Command.ENCODER_ERROR, Command.SDO, Command.ENCODER_COUNT,
    Command.TEMPERATURE, Command.TORQUES, Command.POWERS,
)  # fmt: skip
"""Reports that are not needed here."""

HEARTBEAT = struct.Struct("<IBBBB")
"""Axis error; axis state; then flags that differ between the firmwares."""
FLOATS = struct.Struct("<ff")
"""Encoder: turns, turns/s. Input velocity: turns/s, N m. Limits: turns/s, A. Iq: setpoint and
measured, A. Bus: V, A. Input torque: N m, nothing."""
NUMBERS = struct.Struct("<II")
"""Axis state, nothing. Controller mode: control mode, input mode."""

IDLE, CLOSED_LOOP = 1, 8
"""Axis states."""
PASSTHROUGH = 1
"""Input mode."""
CONTROL_MODES = {DriveMode.TORQUE: 1, DriveMode.VELOCITY: 2}

ERRORS = {
    0: "INITIALIZING", 1: "SYSTEM_LEVEL", 2: "TIMING_ERROR", 3: "MISSING_ESTIMATE",
    4: "BAD_CONFIG", 5: "DRV_FAULT", 6: "MISSING_INPUT", 8: "DC_BUS_OVER_VOLTAGE",
    9: "DC_BUS_UNDER_VOLTAGE", 10: "DC_BUS_OVER_CURRENT", 11: "DC_BUS_OVER_REGEN_CURRENT",
    12: "CURRENT_LIMIT_VIOLATION", 13: "MOTOR_OVER_TEMP", 14: "INVERTER_OVER_TEMP",
    15: "VELOCITY_LIMIT_VIOLATION", 16: "POSITION_LIMIT_VIOLATION", 24: "WATCHDOG_TIMER_EXPIRED",
    25: "ESTOP_REQUESTED", 26: "SPINOUT_DETECTED", 27: "BRAKE_RESISTOR_DISARMED",
    28: "THERMISTOR_DISCONNECTED", 30: "CALIBRATION_ERROR",
}  # fmt: skip
"""Bits of the axis error, firmware 0.6 (ODrive.Error)."""

ERRORS_05 = {
    0: "INVALID_STATE", 6: "MOTOR_FAILED", 7: "SENSORLESS_ESTIMATOR_FAILED", 8: "ENCODER_FAILED",
    9: "CONTROLLER_FAILED", 11: "WATCHDOG_TIMER_EXPIRED", 12: "MIN_ENDSTOP_PRESSED",
    13: "MAX_ENDSTOP_PRESSED", 14: "ESTOP_REQUESTED", 17: "HOMING_WITHOUT_ENDSTOP",
    18: "OVER_TEMP", 19: "UNKNOWN_POSITION",
}  # fmt: skip
"""The same, firmware 0.5 (ODrive.Axis.Error)."""

MISSED_HEARTBEATS = 3
"""Heartbeats after which it is lost, and after which what it was asked is asked again."""
REQUEST_PERIOD = 0.1
"""Time between requests for what does not come by itself [s]."""


def error_text(error: int) -> str:
    """Name an axis error in both firmwares: a heartbeat does not tell which of them it is."""
    names = []
    for table, firmware in ((ERRORS, "0.6"), (ERRORS_05, "0.5")):
        bits = [bit for bit in range(32) if error >> bit & 1]
        if all(bit in table for bit in bits):
            names.append(f"{', '.join(table[bit] for bit in bits)} (firmware {firmware})")
    return f"axis error 0x{error:08X}: {' or '.join(names) or 'unknown'}"


class OdriveAxis:
    """One axis of an ODrive.

    Velocity and torque, both passed through to its controller without ramps; voltage is nothing
    that it takes. The feed-forward torque of a velocity goes along if `feed_forward` is set.

    `configure` says zero, asks for IDLE, sets the mode and the limits, and waits for a heartbeat
    with IDLE and without error and for an encoder report. With Demand.DRIVE it says zero, sets
    mode and limits again, and asks for closed loop; it is ENABLED when the heartbeat shows that.
    With Demand.STOP it follows the setpoint. With Demand.IDLE, or where it is not ENABLED, it says
    zero each period, which feeds the watchdog, and asks for IDLE until the heartbeat shows it.

    There is no boot-up frame. A drive that left closed loop unasked, or whose position made a step
    that no shaft can do, is taken for restarted: OFFLINE. The position is continued over it.

    Torque is the measured Iq times the torque constant: with firmware 0.5 and a motor whose
    `direction` was calibrated as -1 its sign is not that of the encoder's.

    Positions are float32 turns: from 4096 turns on they have steps of 1/2048 turn (3 mrad), from
    131,072 of 1/64 (0.1 rad), of the motor. Restart a drive that is to run further than that.
    """

    def __init__(self, settings: AxisSettings) -> None:
        positive(settings, "torque_constant", "period", "drive_heartbeat", "feedback_timeout")
        self.settings = settings
        self.state = AxisState.OFFLINE
        self.trouble = ""
        self.feedback = Feedback()
        self.modes: Collection[DriveMode] = tuple(CONTROL_MODES)
        self.command_ids: Collection[tuple[int, bool]] = frozenset(
            (settings.node << 5 | command, False) for command in COMMANDS
        )
        self._readers: dict[int, Callable[[bytes, float], bool]] = {
            Command.HEARTBEAT: self._take_heartbeat,
            Command.ENCODER: self._take_encoder,
            Command.IQ: self._take_iq,
            Command.BUS: self._take_bus,
        }
        self._patience = MISSED_HEARTBEATS * settings.drive_heartbeat + settings.period
        self._mode: DriveMode | None = None
        self._axis_state: int | None = None
        self._heartbeat_at = -math.inf
        self._began_at = -math.inf
        self._forgiven_until = -math.inf
        self._clearing = False
        self._requested: int | None = None
        self._requested_at = -math.inf
        self._turns: float | None = None
        self._offset = 0.0
        self._heard = {Command.IQ: -math.inf, Command.BUS: -math.inf}
        self._asked_at = -math.inf

    def configure(self, now: float) -> None:
        """See `Axis`."""
        self.state, self.trouble = AxisState.CONFIGURING, ""
        self._began_at = now
        self._clearing = False
        self._forgiven_until = -math.inf
        self._requested = self._mode = None

    def reset(self, now: float) -> None:
        """See `Axis`: in trouble or OFFLINE, its errors are cleared and it is configured again."""
        if self.trouble or self.state in (AxisState.OFFLINE, AxisState.FAULT):
            self.configure(now)
            self._clearing = True

    def receive(self, frame: Frame, now: float) -> Receipt:
        """See `Axis`: remote frames are requests, of a host; they are foreign."""
        node, command = divmod(frame.id, 32)
        read = self._readers.get(command)
        if node != self.settings.node or frame.remote or (read is None and command not in OTHERS):
            return Receipt.FOREIGN
        if frame.extended or len(frame.data) < 8:
            return Receipt.MALFORMED
        if read is not None and not read(frame.data, now):
            return Receipt.MALFORMED
        return Receipt.TAKEN

    def tick(self, demand: Demand, setpoint: Setpoint, now: float) -> list[Frame]:
        """See `Axis`: one frame, more where something begins, is repeated or is requested.

        Raises:
            ValueError: The setpoint is not finite.
        """
        setpoint = clipped(setpoint, self.settings)
        watched = self.state in (AxisState.READY, AxisState.ENABLED)
        if watched and now - self._heartbeat_at > self._patience:
            self.trouble = self.trouble or "its heartbeat is missing"
        driven = self._requested == CLOSED_LOOP
        if self.state is AxisState.CONFIGURING:
            frames = self._set_up(now)
        elif self.state is AxisState.ENABLED and driven and demand is not Demand.IDLE:
            frames = self._follow(setpoint)
        elif demand is Demand.DRIVE and self._can_enable(driven):
            frames = self._enable(now)
        else:
            frames = [self._input_velocity(0.0, 0.0)]
            if driven or not self._idles():
                frames += self._request(IDLE, now)
        return frames + self._ask(now)

    def _set_up(self, now: float) -> list[Frame]:
        """Return zero, and every now and then all of the configuration."""
        frames = [self._input_velocity(0.0, 0.0)]
        asked = self._request(IDLE, now)
        if asked:
            frames += [*asked, *self._controller()]
            if self._clearing:
                self._clearing = False
                self._forgiven_until = now + self._patience
                frames.insert(0, self._frame(Command.CLEAR_ERRORS, bytes(8)))
        return frames

    def _can_enable(self, driven: bool) -> bool:
        return self.state is AxisState.READY and not self.trouble and (driven or self._idles())

    def _idles(self) -> bool:
        """Whether a heartbeat after the last request shows IDLE."""
        return self._axis_state == IDLE and self._heartbeat_at > self._requested_at

    def _enable(self, now: float) -> list[Frame]:
        """Return zero, and at first and every now and then a request for closed loop.

        Not more often: one that is in closed loop already leaves it and comes back.
        """
        frames = [self._input_velocity(0.0, 0.0)]
        asked = self._request(CLOSED_LOOP, now)
        return [*frames, *self._controller(), *asked] if asked else frames

    def _follow(self, setpoint: Setpoint) -> list[Frame]:
        """Return a setpoint; where the mode changes, after a zero in the new mode and the mode.

        The drive keeps the input of a mode that it is not in: without the zero the last velocity
        of before would be driven until the next one arrives.
        """
        if setpoint.mode not in CONTROL_MODES:
            self.trouble = self.trouble or f"a mode that it does not take: {setpoint.mode.value}"
            return [self._input_velocity(0.0, 0.0)]
        frames: list[Frame] = []
        if setpoint.mode is not self._mode:
            self._mode = setpoint.mode
            frames = [self._input(self._mode, 0.0, 0.0), self._controller_mode(self._mode)]
        torque = setpoint.feedforward if self.settings.feed_forward else 0.0
        return [*frames, self._input(setpoint.mode, setpoint.value, torque)]

    def _request(self, axis_state: int, now: float) -> list[Frame]:
        """Return a request for an axis state, if it is new or time to repeat it."""
        if self._requested == axis_state and now - self._requested_at < self._patience:
            return []
        self._requested, self._requested_at = axis_state, now
        return [self._frame(Command.AXIS_STATE, NUMBERS.pack(axis_state, 0))]

    def _ask(self, now: float) -> list[Frame]:
        """Return a request for current or supply, in turn, unless it has come of late."""
        if now - self._asked_at < REQUEST_PERIOD:
            return []
        late = [c for c, at in self._heard.items() if now - at >= REQUEST_PERIOD]
        if not late:
            return []
        command = late[0]
        self._heard[command] = self._heard.pop(command)
        self._asked_at = now
        return [Frame(self.settings.node << 5 | command, b"", remote=True)]

    def _controller(self) -> list[Frame]:
        settings = self.settings
        self._mode = DriveMode.VELOCITY
        limits = (settings.max_speed / math.tau, settings.max_torque / settings.torque_constant)
        return [
            self._controller_mode(self._mode),
            self._frame(Command.LIMITS, FLOATS.pack(*limits)),
        ]

    def _controller_mode(self, mode: DriveMode) -> Frame:
        data = NUMBERS.pack(CONTROL_MODES[mode], PASSTHROUGH)
        return self._frame(Command.CONTROLLER_MODE, data)

    def _input(self, mode: DriveMode, value: float, torque: float) -> Frame:
        if mode is DriveMode.TORQUE:
            return self._frame(Command.INPUT_TORQUE, FLOATS.pack(value, 0.0))
        return self._input_velocity(value / math.tau, torque)

    def _input_velocity(self, turns: float, torque: float) -> Frame:
        return self._frame(Command.INPUT_VELOCITY, FLOATS.pack(turns, torque))

    def _frame(self, command: Command, data: bytes) -> Frame:
        return Frame(self.settings.node << 5 | command, data)

    def _take_heartbeat(self, data: bytes, now: float) -> bool:
        error, axis_state, *_ = HEARTBEAT.unpack_from(data)
        self._heartbeat_at, self._axis_state = now, axis_state
        driven = self._requested == CLOSED_LOOP
        if error:
            if self.state is not AxisState.CONFIGURING or not (
                self._clearing or now < self._forgiven_until
            ):
                self._fail(AxisState.FAULT, error_text(error))
        elif self.state is AxisState.CONFIGURING:
            if self._idles() and self._requested == IDLE and self.feedback.at >= self._began_at:
                self.state = AxisState.READY
        elif self.state is AxisState.READY:
            if axis_state == CLOSED_LOOP and driven:
                self.state = AxisState.ENABLED
            elif axis_state not in (IDLE, CLOSED_LOOP):
                self._fail(AxisState.OFFLINE, f"it went to axis state {axis_state} by itself")
        elif self.state is AxisState.ENABLED and axis_state != CLOSED_LOOP:
            if driven:
                self._fail(
                    AxisState.OFFLINE,
                    f"it left closed loop control by itself, to axis state {axis_state}",
                )
            else:
                self.state = AxisState.READY
        return True

    def _take_encoder(self, data: bytes, now: float) -> bool:
        reading, speed = FLOATS.unpack_from(data)
        if not (math.isfinite(reading) and math.isfinite(speed)):
            return False
        before = reading if self._turns is None else self._turns
        turns = reading + self._offset
        elapsed = now - self.feedback.at
        if not reachable((turns - before) * math.tau, elapsed, self.settings):
            if self.state in (AxisState.READY, AxisState.ENABLED):
                step = turns - before
                self._fail(
                    AxisState.OFFLINE, f"it began anew: its position jumped by {step:.6g} turns"
                )
            turns, self._offset = before, before - reading
        self._turns = turns
        self.feedback.position = turns * math.tau
        self.feedback.velocity = speed * math.tau
        self.feedback.at = now
        self.feedback.count += 1
        return True

    def _take_iq(self, data: bytes, now: float) -> bool:
        _, current = FLOATS.unpack_from(data)
        if not math.isfinite(current):
            return False
        self._heard[Command.IQ] = now
        self.feedback.current = current
        self.feedback.torque = current * self.settings.torque_constant
        return True

    def _take_bus(self, data: bytes, now: float) -> bool:
        voltage, _ = FLOATS.unpack_from(data)
        if not math.isfinite(voltage):
            return False
        self._heard[Command.BUS] = now
        self.feedback.bus_voltage = voltage
        return True

    def _fail(self, state: AxisState, trouble: str) -> None:
        self.state = state
        self.trouble = self.trouble or trouble
