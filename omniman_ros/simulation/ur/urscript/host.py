"""Interface of a program to the controller that runs it."""

from collections.abc import Callable
from typing import Protocol

Joints = tuple[float, ...]  #: Six values, one per joint [rad] or [rad/s]
Done = Callable[[], bool]  #: Tells whether a motion has ended; called in each waiting cycle


class Host(Protocol):
    """The controller, as the program's functions see it; all calls return at once."""

    @property
    def time(self) -> float:
        """Time of the controller [s]; the same throughout a cycle."""

    def servoj(self, q: Joints, t: float, lookahead_time: float, gain: float) -> Done:
        """Servo to joint angles [rad] for a time [s]."""

    def speedj(self, qd: Joints, a: float, t: float) -> Done:
        """Accelerate to joint speeds [rad/s] with a [rad/s^2] for t [s], or no limit if t = 0."""

    def stopj(self, a: float) -> Done:
        """Decelerate to rest with a [rad/s^2]."""

    def movej(self, q: Joints, a: float, v: float, t: float, r: float) -> Done:
        """Move to joint angles [rad] with a [rad/s^2] and v [rad/s], or in t [s] if t > 0."""

    def joints(self, what: str) -> Joints:
        """Return "actual_q" or "target_q" [rad], or "actual_qd" or "target_qd" [rad/s]."""

    def is_steady(self) -> bool:
        """Return whether the arm has been at rest for a moment."""

    def speed_scaling(self) -> float:
        """Return the position of the speed slider, 0 to 1."""

    def read_register(self, kind: str, index: int) -> float:
        """Return an input register that an RTDE client writes, of kind "int", "double", "bool"."""

    def write_register(self, kind: str, index: int, value: float) -> None:
        """Write an output register, which RTDE clients read."""

    def socket_open(self, host: str, port: int, name: str) -> bool:
        """Connect, and return whether that succeeded."""

    def socket_close(self, name: str) -> None:
        """Close a connection; do nothing if it is not open."""

    def socket_take(self, name: str, count: int) -> bytes | None:
        """Return exactly `count` bytes, b"" while fewer have arrived, or None if not open."""

    def socket_send(self, name: str, data: bytes) -> bool:
        """Send; return False if the connection is not open, or the peer does not accept it."""

    def textmsg(self, text: str) -> None:
        """Write a line into the log."""

    def popup(self, text: str) -> None:
        """Show a message to the person at the pendant."""
