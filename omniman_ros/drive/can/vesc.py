"""Firmware of a VESC on a CAN bus, simulated, over a motor.

Written from the public firmware `vedderb/bldc`: `documentation/comm_can.md` (identifiers, simple
commands, status frames), `comm/comm_can.c` (`decode_msg`, `comm_can_send_status*`), `timeout.c`
and `motor/mcpwm_foc.c`.
"""

import enum
import math
import struct
from dataclasses import dataclass

import can

from omniman_ros.core.errors import ParameterError
from omniman_ros.drive.can.motor import DriveFaults, Motor
from omniman_ros.drive.can.reports import ReportFaults, Timer, check_above

TURN = 2.0 * math.pi


class Mode(enum.Enum):
    """What the motor is made to do."""

    RELEASED = "released"
    DUTY = "duty"
    CURRENT = "current"
    BRAKE = "brake"
    SPEED = "speed"


@dataclass(frozen=True)
class Setpoint:
    """A simple command: four bytes, big-endian i32, over a scale.

    Attributes:
        mode: What it asks for.
        scale: Units of the frame per duty, A, eRPM or part of the largest current.
        relative: Whether it is a part of the largest current.
    """

    mode: Mode
    scale: float
    relative: bool = False


SETPOINTS = {
    0: Setpoint(Mode.DUTY, 1e5),
    1: Setpoint(Mode.CURRENT, 1e3),
    2: Setpoint(Mode.BRAKE, 1e3),
    3: Setpoint(Mode.SPEED, 1.0),
    10: Setpoint(Mode.CURRENT, 1e5, relative=True),
    11: Setpoint(Mode.BRAKE, 1e5, relative=True),
    12: Setpoint(Mode.BRAKE, 1e3),
    13: Setpoint(Mode.BRAKE, 1e5, relative=True),
}
"""Simple commands by their number (comm_can.md, Single-Frame Commands). The scale of SET_RPM is
1, as the code and the C example have it, not 1000 as the table has it. 12 and 13 are the
handbrake."""


@dataclass(frozen=True)
class Status:
    """Layout of a status frame: big-endian integers, each a value times a scale.

    Attributes:
        command: Number in the identifier.
        layout: Format of `struct`.
        values: Name and scale of each value.
        position: Whether it tells of position or velocity.
    """

    command: int
    layout: str
    values: tuple[tuple[str, float], ...]
    position: bool


STATUS_1 = Status(9, ">ihh", (("erpm", 1.0), ("current", 10.0), ("duty", 1000.0)), True)
STATUS_4 = Status(
    16, ">hhhh", (("fet", 10.0), ("motor", 10.0), ("input", 10.0), ("angle", 50.0)), False
)
STATUS_5 = Status(27, ">ihh", (("tachometer", 1.0), ("supply", 10.0), ("reserved", 1.0)), True)

PING, PONG = 17, 18
HARDWARE_VESC = 0
EVERYBODY = 255
STEPS = 6
"""Steps of the tachometer in an electrical turn."""
TEMPERATURE = 25.0
"""Of power stage and motor, degrees Celsius; heating is not modelled."""
LIMITS = {"h": 2**15 - 1, "i": 2**31 - 1}


def _pack(status: Status, values: dict[str, float]) -> bytes:
    """Lay out a status frame; what does not fit is clipped, fractions are cut as in C."""
    numbers = []
    for kind, (name, scale) in zip(status.layout[1:], status.values, strict=True):
        limit = LIMITS[kind]
        numbers.append(int(min(max(values[name] * scale, -limit - 1), limit)))
    return struct.pack(status.layout, *numbers)


class VescDrive:
    """A VESC in the CAN mode "VESC".

    Commands are 29-bit data frames with identifier command << 8 | node, or node 255 for all;
    nothing else is heard. Each command is in force until the next one. `timeout` after the last
    one (the firmware looks every 10 ms, this at each `advance`) the motor is braked with
    `timeout_brake_current` until the next command: there is no enabling, no disabling and no
    reset. An error (under-voltage, an encoder that misleads, `faults.fault`) releases the motor;
    commands are lost until `fault_stop_time` after its end, and then the next one moves the motor
    again. No frame says that there is an error: duty and current are just 0.

    Modelled: duty as a voltage, duty times the supply, clipped at `max_duty`; currents, clipped
    at `max_current`, below `min_current` the motor is released; brake current against the motion
    until it would need a voltage against the motion too, from there on the phases are shorted
    while they carry less than it (mcpwm_foc.c: no active reversal); the handbrake as a brake
    current; speed by the motor's own loop, below `min_erpm` the phases are shorted (the same file,
    "Brake when set ERPM is below min ERPM"); ping.
    The current of status 1 has the sign of the power, negative while the motor brakes, in
    whichever direction it turns (`mcpwm_foc_get_tot_current_filtered`). Status 5 has 8 bytes, two
    of them reserved.

    Not modelled: SET_POS, the command buffers (5 to 8) and configuration by CAN: ignored, and
    they do not count as commands; off delay, ramps of duty and speed, field weakening, heating,
    limits of input current, power and temperature, filters of what is reported. The firmware
    checks no length: in a frame too short it takes whatever its buffer holds. Such frames are
    ignored here.

    What DriveFaults has and a VESC lacks: heartbeat, status word, mode, answered configuration.
    With `refuse_enable` the motor stays released whatever is commanded.

    Args:
        motor: Its motor.
        node: 0 to 254.
        pole_pairs: Electrical turns in one turn of the motor.
        torque_constant: N m/A.
        timeout: s; 0 for none. (The firmware: 1 s, or 0.5 s.)
        timeout_brake_current: A. The firmware has 0, which lets the motor coast: an installation
            must set it.
        status_1_rate, status_4_rate, status_5_rate: Hz, 0 for never; set in VESC Tool.
        max_duty: Part of the supply.
        max_current, min_current: A.
        min_erpm: Smallest speed that is controlled, eRPM. The firmware has 900: a wheel that has
            to stand still when it is told so needs 0.
        min_supply: V.
        fault_stop_time: s.
        boot_time: Time without a frame, in or out, after a restart, s.
        tachometer: What the tachometer starts with; a restart sets it to 0.

    Attributes:
        faults: Faults to play.

    Raises:
        ParameterError: A number is not possible.
    """

    def __init__(
        self,
        motor: Motor,
        node: int,
        pole_pairs: int,
        torque_constant: float,
        *,
        timeout: float = 0.5,
        timeout_brake_current: float = 5.0,
        status_1_rate: float = 200.0,
        status_4_rate: float = 20.0,
        status_5_rate: float = 200.0,
        max_duty: float = 0.95,
        max_current: float = 60.0,
        min_current: float = 0.05,
        min_erpm: float = 0.0,
        min_supply: float = 8.0,
        fault_stop_time: float = 0.5,
        boot_time: float = 1.0,
        tachometer: int = 0,
    ) -> None:
        if not 0 <= node < EVERYBODY:
            raise ParameterError("node", node, "nodes of VESC are 0 to 254")
        check_above("pole_pairs", pole_pairs, 1)
        check_above("torque_constant", torque_constant, inclusive=False)
        check_above("max_current", max_current, inclusive=False)
        check_above("max_duty", max_duty, inclusive=False)
        for name, value in (
            ("timeout", timeout),
            ("timeout_brake_current", timeout_brake_current),
            ("status_1_rate", status_1_rate),
            ("status_4_rate", status_4_rate),
            ("status_5_rate", status_5_rate),
            ("min_current", min_current),
            ("min_erpm", min_erpm),
            ("min_supply", min_supply),
            ("fault_stop_time", fault_stop_time),
            ("boot_time", boot_time),
        ):
            check_above(name, value)
        self.faults = DriveFaults()
        self._motor, self._node = motor, node
        self._pole_pairs, self._torque_constant = pole_pairs, torque_constant
        self._timeout, self._timeout_brake = timeout, timeout_brake_current
        self._max_duty, self._max_current, self._min_current = max_duty, max_current, min_current
        self._min_erpm, self._min_supply = min_erpm, min_supply
        self._fault_stop_time, self._boot_time = fault_stop_time, boot_time
        self._timers = tuple(
            (status, Timer(1.0 / rate if rate else 0.0))
            for status, rate in (
                (STATUS_1, status_1_rate),
                (STATUS_5, status_5_rate),
                (STATUS_4, status_4_rate),
            )
        )
        self._reports = ReportFaults()
        self._reboots = 0
        self._tachometer = tachometer
        self._frozen: tuple[float, float] | None = None
        self._started = False
        self._ready = 0.0
        self._restart(0.0)

    def _restart(self, ready: float) -> None:
        """Be as after power-up, from a time on."""
        self._ready = self._commanded = ready
        self._blocked = -math.inf
        self._mode, self._value = Mode.RELEASED, 0.0
        self._shorted, self._braked = False, ready
        self._origin = self._step(self._motor.position)
        for _, timer in self._timers:
            timer.restart(ready)
        self._motor.release()

    def receive(self, message: can.Message, now: float) -> list[can.Message]:
        """Hear a frame; answer it where it is a ping."""
        if not self._awake(now) or self.faults.deaf:
            return []
        if message.is_error_frame or message.is_remote_frame or message.is_fd:
            return []
        if not message.is_extended_id or message.arbitration_id & 0xFF not in (
            self._node,
            EVERYBODY,
        ):
            return []
        command, data = message.arbitration_id >> 8, bytes(message.data)
        if command == PING and data:
            answer = self._frame(PONG, data[0], bytes((self._node, HARDWARE_VESC)))
            return [] if self.faults.silent else [answer]
        setpoint = SETPOINTS.get(command)
        if setpoint is None or len(data) < 4:
            return []
        self._commanded = now
        self._check(now)
        if now >= self._blocked:
            value = int.from_bytes(data[:4], "big", signed=True) / setpoint.scale
            value *= self._max_current if setpoint.relative else 1.0
            self._enter(setpoint.mode, value, now)
            self._drive(now)
        return []

    def advance(self, now: float) -> list[can.Message]:
        """Run timeout, errors and the brake up to a time; return the status frames due."""
        if not self._awake(now):
            return []
        self._check(now)
        if self._timeout and now - self._commanded > self._timeout and now >= self._blocked:
            self._enter(Mode.BRAKE, self._timeout_brake, now)
        self._drive(now)
        return self._report(now)

    def _awake(self, now: float) -> bool:
        """Restart where that was asked for; say whether the firmware runs."""
        if not self._started:
            self._started = True
            self._restart(now)
        if self.faults.reboots > self._reboots:
            self._tachometer = 0
            self._restart(now + self._boot_time)
        self._reboots = self.faults.reboots
        if not self.faults.frozen_encoder:
            self._frozen = None
        elif self._frozen is None:
            self._frozen = self._motor.position, self._motor.velocity
        return now >= self._ready

    @property
    def _supply(self) -> float:
        return self.faults.supply or self._motor.supply

    def _check(self, now: float) -> None:
        """Release the motor while there is an error and for a while after it."""
        if self.faults.fault or self._motor.lost or self._supply < self._min_supply:
            self._blocked = now + self._fault_stop_time
            self._mode = Mode.RELEASED

    def _enter(self, mode: Mode, value: float, now: float) -> None:
        if mode is not self._mode:
            self._shorted, self._braked = not self._motor.velocity, now
        self._mode, self._value = mode, value

    def _drive(self, now: float) -> None:
        """Give the motor what the mode asks for."""
        motor, value = self._motor, self._value
        limit = self._max_current
        mode = Mode.RELEASED if self.faults.refuse_enable else self._mode
        if mode is Mode.DUTY:
            motor.follow_voltage(min(max(value, -self._max_duty), self._max_duty) * self._supply)
        elif mode is Mode.CURRENT and abs(value) >= self._min_current:
            motor.follow_torque(min(max(value, -limit), limit) * self._torque_constant)
        elif mode is Mode.BRAKE and abs(value) >= self._min_current:
            self._brake(min(abs(value), limit), now)
        elif mode is Mode.SPEED and abs(value) >= self._min_erpm:
            motor.follow_velocity(value / self._pole_pairs * TURN / 60.0)
        elif mode is Mode.SPEED:
            motor.follow_voltage(0.0)
        else:
            motor.release()

    def _brake(self, current: float, now: float) -> None:
        motor = self._motor
        if now > self._braked:  # voltage and current are those of the last order
            self._braked = now
            if self._shorted:
                self._shorted = abs(motor.current) < current
            else:
                self._shorted = motor.voltage * motor.velocity <= 0.0
        if self._shorted:
            motor.follow_voltage(0.0)
        else:
            motor.follow_torque(-math.copysign(current * self._torque_constant, motor.velocity))

    def _step(self, position: float) -> int:
        return math.floor(position / TURN * self._pole_pairs * STEPS)

    def _measure(self) -> dict[str, float]:
        motor, supply = self._motor, self._supply
        position, velocity = self._frozen or (motor.position, motor.velocity)
        count = self._tachometer + self._step(position) - self._origin
        power = motor.voltage * motor.current
        return {
            "erpm": velocity / TURN * 60.0 * self._pole_pairs,
            "current": math.copysign(motor.current, power),
            "duty": motor.voltage / supply if supply else 0.0,
            "tachometer": (count + 2**31) % 2**32 - 2**31,
            "supply": supply,
            "reserved": 0.0,
            "fet": TEMPERATURE,
            "motor": TEMPERATURE,
            "input": power / supply if supply else 0.0,
            "angle": math.degrees(position % TURN),
        }

    def _report(self, now: float) -> list[can.Message]:
        due = [status for status, timer in self._timers if timer.due(now)]
        if self.faults.frozen_reports:
            due = [status for status in due if not status.position]
        values = self._measure()
        messages = []
        for status in due:
            frame = self._frame(status.command, self._node, _pack(status, values))
            messages += self._reports.apply(frame, self.faults)
        return [] if self.faults.silent else messages

    def _frame(self, command: int, node: int, data: bytes) -> can.Message:
        return can.Message(arbitration_id=command << 8 | node, is_extended_id=True, data=data)
