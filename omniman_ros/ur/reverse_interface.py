"""Reverse interface: the messages that our program on the controller reads from this host by TCP.

A message is eight int32, big-endian: read timeout [ms], six joint angles [1e-6 rad], mode. This is
the layout of the public UR drivers; the program that reads it is our own.
"""

import struct
from collections.abc import Sequence
from enum import IntEnum

from omniman_ros.core.errors import InputError

JOINTS = 6  #: Number of joints of a UR arm
MESSAGE = struct.Struct(">8i")  #: Layout of a message
SCALE = 1e6  #: Counts of a message per joint angle [1/rad]
MAX_ANGLE = 2000.0  #: Largest joint angle that fits into a message [rad]
MIN_READ_TIMEOUT = 0.008  #: Shortest read timeout: one cycle of the controller [s]
MAX_READ_TIMEOUT = 0.2  #: Longest read timeout that is still safe [s]


class ProgramMode(IntEnum):
    """Mode that a message requests of the program."""

    SERVO = 1  #: Follow the joint angles
    STOPPED = -2  #: Decelerate and end


def pack(joints: Sequence[float], mode: ProgramMode, read_timeout: float) -> bytes:
    """Return the bytes of a message.

    Args:
        joints: Six joint angles [rad].
        read_timeout: Time without another message after which the program stops the arm [s].

    Raises:
        InputError: There are not six angles, one is not finite or too large, or the timeout is
            out of range.
    """
    if len(joints) != JOINTS:
        raise InputError(f"must be {JOINTS} joint angles, got {len(joints)}")
    for angle in joints:
        if not abs(angle) <= MAX_ANGLE:  # False for NaN, too
            raise InputError(f"joint angle {angle} rad, the limit is {MAX_ANGLE:g} rad")
    if not MIN_READ_TIMEOUT <= read_timeout <= MAX_READ_TIMEOUT:
        raise InputError(
            f"read timeout {read_timeout} s must be {MIN_READ_TIMEOUT} to {MAX_READ_TIMEOUT} s"
        )
    numbers = [round(angle * SCALE) for angle in joints]
    return MESSAGE.pack(round(read_timeout * 1e3), *numbers, mode)
