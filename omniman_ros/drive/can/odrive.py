"""Firmware of an ODrive axis that speaks CANSimple, simulated, over a motor.

Written from public documents: "CAN Protocol" of the ODrive manual and its DBC file
`odrive-cansimple-0.6.10` (identifiers, layouts, error bits, states, results; firmware 0.6); the
examples of `odriverobotics/ODriveResources` (`can_simple.py`, `can_watchdog.py`); and the source
of firmware 0.5.6, the last that is public (`can_simple.cpp`, `axis.cpp`, `controller.cpp`), for
what the documents leave open.
"""

import enum
import math
import struct
from collections.abc import Callable
from dataclasses import dataclass

import can

from omniman_ros.core.errors import ParameterError
from omniman_ros.drive.can.motor import DriveFaults, Motor
from omniman_ros.drive.can.reports import ReportFaults, Timer, check_above

TURN = 2.0 * math.pi


class Command(enum.IntEnum):
    """Lower five bits of an identifier."""

    VERSION = 0x00
    HEARTBEAT = 0x01
    ESTOP = 0x02
    ERROR = 0x03
    AXIS_STATE = 0x07
    ENCODER = 0x09
    CONTROLLER_MODE = 0x0B
    INPUT_VELOCITY = 0x0D
    INPUT_TORQUE = 0x0E
    LIMITS = 0x0F
    IQ = 0x14
    TEMPERATURE = 0x15
    REBOOT = 0x16
    BUS = 0x17
    CLEAR_ERRORS = 0x18


class Error(enum.IntFlag):
    """Bits of Active_Errors and Disarm_Reason (DBC 0.6.10)."""

    NONE = 0
    BAD_CONFIG = 0x10
    DRV_FAULT = 0x20
    MISSING_INPUT = 0x40
    UNDER_VOLTAGE = 0x200
    VELOCITY_LIMIT = 0x8000
    WATCHDOG = 0x1000000
    ESTOP = 0x2000000
    SPINOUT = 0x4000000


class State(enum.IntEnum):
    """Axis states that are modelled."""

    IDLE = 1
    CLOSED_LOOP = 8


class Result(enum.IntEnum):
    """Procedure results that occur."""

    SUCCESS = 0
    DISARMED = 3
    INVALID_STATE = 13
    NOT_CALIBRATED = 14


class Control(enum.IntEnum):
    """Control modes that are modelled."""

    TORQUE = 1
    VELOCITY = 2


class Input(enum.IntEnum):
    """Input modes that are modelled."""

    PASSTHROUGH = 1
    VELOCITY_RAMP = 2
    TORQUE_RAMP = 6


MODES = {
    (Control.TORQUE, Input.PASSTHROUGH),
    (Control.TORQUE, Input.TORQUE_RAMP),
    (Control.VELOCITY, Input.PASSTHROUGH),
    (Control.VELOCITY, Input.VELOCITY_RAMP),
}
"""Modes that are modelled; in others the axis disarms itself."""

VERSION = (2, 4, 4, 58, 0, 6, 10, 0)
"""Protocol; hardware: product line, version, variant; firmware: major, minor, revision,
unreleased (Get_Version)."""
OVERSPEED = 1.2
"""Speed over the limit at which the axis disarms itself (vel_limit_tolerance)."""
TEMPERATURE = 25.0
"""Of power stage and motor, degrees Celsius; heating is not modelled."""


@dataclass(frozen=True)
class Order:
    """A frame from the host.

    Attributes:
        layout: Format of `struct` of what is read; a frame that is shorter is ignored.
        act: What is done with it.
    """

    layout: str
    act: Callable[["OdriveDrive", tuple[float, ...], float], None]


class OdriveDrive:
    """One axis of an ODrive on a bus.

    Standard data frames with identifier node << 5 | command. Requests (Get_...) are remote frames
    or data frames without data, both answered at once. Set_... frames may be longer than their
    signals, not shorter. Heartbeat and encoder estimates are sent periodically, others where a
    period is given.

    The axis is idle or in closed loop control. Each frame to the axis feeds its watchdog
    (`CANSimple::do_command`), requests and unknown commands too; what only an axis sends
    (heartbeat, replies) does not, as that can only be its own echo. `watchdog` after the last one
    the error WATCHDOG_TIMER_EXPIRED disarms the axis. **A disarmed ODrive takes the power off:
    the axis goes idle and the motor coasts; it neither ramps down nor holds.** The public
    documents have no other reaction to errors, watchdog and Estop. They do have an output for a
    mechanical brake, which is engaged while the axis is idle (firmware 0.5,
    `Axis::run_idle_loop`): `brake_deceleration` stands for one.

    Errors stay until Clear_Errors, and come back at once where their cause goes on: watchdog,
    Estop, supply below `min_supply`, speed over 1.2 times the velocity limit, an encoder that
    misleads (SPINOUT_DETECTED), `faults.fault` (DRV_FAULT), an input that is not finite
    (MISSING_INPUT), a mode that is not modelled (BAD_CONFIG; firmware 0.5:
    ERROR_INVALID_INPUT_MODE). With an error the axis cannot be armed, which gives the result
    DISARMED. Inputs outlive disarming: a stale one moves the motor when it is armed, as in
    firmware 0.5. They are 0 after a restart.

    Modelled: velocity control with feed-forward torque, torque control, both passed through or
    ramped; velocity clipped at the limit, torque at current limit times torque constant (in
    velocity control only the feed-forward: the loop is the motor's); Iq, temperatures (constant),
    bus, errors, version, reboot in idle. Not modelled: calibration and other states (refused:
    INVALID_STATE), position control, arbitrary parameters, Address, extended identifiers, gains,
    trajectories, INITIALIZING after a restart; Iq_Setpoint is the measured current.

    What DriveFaults has and CANSimple lacks: a mode that is shown, answered configuration.
    `refuse_enable` gives NOT_CALIBRATED. `stuck_status` keeps the heartbeat's content.

    Args:
        motor: Its motor.
        node: 0 to 63.
        torque_constant: N m/A.
        heartbeat, encoder, iq, bus: Periods of these reports, s; 0 for never.
        watchdog: s; 0 for none.
        watchdog_when_idle: Whether it runs in idle too, as in firmware 0.5. The vendor's examples
            for 0.6 arm the axis after any time of silence, without clearing errors.
        velocity_limit: rev/s, until the host sets it.
        current_limit: A, until the host sets it.
        velocity_ramp, torque_ramp: rev/s^2 and N m/s, in the ramped input modes.
        min_supply: V.
        brake_deceleration: Of a mechanical brake at the axis's brake output, rad/s^2; 0 for none.
        boot_time: Time without a frame, in or out, after a restart, s.
        position: Position at power-up, rev; a restart makes it 0.

    Attributes:
        faults: Faults to play.

    Raises:
        ParameterError: A number is not possible.
    """

    def __init__(
        self,
        motor: Motor,
        node: int,
        torque_constant: float,
        *,
        heartbeat: float = 0.1,
        encoder: float = 0.01,
        iq: float = 0.0,
        bus: float = 0.0,
        watchdog: float = 0.1,
        watchdog_when_idle: bool = False,
        velocity_limit: float = 1000.0,
        current_limit: float = 1000.0,
        velocity_ramp: float = 1.0,
        torque_ramp: float = 0.01,
        min_supply: float = 10.0,
        brake_deceleration: float = 0.0,
        boot_time: float = 1.0,
        position: float = 0.0,
    ) -> None:
        if not 0 <= node < 64:
            raise ParameterError("node", node, "nodes of ODrive are 0 to 63")
        check_above("torque_constant", torque_constant, inclusive=False)
        if not math.isfinite(position):
            raise ParameterError("position", position, "it must be finite")
        for name, value in (
            ("heartbeat", heartbeat),
            ("encoder", encoder),
            ("iq", iq),
            ("bus", bus),
            ("watchdog", watchdog),
            ("velocity_limit", velocity_limit),
            ("current_limit", current_limit),
            ("velocity_ramp", velocity_ramp),
            ("torque_ramp", torque_ramp),
            ("min_supply", min_supply),
            ("brake_deceleration", brake_deceleration),
            ("boot_time", boot_time),
        ):
            check_above(name, value)
        self.faults = DriveFaults()
        self._motor, self._node, self._torque_constant = motor, node, torque_constant
        self._watchdog, self._watchdog_when_idle = watchdog, watchdog_when_idle
        self._limits = velocity_limit, current_limit
        self._ramps = velocity_ramp, torque_ramp
        self._min_supply, self._brake = min_supply, brake_deceleration
        self._boot_time = boot_time
        self._timers = {
            Command.HEARTBEAT: Timer(heartbeat),
            Command.ENCODER: Timer(encoder),
            Command.IQ: Timer(iq),
            Command.BUS: Timer(bus),
        }
        self._reports = ReportFaults()
        self._start = position
        self._reboots = 0
        self._frozen: tuple[float, float] | None = None
        self._stuck: bytes | None = None
        self._started = False
        self._ready = 0.0
        self._restart(0.0)

    def _restart(self, ready: float) -> None:
        """Be as after power-up, from a time on."""
        self._ready = self._fed = self._driven = ready
        self._errors = self._disarm_reason = Error.NONE
        self._result = Result.SUCCESS
        self._control, self._input = int(Control.VELOCITY), int(Input.PASSTHROUGH)
        self._velocity = self._torque = 0.0
        self._ramped = 0.0
        self._velocity_limit, self._current_limit = self._limits
        self._origin = self._motor.position
        self._stuck = None
        for timer in self._timers.values():
            timer.restart(ready)
        self._idle()

    def receive(self, message: can.Message, now: float) -> list[can.Message]:
        """Hear a frame; answer it where it is a request."""
        if not self._awake(now) or self.faults.deaf:
            return []
        if message.is_error_frame or message.is_fd or message.is_extended_id:
            return []
        if message.arbitration_id >> 5 != self._node:
            return []
        command, data = message.arbitration_id & 0x1F, bytes(message.data)
        request = message.is_remote_frame or not data
        if not request and (command in ANSWERS or command == Command.HEARTBEAT):
            return []
        self._fed = now
        if command in ANSWERS:
            return self._answer(Command(command))
        order = ORDERS.get(command)
        if order is None or message.is_remote_frame:
            return []
        size = struct.calcsize(order.layout)
        if len(data) >= size:
            order.act(self, struct.unpack(order.layout, data[:size]), now)
        return []

    def advance(self, now: float) -> list[can.Message]:
        """Run watchdog, checks and ramps up to a time; return the reports due."""
        if not self._awake(now):
            return []
        armed = self._state is State.CLOSED_LOOP
        if self._watchdog and (armed or self._watchdog_when_idle):
            self._fail(Error.WATCHDOG, now - self._fed > self._watchdog)
        self._check()
        self._drive(now)
        return self._report(now)

    def _awake(self, now: float) -> bool:
        """Restart where that was asked for; say whether the firmware runs."""
        if not self._started:
            self._started = True
            self._restart(now)
        if self.faults.reboots > self._reboots:
            self._start = 0.0
            self._restart(now + self._boot_time)
        self._reboots = self.faults.reboots
        if not self.faults.frozen_encoder:
            self._frozen = None
        elif self._frozen is None:
            self._frozen = self._motor.position, self._motor.velocity
        if not self.faults.stuck_status:
            self._stuck = None
        elif self._stuck is None:
            self._stuck = self._heartbeat()
        return now >= self._ready

    @property
    def _supply(self) -> float:
        return self.faults.supply or self._motor.supply

    @property
    def _measured(self) -> tuple[float, float]:
        """Position and velocity from the encoder, rev and rev/s."""
        position, velocity = self._frozen or (self._motor.position, self._motor.velocity)
        return self._start + (position - self._origin) / TURN, velocity / TURN

    # --- errors and states ---

    def _idle(self) -> None:
        """Take the power off."""
        self._state = State.IDLE
        if self._brake:
            self._motor.halt(self._brake)
        else:
            self._motor.release()

    def _fail(self, error: Error, failed: bool = True) -> None:
        if not failed:
            return
        self._errors |= error
        if self._state is State.CLOSED_LOOP:
            self._disarm_reason |= error
            self._result = Result.DISARMED
            self._idle()

    def _check(self) -> None:
        """Look for errors whose cause lasts."""
        self._fail(Error.DRV_FAULT, self.faults.fault)
        self._fail(Error.UNDER_VOLTAGE, self._supply < self._min_supply)
        self._fail(Error.SPINOUT, self._motor.lost)
        causes = (
            (Error.VELOCITY_LIMIT, abs(self._measured[1]) > OVERSPEED * self._velocity_limit),
            (Error.BAD_CONFIG, (self._control, self._input) not in MODES),
            (Error.MISSING_INPUT, not math.isfinite(self._torque + self._velocity)),
        )
        for error, failed in causes:
            if self._state is State.CLOSED_LOOP:
                self._fail(error, failed)

    def _estop(self, _: tuple[float, ...], now: float) -> None:
        self._fail(Error.ESTOP)

    def _clear_errors(self, _: tuple[float, ...], now: float) -> None:
        self._errors = self._disarm_reason = Error.NONE
        self._check()

    def _set_axis_state(self, values: tuple[float, ...], now: float) -> None:
        (state,) = values
        if state == State.IDLE:
            self._result = Result.SUCCESS
            self._idle()
        elif state != State.CLOSED_LOOP:
            self._result = Result.INVALID_STATE
        elif self._state is not State.CLOSED_LOOP:
            self._arm(now)

    def _arm(self, now: float) -> None:
        self._check()
        if self.faults.refuse_enable:
            self._result = Result.NOT_CALIBRATED
        elif self._errors:
            self._result = Result.DISARMED
        else:
            self._state, self._result = State.CLOSED_LOOP, Result.SUCCESS
            self._enter_mode(now)
            self._check()
            self._drive(now)

    def _reboot(self, values: tuple[float, ...], now: float) -> None:
        if values[0] == 0 and self._state is State.IDLE:
            self._start = 0.0
            self._restart(now + self._boot_time)

    # --- control ---

    def _set_controller_mode(self, values: tuple[float, ...], now: float) -> None:
        modes = int(values[0]), int(values[1])
        if modes != (self._control, self._input):
            self._control, self._input = modes
            self._enter_mode(now)
        self._check()
        self._drive(now)

    def _enter_mode(self, now: float) -> None:
        """Start ramps where the motor is."""
        velocity = self._control == Control.VELOCITY
        self._ramped = self._measured[1] if velocity else self._motor.torque
        self._driven = now

    def _set_input_velocity(self, values: tuple[float, ...], now: float) -> None:
        self._velocity, self._torque = values
        self._check()
        self._drive(now)

    def _set_input_torque(self, values: tuple[float, ...], now: float) -> None:
        (self._torque,) = values
        self._check()
        self._drive(now)

    def _set_limits(self, values: tuple[float, ...], now: float) -> None:
        velocity, current = values
        if 0.0 <= velocity < math.inf and 0.0 <= current < math.inf:
            self._velocity_limit, self._current_limit = velocity, current

    def _drive(self, now: float) -> None:
        """Give the motor its setpoint, where the axis is armed."""
        dt, self._driven = max(now - self._driven, 0.0), now
        if self._state is not State.CLOSED_LOOP:
            return
        limit = self._current_limit * self._torque_constant
        torque = min(max(self._torque, -limit), limit)
        if self._control == Control.TORQUE:
            if self._input == Input.TORQUE_RAMP:
                torque = self._ramp(torque, self._ramps[1] * dt)
            self._motor.follow_torque(torque)
            return
        velocity = min(max(self._velocity, -self._velocity_limit), self._velocity_limit)
        if self._input == Input.VELOCITY_RAMP:
            velocity = self._ramp(velocity, self._ramps[0] * dt)
        self._motor.follow_velocity(velocity * TURN, torque)

    def _ramp(self, target: float, change: float) -> float:
        self._ramped += min(max(target - self._ramped, -change), change)
        return self._ramped

    # --- reports ---

    def _heartbeat(self) -> bytes:
        return struct.pack("<IBBBB", self._errors, self._state, self._result, 0, 0)

    def _version(self) -> bytes:
        return bytes(VERSION)

    def _error(self) -> bytes:
        return struct.pack("<II", self._errors, self._disarm_reason)

    def _encoder(self) -> bytes:
        return struct.pack("<ff", *self._measured)

    def _iq(self) -> bytes:
        return struct.pack("<ff", self._motor.current, self._motor.current)

    def _temperature(self) -> bytes:
        return struct.pack("<ff", TEMPERATURE, TEMPERATURE)

    def _bus(self) -> bytes:
        supply = self._supply
        power = self._motor.voltage * self._motor.current
        return struct.pack("<ff", supply, power / supply if supply else 0.0)

    def _answer(self, command: Command) -> list[can.Message]:
        """Return a report, with its faults."""
        if self.faults.silent or (command is Command.ENCODER and self.faults.frozen_reports):
            return []
        return self._reports.apply(self._frame(command, ANSWERS[command](self)), self.faults)

    def _report(self, now: float) -> list[can.Message]:
        due = [command for command, timer in self._timers.items() if timer.due(now)]
        messages = []
        for command in due:
            if command is not Command.HEARTBEAT:
                messages += self._answer(command)
            elif not (self.faults.no_heartbeat or self.faults.silent):
                messages.append(self._frame(command, self._stuck or self._heartbeat()))
        return messages

    def _frame(self, command: int, data: bytes) -> can.Message:
        return can.Message(
            arbitration_id=self._node << 5 | command, is_extended_id=False, data=data
        )


ORDERS: dict[int, Order] = {
    Command.ESTOP: Order("", OdriveDrive._estop),
    Command.AXIS_STATE: Order("<I", OdriveDrive._set_axis_state),
    Command.CONTROLLER_MODE: Order("<II", OdriveDrive._set_controller_mode),
    Command.INPUT_VELOCITY: Order("<ff", OdriveDrive._set_input_velocity),
    Command.INPUT_TORQUE: Order("<f", OdriveDrive._set_input_torque),
    Command.LIMITS: Order("<ff", OdriveDrive._set_limits),
    Command.REBOOT: Order("<B", OdriveDrive._reboot),
    Command.CLEAR_ERRORS: Order("", OdriveDrive._clear_errors),
}
"""What the host may send, and the signals that are read of it."""

ANSWERS: dict[int, Callable[[OdriveDrive], bytes]] = {
    Command.VERSION: OdriveDrive._version,
    Command.ERROR: OdriveDrive._error,
    Command.ENCODER: OdriveDrive._encoder,
    Command.IQ: OdriveDrive._iq,
    Command.TEMPERATURE: OdriveDrive._temperature,
    Command.BUS: OdriveDrive._bus,
}
"""What can be asked for."""
