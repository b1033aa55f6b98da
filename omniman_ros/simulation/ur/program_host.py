"""Host of a URScript program: the functions by which it uses the controller that runs it."""

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.simulation.ur import rtde_outputs
from omniman_ros.simulation.ur.arm import CYCLE
from omniman_ros.simulation.ur.controller import Cb3Controller
from omniman_ros.simulation.ur.motion import MoveJ, ServoJ, SpeedJ, StopJ
from omniman_ros.simulation.ur.program_sockets import ProgramSockets
from omniman_ros.simulation.ur.urscript.errors import ScriptRuntimeError
from omniman_ros.simulation.ur.urscript.host import Done, Joints

#: Largest magnitude of what a motion command accepts [rad, rad/s, rad/s^2, s], far beyond what the
#: arm can do; it keeps the arithmetic of the motion finite
MOST = 1e6
LOOKAHEAD_TIME = 0.03, 0.2  #: Lookahead times that servoj accepts [s] (URScript manual, servoj)
GAIN = 100.0, 2000.0  #: Gains that servoj accepts (ibid.)


class ProgramHost:
    """Implements the `Host` of one program by the controller and its sockets."""

    def __init__(self, controller: Cb3Controller, network: ProgramSockets) -> None:
        self._controller, self._network = controller, network
        self._last_servo: Joints = ()

    @property
    def time(self) -> float:
        """Time since the start, the same throughout a cycle [s]."""
        return self._controller.time

    def servoj(self, q: Joints, t: float, lookahead_time: float, gain: float) -> Done:
        """Servo to joint angles [rad] for a time [s]."""
        controller = self._controller
        controller.counts.servo_calls += 1
        controller.counts.servo_repeats += q == self._last_servo
        self._last_servo = q
        _require_within(t, "a time", -MOST, MOST)
        _require_within(lookahead_time, "a lookahead time", *LOOKAHEAD_TIME)
        _require_within(gain, "a gain", *GAIN)
        if not np.all(np.abs(q) <= MOST):  # NaN is not, either
            controller.protective_stop(f"servoj angles must be up to {MOST:g} rad, not {q}")
            return lambda: True
        # The time need not be a multiple of the cycle: the last command overran by this much.
        last = controller.motion
        overrun = last.overrun if isinstance(last, ServoJ) else 0.0
        t = max(t, CYCLE) - overrun
        return controller.command(ServoJ(_joint_array(q), t, lookahead_time, gain))

    def speedj(self, qd: Joints, a: float, t: float) -> Done:
        """Accelerate to joint speeds [rad/s] with a [rad/s^2] for t [s], or no limit if t = 0."""
        _require_within(t, "a time", 0.0, MOST)
        return self._controller.command(SpeedJ(_joint_array(qd), _positive(a), t))

    def stopj(self, a: float) -> Done:
        """Decelerate to rest with a [rad/s^2]."""
        return self._controller.command(StopJ(_positive(a)))

    def movej(self, q: Joints, a: float, v: float, t: float, r: float) -> Done:
        """Move to joint angles [rad] and come to rest there; blends are not simulated."""
        if t != 0.0:
            _require_within(t, "a time", CYCLE, MOST)
        return self._controller.command(MoveJ(_joint_array(q), _positive(a), _positive(v), t))

    def joints(self, what: str) -> Joints:
        """Return six values of an RTDE output, see `Host`."""
        value = rtde_outputs.value(self._controller, what)
        assert isinstance(value, tuple)
        return value

    def is_steady(self) -> bool:
        """Return whether the arm has been at rest for `STEADY_TIME`."""
        return self._controller.is_steady

    def speed_scaling(self) -> float:
        """Return the speed slider as it is in effect, 0 to 1."""
        return self._controller.fraction

    def read_register(self, kind: str, index: int) -> float:
        """Return an input register, which an RTDE client writes."""
        return self._controller.registers.read("input", kind, index)

    def write_register(self, kind: str, index: int, value: float) -> None:
        """Write an output register, which RTDE clients read."""
        self._controller.registers.write("output", kind, index, value)

    def socket_open(self, host: str, port: int, name: str) -> bool:
        """Connect; return whether that succeeded."""
        return self._network.open(host, port, name)

    def socket_close(self, name: str) -> None:
        """Close a connection; do nothing if it is not open."""
        self._network.close(name)

    def socket_take(self, name: str, count: int) -> bytes | None:
        """Return exactly `count` bytes, b"" while fewer have arrived, or None if not open."""
        return self._network.take(name, count)

    def socket_send(self, name: str, data: bytes) -> bool:
        """Send; return False if the connection is not open, or the peer does not accept it."""
        return self._network.send(name, data)

    def textmsg(self, text: str) -> None:
        """Write a line into the log."""
        self._controller.textmsg(text)

    def popup(self, text: str) -> None:
        """Show a message to the person at the pendant."""
        self._controller.popup(text)


def _positive(value: float) -> float:
    if not 0.0 < value <= MOST:
        raise ScriptRuntimeError(
            f"an acceleration or speed must be above 0 and up to {MOST:g}, not {value}"
        )
    return value


def _require_within(value: float, what: str, low: float, high: float) -> None:
    """Raise a ScriptRuntimeError if a value is not within bounds; NaN is not."""
    if not low <= value <= high:
        raise ScriptRuntimeError(f"{what} must be {low:g} to {high:g}, not {value}")


def _joint_array(values: Joints) -> Array:
    for value in values:
        _require_within(value, "a joint value", -MOST, MOST)
    return np.array(values, dtype=float)
