"""Joint states that are received serialized, and read without a message where nothing is new."""

import struct
import sys
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from sensor_msgs.msg import JointState

from omniman_ros.conversions.headers import SerializedStamp
from omniman_ros.conversions.joints import joint_arrays
from omniman_ros.core.arrays import Array
from omniman_ros.nodes.serialized import deserialized

_STAMP = struct.Struct("=iI")
_LENGTH = struct.Struct("=I")
_DOUBLE = 8
#: First bytes of messages in plain CDR, in this machine's byte order (OMG DDSI-RTPS 2.5, 10.2)
_PLAIN_CDR = b"\x00\x01\x00\x00" if sys.byteorder == "little" else b"\x00\x00\x00\x00"
_FIELDS = ("position", "velocity", "effort")


class JointArrays(NamedTuple):
    """Contents of a joint state in the order of a reader's names."""

    stamp: SerializedStamp  #: Stamp of the message
    position: Array | None  #: (n,) or None if the message has none
    velocity: Array | None  #: (n,) or None
    effort: Array | None  #: (n,) or None


class JointStateReader:
    """Reads serialized joint states.

    A sender's messages differ in stamp, numbers and padding only. A message that is like the last
    one in all other bytes is read from where stamp and numbers are; any other one is deserialized
    and checked.
    """

    def __init__(self, names: Sequence[str]) -> None:
        self._names = list(names)
        self._constant: list[tuple[slice, bytes]] = []
        self._size = self._stamp = 0
        self._places: list[int | None] = []

    def read(self, data: bytes) -> JointArrays:
        """Return the contents of a message, or raise the InputError of `joint_arrays`."""
        if len(data) == self._size and all(data[part] == same for part, same in self._constant):
            n = len(self._names)
            position, velocity, effort = (
                None if place is None else np.frombuffer(data, np.double, n, place)
                for place in self._places
            )
            return JointArrays(
                SerializedStamp(*_STAMP.unpack_from(data, self._stamp)), position, velocity, effort
            )
        message = deserialized(data, JointState)
        arrays = joint_arrays(message, self._names)
        if message.name == self._names:
            self._learn(data)
        stamp = message.header.stamp
        return JointArrays(SerializedStamp(stamp.sec, stamp.nanosec), *arrays)

    def _learn(self, data: bytes) -> None:
        """Keep where the numbers are in data like these, whose names are those expected."""
        if not data.startswith(_PLAIN_CDR):
            return
        layout = _Layout(data)
        self._stamp = layout.take(_STAMP.size, 4)
        layout.keep_text()
        layout.keep_length()
        for _ in self._names:
            layout.keep_text()
        self._places = []
        for _ in _FIELDS:
            count = layout.keep_length()
            self._places.append(layout.take(count * _DOUBLE, _DOUBLE) if count else None)
        self._size = len(data)
        self._constant = [(part, data[part]) for part in layout.kept]


class _Layout:
    """Places of the parts of serialized data, one after the other.

    What fills the gaps between them has no meaning, and may differ from message to message.

    Attributes:
        kept: Places of the parts that must stay as they are.
    """

    def __init__(self, data: bytes) -> None:
        self._data, self._end = data, len(_PLAIN_CDR)
        self.kept = [slice(0, self._end)]

    def take(self, size: int, alignment: int) -> int:
        """Return the place of the next part, whose size is given [bytes]."""
        origin = len(_PLAIN_CDR)
        begin = origin - (origin - self._end) // alignment * alignment
        self._end = begin + size
        return begin

    def keep_length(self) -> int:
        """Keep a length, and return it."""
        begin = self.take(_LENGTH.size, _LENGTH.size)
        self.kept.append(slice(begin, self._end))
        length: int = _LENGTH.unpack_from(self._data, begin)[0]
        return length

    def keep_text(self) -> None:
        """Keep a text and its length."""
        begin = self.take(self.keep_length(), 1)
        self.kept.append(slice(begin, self._end))
