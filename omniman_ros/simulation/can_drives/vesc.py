"""Simulated firmware of a VESC on a CAN bus, over a motor.

Written from the public firmware `vedderb/bldc`: `documentation/comm_can.md` (identifiers, simple
commands, status frames), `comm/comm_can.c` (`decode_msg`, `comm_can_send_status*`), `timeout.c`
and `motor/mcpwm_foc.c`.
"""

import enum
import math
import struct
from dataclasses import dataclass, fields

import can

from omniman_ros.core.errors import ParameterError
from omniman_ros.simulation.can_drives.firmware import Firmware, Timer, require_above
from omniman_ros.simulation.can_drives.motor import DriveMotor

REVOLUTION = 2.0 * math.pi  #: Angle of one revolution [rad]


class Mode(enum.Enum):
    """Control mode of the motor."""

    RELEASED = "released"
    DUTY = "duty"
    CURRENT = "current"
    BRAKE = "brake"
    SPEED = "speed"


@dataclass(frozen=True)
class SimpleCommand:
    """Layout of a simple command: a big-endian 32-bit integer, the value times a scale."""

    mode: Mode  #: Mode that the command selects
    scale: float  #: Units of the frame per duty cycle of 1, A, eRPM or largest current
    is_relative: bool = False  #: Whether the value is a fraction of the largest current


#: Simple commands by their number (comm_can.md, Single-Frame Commands).
#:
#: The scale of SET_RPM is 1, as in the code and the C example, not 1000 as in the table. Commands
#: 12 and 13 are the handbrake.
SIMPLE_COMMANDS = {
    0: SimpleCommand(Mode.DUTY, 1e5),
    1: SimpleCommand(Mode.CURRENT, 1e3),
    2: SimpleCommand(Mode.BRAKE, 1e3),
    3: SimpleCommand(Mode.SPEED, 1.0),
    10: SimpleCommand(Mode.CURRENT, 1e5, is_relative=True),
    11: SimpleCommand(Mode.BRAKE, 1e5, is_relative=True),
    12: SimpleCommand(Mode.BRAKE, 1e3),
    13: SimpleCommand(Mode.BRAKE, 1e5, is_relative=True),
}


@dataclass(frozen=True)
class StatusLayout:
    """Layout of a status frame: big-endian integers, each a value times a scale."""

    command: int  #: Command number in the identifier
    layout: str  #: Format of `struct`
    values: tuple[tuple[str, float], ...]  #: Name and scale of each value
    has_motion: bool  #: Whether the frame reports position or velocity


STATUS_1 = StatusLayout(9, ">ihh", (("erpm", 1.0), ("current", 10.0), ("duty", 1000.0)), True)
STATUS_4 = StatusLayout(
    16, ">hhhh", (("fet", 10.0), ("motor", 10.0), ("input", 10.0), ("angle", 50.0)), False
)
STATUS_5 = StatusLayout(
    27, ">ihh", (("tachometer", 1.0), ("supply", 10.0), ("reserved", 1.0)), True
)

PING = 17  #: Command number of a ping
PONG = 18  #: Command number of the answer to a ping
HARDWARE_VESC = 0  #: Hardware type in the answer to a ping
BROADCAST_NODE = 255  #: Node id that addresses all drives
TACHOMETER_STEPS = 6  #: Steps of the tachometer per electrical revolution
TEMPERATURE = 25.0  #: Temperature of power stage and motor [degrees Celsius], constant
INTEGER_LIMITS = {"h": 2**15 - 1, "i": 2**31 - 1}  #: Largest integer by format of `struct`


def _pack(status: StatusLayout, values: dict[str, float]) -> bytes:
    """Pack a status frame; too large values are clipped, fractions are truncated as in C."""
    numbers = []
    for kind, (name, scale) in zip(status.layout[1:], status.values, strict=True):
        limit = INTEGER_LIMITS[kind]
        numbers.append(int(min(max(values[name] * scale, -limit - 1), limit)))
    return struct.pack(status.layout, *numbers)


@dataclass(frozen=True, kw_only=True)
class VescSettings:
    """Commissioning of a VESC; a number out of range raises a ParameterError."""

    pole_pairs: int  #: Electrical revolutions per revolution of the motor
    torque_constant: float  #: Torque constant of the motor [N m/A]
    timeout: float = 0.5  #: Time after a command at which the motor is braked [s]; 0 disables it
    #: Brake current after the timeout [A]. The firmware has 0, which lets the motor coast: an
    #: installation must set it.
    timeout_brake_current: float = 5.0
    status_1_rate: float = 200.0  #: Rate of status 1 [Hz], set in VESC Tool; 0 disables it
    status_4_rate: float = 20.0  #: Rate of status 4 [Hz]; 0 disables it
    status_5_rate: float = 200.0  #: Rate of status 5 [Hz]; 0 disables it
    max_duty: float = 0.95  #: Largest duty cycle, 0 to 1
    max_current: float = 60.0  #: Largest current [A]
    min_current: float = 0.05  #: Current below which the motor is released [A]
    min_erpm: float = 0.0  #: Smallest controlled speed [eRPM]; a wheel that stands needs 0
    min_supply: float = 8.0  #: Supply voltage below which there is an error [V]
    fault_stop_time: float = 0.5  #: Time after an error in which commands are ignored [s]
    boot_time: float = 1.0  #: Time after a restart in which no frame is received or sent [s]
    tachometer: int = 0  #: Initial count of the tachometer; a restart sets it to 0

    def __post_init__(self) -> None:
        require_above("pole_pairs", self.pole_pairs, 1)
        for name in ("torque_constant", "max_current", "max_duty"):
            require_above(name, getattr(self, name), inclusive=False)
        for field in fields(self):
            if field.name != "tachometer":
                require_above(field.name, getattr(self, field.name))


class VescDrive(Firmware):
    """A VESC in the CAN mode "VESC".

    Commands are 29-bit data frames with identifier command << 8 | node, or node 255 for all;
    all other frames are ignored. Each command applies until the next one. At `timeout` after the
    last one (the firmware checks every 10 ms, this class at each `advance`) the motor is braked
    with `timeout_brake_current` until the next command: there is no enabling, no disabling and no
    reset. An error (under-voltage, a wrong encoder, `faults.fault`) releases the motor;
    commands are ignored until `fault_stop_time` after its end, and then the next one moves the
    motor again. No frame reports an error: duty cycle and current are just 0.

    Modelled: duty cycle as a voltage, duty times the supply, clipped at `max_duty`; currents,
    clipped at `max_current`, below `min_current` the motor is released; brake current against the
    motion until it would need a voltage against the motion too, from there on the phases are
    shorted while they carry less than it (mcpwm_foc.c: no active reversal); the handbrake as a
    brake current; speed by the motor's own loop, below `min_erpm` the phases are shorted (the same
    file, "Brake when set ERPM is below min ERPM"); ping.
    The current of status 1 has the sign of the power: negative while the motor brakes, in either
    direction of rotation (`mcpwm_foc_get_tot_current_filtered`). Status 5 has 8 bytes, two
    of them reserved.

    Not modelled: SET_POS, the command buffers (5 to 8) and configuration by CAN, which are ignored
    and do not count as commands; off delay, ramps of duty and speed, field weakening, heating,
    limits of input current, power and temperature, filters of the reported values. The firmware
    does not check lengths: of a frame that is too short it reads whatever its buffer contains.
    Such frames are ignored here.

    A VESC has no heartbeat, status word, mode or answered configuration: those faults have no
    effect. With `refuse_enable` the motor stays released, whatever the command.

    Raises:
        ParameterError: The node is not from 0 to 254.
    """

    def __init__(self, motor: DriveMotor, node: int, settings: VescSettings) -> None:
        if not 0 <= node < BROADCAST_NODE:
            raise ParameterError("node", node, "must be a node id of a VESC, 0 to 254")
        super().__init__(motor, settings.boot_time)
        self._node, self._settings = node, settings
        self._timers = tuple(
            (status, Timer(1.0 / rate if rate else 0.0))
            for status, rate in (
                (STATUS_1, settings.status_1_rate),
                (STATUS_5, settings.status_5_rate),
                (STATUS_4, settings.status_4_rate),
            )
        )
        self._tachometer = settings.tachometer
        self._start_at(0.0)

    def _restart(self) -> None:
        self._commanded_at = self._ready_at
        self._blocked_until = -math.inf
        self._mode, self._value = Mode.RELEASED, 0.0
        self._is_shorted, self._brake_checked_at = False, self._ready_at
        self._origin = self._count(self._motor.position)
        for _, timer in self._timers:
            timer.restart(self._ready_at)
        self._motor.release()

    def _clear_position(self) -> None:
        self._tachometer = 0

    def receive(self, message: can.Message, now: float) -> list[can.Message]:
        """Process a frame at `now` [s]; return the answer if it is a ping."""
        if not self._update(now) or self.faults.deaf or not self._is_addressed(message):
            return []
        number, data = message.arbitration_id >> 8, bytes(message.data)
        if number == PING and data:
            answer = self._frame(PONG, data[0], bytes((self._node, HARDWARE_VESC)))
            return [] if self.faults.silent else [answer]
        command = SIMPLE_COMMANDS.get(number)
        if command is None or len(data) < 4:
            return []
        self._commanded_at = now
        self._check_errors(now)
        if now >= self._blocked_until:
            value = int.from_bytes(data[:4], "big", signed=True) / command.scale
            value *= self._settings.max_current if command.is_relative else 1.0
            self._enter(command.mode, value, now)
            self._drive(now)
        return []

    def _is_addressed(self, message: can.Message) -> bool:
        is_data = not (message.is_error_frame or message.is_remote_frame or message.is_fd)
        nodes = (self._node, BROADCAST_NODE)
        return is_data and message.is_extended_id and message.arbitration_id & 0xFF in nodes

    def advance(self, now: float) -> list[can.Message]:
        """Run timeout, errors and the brake up to a time [s]; return the due status frames."""
        if not self._update(now):
            return []
        self._check_errors(now)
        timeout = self._settings.timeout
        is_timed_out = timeout and now - self._commanded_at > timeout
        if is_timed_out and now >= self._blocked_until:
            self._enter(Mode.BRAKE, self._settings.timeout_brake_current, now)
        self._drive(now)
        return self._report(now)

    def _check_errors(self, now: float) -> None:
        has_low_supply = self._supply < self._settings.min_supply
        if self.faults.fault or self._motor.lost or has_low_supply:
            self._blocked_until = now + self._settings.fault_stop_time
            self._mode = Mode.RELEASED

    def _enter(self, mode: Mode, value: float, now: float) -> None:
        if mode is not self._mode:
            self._is_shorted, self._brake_checked_at = not self._motor.velocity, now
        self._mode, self._value = mode, value

    def _drive(self, now: float) -> None:
        motor, value, settings = self._motor, self._value, self._settings
        limit, max_duty = settings.max_current, settings.max_duty
        mode = Mode.RELEASED if self.faults.refuse_enable else self._mode
        if mode is Mode.DUTY:
            motor.follow_voltage(min(max(value, -max_duty), max_duty) * self._supply)
        elif mode is Mode.CURRENT and abs(value) >= settings.min_current:
            motor.follow_torque(min(max(value, -limit), limit) * settings.torque_constant)
        elif mode is Mode.BRAKE and abs(value) >= settings.min_current:
            self._brake(min(abs(value), limit), now)
        elif mode is Mode.SPEED and abs(value) >= settings.min_erpm:
            motor.follow_velocity(value / settings.pole_pairs * REVOLUTION / 60.0)
        elif mode is Mode.SPEED:
            motor.follow_voltage(0.0)
        else:
            motor.release()

    def _brake(self, current: float, now: float) -> None:
        motor = self._motor
        if now > self._brake_checked_at:  # the measured voltage and current are older than `now`
            self._brake_checked_at = now
            if self._is_shorted:
                self._is_shorted = abs(motor.current) < current
            else:
                self._is_shorted = motor.voltage * motor.velocity <= 0.0
        if self._is_shorted:
            motor.follow_voltage(0.0)
        else:
            torque = current * self._settings.torque_constant
            motor.follow_torque(-math.copysign(torque, motor.velocity))

    def _count(self, position: float) -> int:
        return math.floor(position / REVOLUTION * self._settings.pole_pairs * TACHOMETER_STEPS)

    def _measure(self) -> dict[str, float]:
        motor, supply = self._motor, self._supply
        position, velocity = self._encoder
        count = self._tachometer + self._count(position) - self._origin
        power = motor.voltage * motor.current
        return {
            "erpm": velocity / REVOLUTION * 60.0 * self._settings.pole_pairs,
            "current": math.copysign(motor.current, power),
            "duty": motor.voltage / supply if supply else 0.0,
            "tachometer": (count + 2**31) % 2**32 - 2**31,
            "supply": supply,
            "reserved": 0.0,
            "fet": TEMPERATURE,
            "motor": TEMPERATURE,
            "input": power / supply if supply else 0.0,
            "angle": math.degrees(position % REVOLUTION),
        }

    def _report(self, now: float) -> list[can.Message]:
        due = [status for status, timer in self._timers if timer.due(now)]
        if self.faults.frozen_reports:
            due = [status for status in due if not status.has_motion]
        values = self._measure()
        messages = []
        for status in due:
            frame = self._frame(status.command, self._node, _pack(status, values))
            messages += self._report_faults.apply(frame, self.faults)
        return [] if self.faults.silent else messages

    def _frame(self, command: int, node: int, data: bytes) -> can.Message:
        return can.Message(arbitration_id=command << 8 | node, is_extended_id=True, data=data)
