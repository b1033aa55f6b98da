"""ODrive on CAN: the CANSimple protocol of firmware 0.5 and 0.6.

Source: docs.odriverobotics.com, "CAN Protocol"; Firmware/communication/can/can_simple.cpp, github.
com/odriverobotics/ODrive. Ids have 11 bits, node << 5 | command; data are little-endian, 8 bytes.
These settings of the drive must be made beforehand, by USB: node id and bit rate,
`heartbeat_rate_ms` as `can.drive_heartbeat` (its default is 100 ms), `encoder_rate_ms` as
`can.feedback_period`, and the watchdog.

The watchdog is fed by any frame to the axis, also by requests (do_command, axis.watchdog_feed): it
shows that this host ticks, not that its setpoints are fresh. A host without fresh setpoints must
fall silent altogether or send zero. Without `enable_watchdog` and `watchdog_timeout` the drive
follows the last setpoint indefinitely when the host dies.

Nothing is acknowledged: a request is repeated if the heartbeat shows that it was not followed. The
controller's mode cannot be read back; it is sent before each enabling.
"""

import math
import struct
from enum import IntEnum

from omniman_ros.can_drives.axis import (
    AxisSettings,
    AxisState,
    Demand,
    DriveAxis,
    DriveSetpoint,
)
from omniman_ros.can_drives.frame import CanFrame
from omniman_ros.control.wheel_cascade import DriveMode


class CommandId(IntEnum):
    """Command of a frame: the lower five bits of its id."""

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


HOST_COMMANDS = (
    CommandId.AXIS_STATE,
    CommandId.CONTROLLER_MODE,
    CommandId.INPUT_POSITION,
    CommandId.INPUT_VELOCITY,
    CommandId.INPUT_TORQUE,
    CommandId.LIMITS,
    CommandId.REBOOT,
    CommandId.CLEAR_ERRORS,
    CommandId.ABSOLUTE_POSITION,
)  #: Commands that only a host sends; an emergency stop (0x02) may come from anyone

UNUSED_REPORTS = (
    CommandId.VERSION,
    CommandId.ERROR,
    CommandId.ENCODER_ERROR,
    CommandId.SDO,
    CommandId.ENCODER_COUNT,
    CommandId.TEMPERATURE,
    CommandId.TORQUES,
    CommandId.POWERS,
)  #: Reports that are received but not used here

#: Layout of a heartbeat: axis error, axis state, and flags that differ between the firmwares
HEARTBEAT_LAYOUT = struct.Struct("<IBBBB")
#: Layout of two floats.
#: Encoder: position [rev], velocity [rev/s]. Input velocity: velocity [rev/s], torque [N m].
#: Limits: velocity [rev/s], current [A]. Iq: setpoint and measurement [A]. Bus: voltage [V],
#: current [A]. Input torque: torque [N m], unused.
TWO_FLOATS = struct.Struct("<ff")
#: Layout of two integers.
#: Axis state: state, unused. Controller mode: control mode, input mode.
TWO_INTEGERS = struct.Struct("<II")

IDLE = 1  #: Axis state without power on the motor
CLOSED_LOOP = 8  #: Axis state of closed loop control
PASSTHROUGH = 1  #: Input mode without a ramp or filter
#: Control mode of the drive by the mode of the setpoint
CONTROL_MODES = {DriveMode.TORQUE: 1, DriveMode.VELOCITY: 2}

ERRORS = {
    0: "INITIALIZING",
    1: "SYSTEM_LEVEL",
    2: "TIMING_ERROR",
    3: "MISSING_ESTIMATE",
    4: "BAD_CONFIG",
    5: "DRV_FAULT",
    6: "MISSING_INPUT",
    8: "DC_BUS_OVER_VOLTAGE",
    9: "DC_BUS_UNDER_VOLTAGE",
    10: "DC_BUS_OVER_CURRENT",
    11: "DC_BUS_OVER_REGEN_CURRENT",
    12: "CURRENT_LIMIT_VIOLATION",
    13: "MOTOR_OVER_TEMP",
    14: "INVERTER_OVER_TEMP",
    15: "VELOCITY_LIMIT_VIOLATION",
    16: "POSITION_LIMIT_VIOLATION",
    24: "WATCHDOG_TIMER_EXPIRED",
    25: "ESTOP_REQUESTED",
    26: "SPINOUT_DETECTED",
    27: "BRAKE_RESISTOR_DISARMED",
    28: "THERMISTOR_DISCONNECTED",
    30: "CALIBRATION_ERROR",
}  #: Names of the bits of the axis error by bit number, firmware 0.6 (ODrive.Error)

ERRORS_05 = {
    0: "INVALID_STATE",
    6: "MOTOR_FAILED",
    7: "SENSORLESS_ESTIMATOR_FAILED",
    8: "ENCODER_FAILED",
    9: "CONTROLLER_FAILED",
    11: "WATCHDOG_TIMER_EXPIRED",
    12: "MIN_ENDSTOP_PRESSED",
    13: "MAX_ENDSTOP_PRESSED",
    14: "ESTOP_REQUESTED",
    17: "HOMING_WITHOUT_ENDSTOP",
    18: "OVER_TEMP",
    19: "UNKNOWN_POSITION",
}  #: Names of the bits of the axis error by bit number, firmware 0.5 (ODrive.Axis.Error)

#: Number of missing heartbeats after which the drive counts as lost, or a request is repeated
MISSED_HEARTBEATS = 3
#: Time between two requests for values that the drive does not report by itself [s]
REQUEST_PERIOD = 0.1


def error_text(error: int) -> str:
    """Return the names of an axis error in both firmwares; heartbeats do not tell which runs."""
    names = []
    for table, firmware in ((ERRORS, "0.6"), (ERRORS_05, "0.5")):
        bits = [bit for bit in range(32) if error >> bit & 1]
        if all(bit in table for bit in bits):
            names.append(f"{', '.join(table[bit] for bit in bits)} (firmware {firmware})")
    return f"axis error 0x{error:08X}: {' or '.join(names) or 'unknown'}"


class OdriveAxis(DriveAxis):
    """One axis of an ODrive.

    The drive accepts velocities and torques, both passed through to its controller without ramps,
    but no voltages. The feed-forward torque of a velocity is sent if `feed_forward` is set.

    To configure, the axis sends zero, requests IDLE, sets the mode and the limits, and waits for
    an encoder report and a heartbeat with IDLE and without error. With Demand.DRIVE it sends zero,
    sets mode and limits again, and requests closed loop; it is ENABLED when the heartbeat shows
    that. With Demand.STOP it follows the setpoint. With Demand.IDLE, or unless it is ENABLED, it
    sends zero each period, which feeds the watchdog, and requests IDLE until the heartbeat shows
    it.

    There is no boot-up frame. A drive that left closed loop by itself, or whose position made a
    step that no shaft can do, counts as restarted: OFFLINE. The position continues without the
    step.

    The torque is the measured Iq times the torque constant: with firmware 0.5 and a motor whose
    `direction` was calibrated as -1 its sign differs from that of the encoder.

    Positions are float32 revolutions of the motor: from 4096 rev on they have steps of 1/2048 rev
    (3 mrad), from 131,072 rev on of 1/64 rev (0.1 rad). A drive that is to run further must be
    restarted.

    Raises:
        ParameterError: A setting that the codec divides by is not finite and above zero.
    """

    modes = tuple(CONTROL_MODES)

    def __init__(self, settings: AxisSettings) -> None:
        settings.require_positive(
            "torque_constant", "period", "drive_heartbeat", "feedback_timeout"
        )
        handlers = {
            CommandId.HEARTBEAT: self._on_heartbeat,
            CommandId.ENCODER: self._on_encoder,
            CommandId.IQ: self._on_iq,
            CommandId.BUS: self._on_bus,
        } | dict.fromkeys(UNUSED_REPORTS, _is_complete)
        super().__init__(
            settings,
            [settings.node << 5 | command for command in HOST_COMMANDS],
            {settings.node << 5 | command: handler for command, handler in handlers.items()},
        )
        self._heartbeat_timeout = MISSED_HEARTBEATS * settings.drive_heartbeat + settings.period
        self._mode: DriveMode | None = None
        self._axis_state: int | None = None
        self._heartbeat_at = -math.inf
        self._began_at = -math.inf
        self._errors_ignored_until = -math.inf
        self._clear_errors = False
        self._requested: int | None = None
        self._requested_at = -math.inf
        self._position_revolutions: float | None = None
        self._offset = 0.0
        self._received_at = {CommandId.IQ: -math.inf, CommandId.BUS: -math.inf}
        self._value_requested_at = -math.inf

    def configure(self, now: float) -> None:
        """See `DriveAxis`."""
        super().configure(now)
        self._began_at = now
        self._clear_errors = False
        self._errors_ignored_until = -math.inf
        self._requested = self._mode = None

    def reset(self, now: float) -> None:
        """See `DriveAxis`: with a fault or OFFLINE, clear errors and configure the drive again."""
        if self.fault_reason or self.state in (AxisState.OFFLINE, AxisState.FAULT):
            self.configure(now)
            self._clear_errors = True

    def frames(self, demand: Demand, setpoint: DriveSetpoint, now: float) -> list[CanFrame]:
        """See `DriveAxis`: one frame, or more if something begins, is repeated or requested."""
        is_watched = self.state in (AxisState.READY, AxisState.ENABLED)
        if is_watched and now - self._heartbeat_at > self._heartbeat_timeout:
            self.fault_reason = self.fault_reason or "its heartbeat is missing"
        is_requested = self._requested == CLOSED_LOOP
        if self.state is AxisState.CONFIGURING:
            frames = self._configuration_frames(now)
        elif self.state is AxisState.ENABLED and is_requested and demand is not Demand.IDLE:
            frames = self._setpoint_frames(setpoint)
        elif demand is Demand.DRIVE and self._can_enable(is_requested):
            frames = self._enabling_frames(now)
        else:
            frames = [self._input_velocity(0.0, 0.0)]
            if is_requested or not self._is_idle():
                frames += self._request_state(IDLE, now)
        return frames + self._request_values(now)

    def _configuration_frames(self, now: float) -> list[CanFrame]:
        """Return zero velocity, and with each request for IDLE the whole configuration."""
        frames = [self._input_velocity(0.0, 0.0)]
        request = self._request_state(IDLE, now)
        if request:
            frames += [*request, *self._controller_frames()]
            if self._clear_errors:
                self._clear_errors = False
                self._errors_ignored_until = now + self._heartbeat_timeout
                frames.insert(0, self._frame(CommandId.CLEAR_ERRORS, bytes(8)))
        return frames

    def _can_enable(self, is_requested: bool) -> bool:
        return (
            self.state is AxisState.READY
            and not self.fault_reason
            and (is_requested or self._is_idle())
        )

    def _is_idle(self) -> bool:
        """Return whether a heartbeat after the last request shows IDLE."""
        return self._axis_state == IDLE and self._heartbeat_at > self._requested_at

    def _enabling_frames(self, now: float) -> list[CanFrame]:
        """Return zero velocity, and a request for closed loop if it is new or due again.

        It is not repeated more often: a drive in closed loop would leave it and enter it again.
        """
        frames = [self._input_velocity(0.0, 0.0)]
        request = self._request_state(CLOSED_LOOP, now)
        return [*frames, *self._controller_frames(), *request] if request else frames

    def _setpoint_frames(self, setpoint: DriveSetpoint) -> list[CanFrame]:
        """Return a setpoint; if the mode changes, after a zero in the new mode and the mode.

        The drive keeps the input of a mode that it is not in: without the zero it would follow the
        last velocity of an earlier time until the next one arrives.
        """
        if setpoint.mode not in CONTROL_MODES:
            self.fault_reason = (
                self.fault_reason or f"it does not support {setpoint.mode.value} mode"
            )
            return [self._input_velocity(0.0, 0.0)]
        frames: list[CanFrame] = []
        if setpoint.mode is not self._mode:
            self._mode = setpoint.mode
            frames = [self._input(self._mode, 0.0, 0.0), self._controller_mode(self._mode)]
        torque = setpoint.feedforward if self.settings.feed_forward else 0.0
        return [*frames, self._input(setpoint.mode, setpoint.value, torque)]

    def _request_state(self, axis_state: int, now: float) -> list[CanFrame]:
        """Return a request for an axis state if it is new or due again."""
        if self._requested == axis_state and now - self._requested_at < self._heartbeat_timeout:
            return []
        self._requested, self._requested_at = axis_state, now
        return [self._frame(CommandId.AXIS_STATE, TWO_INTEGERS.pack(axis_state, 0))]

    def _request_values(self, now: float) -> list[CanFrame]:
        """Return a request for current or supply, alternately, unless it was received lately."""
        if now - self._value_requested_at < REQUEST_PERIOD:
            return []
        missing = [c for c, at in self._received_at.items() if now - at >= REQUEST_PERIOD]
        if not missing:
            return []
        command = missing[0]
        self._received_at[command] = self._received_at.pop(command)
        self._value_requested_at = now
        return [CanFrame(self.settings.node << 5 | command, b"", remote=True)]

    def _controller_frames(self) -> list[CanFrame]:
        settings = self.settings
        self._mode = DriveMode.VELOCITY
        limits = (settings.max_speed / math.tau, settings.max_torque / settings.torque_constant)
        return [
            self._controller_mode(self._mode),
            self._frame(CommandId.LIMITS, TWO_FLOATS.pack(*limits)),
        ]

    def _controller_mode(self, mode: DriveMode) -> CanFrame:
        data = TWO_INTEGERS.pack(CONTROL_MODES[mode], PASSTHROUGH)
        return self._frame(CommandId.CONTROLLER_MODE, data)

    def _input(self, mode: DriveMode, value: float, torque: float) -> CanFrame:
        if mode is DriveMode.TORQUE:
            return self._frame(CommandId.INPUT_TORQUE, TWO_FLOATS.pack(value, 0.0))
        return self._input_velocity(value / math.tau, torque)

    def _input_velocity(self, rev_per_s: float, torque: float) -> CanFrame:
        return self._frame(CommandId.INPUT_VELOCITY, TWO_FLOATS.pack(rev_per_s, torque))

    def _frame(self, command: CommandId, data: bytes) -> CanFrame:
        return CanFrame(self.settings.node << 5 | command, data)

    def _on_heartbeat(self, data: bytes, now: float) -> bool:
        error, axis_state, *_ = HEARTBEAT_LAYOUT.unpack_from(data)
        self._heartbeat_at, self._axis_state = now, axis_state
        is_requested = self._requested == CLOSED_LOOP
        if error:
            if self.state is not AxisState.CONFIGURING or not (
                self._clear_errors or now < self._errors_ignored_until
            ):
                self.fail(AxisState.FAULT, error_text(error))
        elif self.state is AxisState.CONFIGURING:
            if self._is_idle() and self._requested == IDLE and self.feedback.at >= self._began_at:
                self.state = AxisState.READY
        elif self.state is AxisState.READY:
            if axis_state == CLOSED_LOOP and is_requested:
                self.state = AxisState.ENABLED
            elif axis_state not in (IDLE, CLOSED_LOOP):
                self.fail(AxisState.OFFLINE, f"it went to axis state {axis_state} by itself")
        elif self.state is AxisState.ENABLED and axis_state != CLOSED_LOOP:
            if is_requested:
                self.fail(
                    AxisState.OFFLINE,
                    f"it left closed loop control by itself, to axis state {axis_state}",
                )
            else:
                self.state = AxisState.READY
        return True

    def _on_encoder(self, data: bytes, now: float) -> bool:
        reading, speed = TWO_FLOATS.unpack_from(data)
        if not (math.isfinite(reading) and math.isfinite(speed)):
            return False
        previous = reading if self._position_revolutions is None else self._position_revolutions
        revolutions = reading + self._offset
        elapsed = now - self.feedback.at
        if not self.settings.is_reachable((revolutions - previous) * math.tau, elapsed):
            if self.state in (AxisState.READY, AxisState.ENABLED):
                step = revolutions - previous
                self.fail(
                    AxisState.OFFLINE,
                    f"it restarted: its position jumped by {step:.6g} rev",
                )
            revolutions, self._offset = previous, previous - reading
            self.feedback.restarts += 1
        self._position_revolutions = revolutions
        self.feedback.measure(revolutions * math.tau, speed * math.tau, now)
        return True

    def _on_iq(self, data: bytes, now: float) -> bool:
        _, current = TWO_FLOATS.unpack_from(data)
        if not math.isfinite(current):
            return False
        self._received_at[CommandId.IQ] = now
        self.feedback.current = current
        self.feedback.torque = current * self.settings.torque_constant
        return True

    def _on_bus(self, data: bytes, now: float) -> bool:
        voltage, _ = TWO_FLOATS.unpack_from(data)
        if not math.isfinite(voltage):
            return False
        self._received_at[CommandId.BUS] = now
        self.feedback.bus_voltage = voltage
        return True


def _is_complete(data: bytes, now: float) -> bool:
    return len(data) == 8
