"""Simulated firmware of an ODrive axis on a CAN bus: frames of the protocol CANSimple."""

import struct
from collections.abc import Callable
from dataclasses import dataclass

import can

from omniman_ros.core.errors import ParameterError
from omniman_ros.simulation.can_drives.firmware import Firmware, Timer
from omniman_ros.simulation.can_drives.motor import DriveMotor
from omniman_ros.simulation.can_drives.odrive.axis import (
    REVOLUTION,
    AxisReadings,
    SimulatedOdriveAxis,
)
from omniman_ros.simulation.can_drives.odrive.cansimple import (
    VERSION,
    CanSimpleCommand,
    Error,
    OdriveAxisState,
)
from omniman_ros.simulation.can_drives.odrive.settings import OdriveSettings

TEMPERATURE = 25.0  #: Temperature of power stage and motor [degrees Celsius], constant


@dataclass(frozen=True)
class HostFrame:
    """Handling of a frame from the host."""

    layout: str  #: `struct` format of its signals; shorter frames are ignored
    handle: Callable[..., None]  #: Handler, called with the signals and the time [s]


class OdriveDrive(Firmware):
    """One simulated axis of an ODrive on a CAN bus.

    Frames are standard data frames with identifier node << 5 | command. Requests (Get_...) are
    remote frames or data frames without data, both answered at once. Set_... frames may be longer
    than their signals, not shorter. Heartbeat and encoder estimates are sent periodically, other
    reports if they have a period.

    Each frame to the axis feeds its watchdog (`CANSimple::do_command`), also requests and unknown
    commands; frames that only an axis sends (heartbeat, replies) do not, as they can only be its
    own echo. When the time `watchdog` has passed since the last feeding, the error
    WATCHDOG_TIMER_EXPIRED disarms the axis.

    Modelled: the behaviour of :class:`SimulatedOdriveAxis`; Iq, temperatures (constant), bus,
        errors,
    version, reboot in idle. Not modelled: arbitrary parameters, Address, extended identifiers;
    Iq_Setpoint is the measured current.

    CANSimple does not report the mode and does not acknowledge configuration: faults of these have
    no effect. The fault `fault` is one of the driver (DRV_FAULT), and `refuse_enable` gives the
    result NOT_CALIBRATED. `stuck_status` freezes the content of the heartbeat.

    Raises:
        ParameterError: The node id is not from 0 to 63.
    """

    def __init__(self, motor: DriveMotor, node: int, settings: OdriveSettings) -> None:
        if not 0 <= node < 64:
            raise ParameterError("node", node, "must be a node id of an ODrive, 0 to 63")
        super().__init__(motor, settings.boot_time)
        self._node, self._settings = node, settings
        self.axis = SimulatedOdriveAxis(motor, settings, self._readings)  #: Behaviour of the axis
        self._timers = {
            CanSimpleCommand.HEARTBEAT: Timer(settings.heartbeat),
            CanSimpleCommand.ENCODER: Timer(settings.encoder),
            CanSimpleCommand.IQ: Timer(settings.iq),
            CanSimpleCommand.BUS: Timer(settings.bus),
        }
        self._host_frames: dict[int, HostFrame] = {
            CanSimpleCommand.ESTOP: HostFrame("", self.axis.stop),
            CanSimpleCommand.AXIS_STATE: HostFrame("<I", self.axis.request_state),
            CanSimpleCommand.CONTROLLER_MODE: HostFrame("<II", self.axis.set_mode),
            CanSimpleCommand.INPUT_VELOCITY: HostFrame("<ff", self.axis.set_velocity),
            CanSimpleCommand.INPUT_TORQUE: HostFrame("<f", self.axis.set_torque),
            CanSimpleCommand.LIMITS: HostFrame("<ff", self.axis.set_limits),
            CanSimpleCommand.REBOOT: HostFrame("<B", self._on_reboot),
            CanSimpleCommand.CLEAR_ERRORS: HostFrame("", self.axis.clear_errors),
        }
        self._reports: dict[int, Callable[[], bytes]] = {
            CanSimpleCommand.VERSION: self._version,
            CanSimpleCommand.ERROR: self._error,
            CanSimpleCommand.ENCODER: self._encoder_report,
            CanSimpleCommand.IQ: self._iq,
            CanSimpleCommand.TEMPERATURE: self._temperature,
            CanSimpleCommand.BUS: self._bus,
        }
        self._initial_position = settings.position
        self._stuck_heartbeat: bytes | None = None
        self._start_at(0.0)

    def _restart(self) -> None:
        self._fed_at = self._ready_at
        self._origin = self._motor.position
        self._stuck_heartbeat = None
        for timer in self._timers.values():
            timer.restart(self._ready_at)
        self.axis.restart(self._ready_at)

    def _clear_position(self) -> None:
        self._initial_position = 0.0

    def receive(self, message: can.Message, now: float) -> list[can.Message]:
        """Process a frame at `now` [s]; return the answer if it is a request."""
        if not self._update(now) or self.faults.deaf or not self._is_addressed(message):
            return []
        command, data = message.arbitration_id & 0x1F, bytes(message.data)
        is_request = message.is_remote_frame or not data
        if not is_request and (command in self._reports or command == CanSimpleCommand.HEARTBEAT):
            return []
        self._fed_at = now
        if command in self._reports:
            return self._answer(CanSimpleCommand(command))
        if not message.is_remote_frame:
            self._on_host_frame(command, data, now)
        return []

    def _is_addressed(self, message: can.Message) -> bool:
        is_classic = not (message.is_error_frame or message.is_fd or message.is_extended_id)
        return is_classic and message.arbitration_id >> 5 == self._node

    def _on_host_frame(self, command: int, data: bytes, now: float) -> None:
        frame = self._host_frames.get(command)
        if frame is None:
            return
        size = struct.calcsize(frame.layout)
        if len(data) >= size:
            frame.handle(*struct.unpack(frame.layout, data[:size]), now)

    def _on_reboot(self, action: int, now: float) -> None:
        if action == 0 and self.axis.state is OdriveAxisState.IDLE:
            self._reboot(now)

    def advance(self, now: float) -> list[can.Message]:
        """Run watchdog, checks and ramps up to `now` [s]; return the reports that are due."""
        if not self._update(now):
            return []
        watchdog = self._settings.watchdog
        if watchdog and (self.axis.is_armed or self._settings.watchdog_when_idle):
            self.axis.fail(Error.WATCHDOG, now - self._fed_at > watchdog)
        self.axis.advance(now)
        return self._send_reports(now)

    def _update(self, now: float) -> bool:
        is_running = super()._update(now)
        if not self.faults.stuck_status:
            self._stuck_heartbeat = None
        elif self._stuck_heartbeat is None:
            self._stuck_heartbeat = self._heartbeat()
        return is_running

    @property
    def _measured(self) -> tuple[float, float]:
        """Position [rev] and velocity [rev/s] that the encoder measures."""
        position, velocity = self._encoder
        travel = (position - self._origin) / REVOLUTION
        return self._initial_position + travel, velocity / REVOLUTION

    def _readings(self) -> AxisReadings:
        return AxisReadings(
            velocity=self._measured[1],
            supply=self._supply,
            has_driver_fault=self.faults.fault,
            is_calibrated=not self.faults.refuse_enable,
        )

    def _heartbeat(self) -> bytes:
        return struct.pack("<IBBBB", self.axis.errors, self.axis.state, self.axis.result, 0, 0)

    def _version(self) -> bytes:
        return bytes(VERSION)

    def _error(self) -> bytes:
        return struct.pack("<II", self.axis.errors, self.axis.disarm_reason)

    def _encoder_report(self) -> bytes:
        return struct.pack("<ff", *self._measured)

    def _iq(self) -> bytes:
        return struct.pack("<ff", self._motor.current, self._motor.current)

    def _temperature(self) -> bytes:
        return struct.pack("<ff", TEMPERATURE, TEMPERATURE)

    def _bus(self) -> bytes:
        supply = self._supply
        power = self._motor.voltage * self._motor.current
        return struct.pack("<ff", supply, power / supply if supply else 0.0)

    def _answer(self, command: CanSimpleCommand) -> list[can.Message]:
        """Return the messages of a report, to which the report faults are applied."""
        if self.faults.silent or (
            command is CanSimpleCommand.ENCODER and self.faults.frozen_reports
        ):
            return []
        return self._report_faults.apply(
            self._frame(command, self._reports[command]()), self.faults
        )

    def _send_reports(self, now: float) -> list[can.Message]:
        due = [command for command, timer in self._timers.items() if timer.due(now)]
        messages = []
        for command in due:
            if command is not CanSimpleCommand.HEARTBEAT:
                messages += self._answer(command)
            elif not (self.faults.no_heartbeat or self.faults.silent):
                messages.append(self._frame(command, self._stuck_heartbeat or self._heartbeat()))
        return messages

    def _frame(self, command: int, data: bytes) -> can.Message:
        return can.Message(
            arbitration_id=self._node << 5 | command, is_extended_id=False, data=data
        )
