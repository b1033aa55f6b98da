"""What a program can ask of the controller that runs it."""

from collections.abc import Callable
from typing import Protocol

Joints = tuple[float, ...]
Done = Callable[[], bool]
"""Asked in each cycle whether a motion command has ended; its thread waits until then."""


class Host(Protocol):
    """The controller, as the program's functions see it; all calls return at once."""

    @property
    def time(self) -> float:
        """Time of the controller, s; the same throughout a cycle."""
        ...

    def servoj(self, q: Joints, t: float, lookahead_time: float, gain: float) -> Done:
        """Servo to joint angles, rad, for a time, s."""
        ...

    def speedj(self, qd: Joints, a: float, t: float) -> Done:
        """Accelerate to joint speeds, rad/s, with a, rad/s^2; t = 0: until they are reached."""
        ...

    def stopj(self, a: float) -> Done:
        """Decelerate to rest with a, rad/s^2."""
        ...

    def movej(self, q: Joints, a: float, v: float, t: float, r: float) -> Done:
        """Move to joint angles and come to rest: acceleration, speed, or in a time if t > 0."""
        ...

    def joints(self, what: str) -> Joints:
        """Six values: "actual_q", "target_q", "actual_qd", "target_qd" [rad, rad/s]."""
        ...

    def is_steady(self) -> bool:
        """Whether the arm has been at rest for a moment."""
        ...

    def speed_scaling(self) -> float:
        """Speed slider, 0 to 1."""
        ...

    def read_register(self, kind: str, index: int) -> float:
        """Input register that an RTDE client writes: kind "int", "double", "bool"."""
        ...

    def write_register(self, kind: str, index: int, value: float) -> None:
        """Output register that RTDE clients read."""
        ...

    def socket_open(self, host: str, port: int, name: str) -> bool:
        """Connect; false if that fails."""
        ...

    def socket_close(self, name: str) -> None:
        """Close; nothing if it is not open."""
        ...

    def socket_take(self, name: str, count: int) -> bytes | None:
        """Exactly `count` bytes if so many have come, else b""; None: closed, or never open."""
        ...

    def socket_send(self, name: str, data: bytes) -> bool:
        """Send; false if it is not open or the peer does not take it."""
        ...

    def textmsg(self, text: str) -> None:
        """A line for the log."""
        ...

    def popup(self, text: str) -> None:
        """A message for the person at the pendant."""
        ...
