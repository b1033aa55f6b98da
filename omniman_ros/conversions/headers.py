"""Convert stamps and durations, and check the frames of message headers."""

from collections.abc import Callable
from typing import NamedTuple, Protocol

from builtin_interfaces.msg import Duration, Time
from std_msgs.msg import Header

from omniman_ros.core.errors import InputError
from omniman_ros.core.transform_tree import ODOM, Placement


class SerializedStamp(NamedTuple):
    """Stamp that was read without a message, with the fields of one."""

    sec: int  #: Seconds [s]
    nanosec: int  #: Nanoseconds beyond these [ns]

    @property
    def nanoseconds(self) -> int:
        """The whole time [ns]."""
        return self.sec * 1_000_000_000 + self.nanosec


class Stamp(Protocol):
    """Stamp of a message, of `builtin_interfaces/Time` or read without a message."""

    @property
    def sec(self) -> int:
        """Seconds [s]."""

    @property
    def nanosec(self) -> int:
        """Nanoseconds beyond these [ns]."""


def time_seconds(stamp: Time | Duration) -> float:
    """Convert a stamp or a duration to seconds."""
    return float(stamp.sec) + 1e-9 * float(stamp.nanosec)


def is_stamped(stamp: Stamp) -> bool:
    """Return whether a stamp states a time; a zero stamp does not."""
    return bool(stamp.sec or stamp.nanosec)


def duration_message(seconds: float) -> Duration:
    """Convert a non-negative time [s] to a duration."""
    nanoseconds = round(seconds * 1e9)
    return Duration(sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)


def within(*frames: str) -> Callable[[Header], Placement]:
    """Return a function that places coordinates in odom; it raises InputError for other frames."""

    def place(header: Header) -> Placement:
        check_frame(header.frame_id, *frames)
        return Placement(ODOM)

    return place


def check_frame(frame: str, *allowed: str) -> None:
    """Raise InputError unless a frame, without its leading slash, is one of those allowed."""
    if frame.lstrip("/") not in allowed:
        names = " or ".join(repr(name) for name in allowed)
        raise InputError(f"it has frame '{frame[:40]}', expected {names}")
