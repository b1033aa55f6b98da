"""Host of a URScript program: the functions by which it uses the controller that runs it."""

import math

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.simulation.ur import rtde_outputs
from omniman_ros.simulation.ur.arm import CYCLE, JOINTS
from omniman_ros.simulation.ur.controller import Cb3Controller
from omniman_ros.simulation.ur.motion import MoveJ, ServoJ, SpeedJ, StopJ
from omniman_ros.simulation.ur.program_sockets import ProgramSockets
from omniman_ros.simulation.ur.urscript.errors import ScriptRuntimeError
from omniman_ros.simulation.ur.urscript.host import Done, Joints


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
        if not np.all(np.isfinite(q)):
            controller.protective_stop(f"servoj angles must be finite, not {q}")
            return lambda: True
        # The time need not be a multiple of the cycle: the last command overran by this much.
        last = controller.motion
        overrun = last.overrun if isinstance(last, ServoJ) else 0.0
        t = max(t, CYCLE) - overrun
        return controller.command(ServoJ(_joint_array(q), t, lookahead_time, gain))

    def speedj(self, qd: Joints, a: float, t: float) -> Done:
        """Accelerate to joint speeds [rad/s] with a [rad/s^2] for t [s], or no limit if t = 0."""
        return self._controller.command(SpeedJ(_joint_array(qd), _positive(a), t))

    def stopj(self, a: float) -> Done:
        """Decelerate to rest with a [rad/s^2]."""
        return self._controller.command(StopJ(_positive(a)))

    def movej(self, q: Joints, a: float, v: float, t: float, r: float) -> Done:
        """Move to joint angles [rad] and come to rest there; blends are not simulated."""
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
    if not (math.isfinite(value) and value > 0.0):
        raise ScriptRuntimeError(f"an acceleration or speed must be positive, not {value}")
    return value


def _joint_array(values: Joints) -> Array:
    if len(values) != JOINTS or not np.all(np.isfinite(values)):
        raise ScriptRuntimeError(f"joint values must be {JOINTS} finite numbers, not {values}")
    return np.array(values, dtype=float)
