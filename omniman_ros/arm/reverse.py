"""The reverse interface: what our program on the controller reads from this host over TCP.

Eight i32, big-endian: read time-out in ms, six joint angles in 1e-6 rad, mode. That is the layout
of the public UR drivers; the program that reads it is our own.
"""

import struct
from collections.abc import Sequence
from enum import IntEnum

from omniman_ros.core.errors import InputError

JOINTS = 6
MESSAGE = struct.Struct(">8i")
SCALE = 1e6
"""i32 per rad."""
LARGEST = 2000.0
"""Largest angle that fits, rad."""
SHORTEST, LONGEST = 0.008, 0.2
"""Range of the read time-out, s: one tick of the controller, and what is still safe."""


class Mode(IntEnum):
    """What the program is to do."""

    SERVO = 1
    """Follow the joint angles."""
    STOPPED = -2
    """Decelerate, and end."""


def pack(joints: Sequence[float], mode: Mode, read_timeout: float) -> bytes:
    """Return the bytes of a message.

    Args:
        joints: Six angles, rad.
        mode: What to do.
        read_timeout: Time without another message after which the program stops the arm, s.

    Raises:
        InputError: Not six angles, not finite or too large, or a time-out out of range.
    """
    if len(joints) != JOINTS:
        raise InputError(f"{len(joints)} joint angles, expected {JOINTS}")
    for angle in joints:
        if not abs(angle) <= LARGEST:  # false for NaN, too
            raise InputError(f"joint angle {angle} rad")
    if not SHORTEST <= read_timeout <= LONGEST:
        raise InputError(f"read time-out {read_timeout} s, from {SHORTEST} to {LONGEST} s")
    numbers = [round(angle * SCALE) for angle in joints]
    return MESSAGE.pack(round(read_timeout * 1e3), *numbers, mode)
