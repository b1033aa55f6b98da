"""Joint states that are received serialized, and read without a message where nothing is new."""

import struct
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from sensor_msgs.msg import JointState

from omniman_ros.conversions.headers import SerializedStamp
from omniman_ros.conversions.joints import joint_arrays
from omniman_ros.core.arrays import Array
from omniman_ros.nodes.message_template import STAMP, MessageTemplate, marks
from omniman_ros.nodes.serialized import deserialized

_STAMP = struct.Struct("=iI")
_FIELDS = ("position", "velocity", "effort")


class JointArrays(NamedTuple):
    """Contents of a joint state in the order of a reader's names.

    Attributes:
        stamp: Stamp of the message.
        position: (n,) or None if the message has none.
        velocity: (n,) or None.
        effort: (n,) or None.
    """

    stamp: SerializedStamp
    position: Array | None
    velocity: Array | None
    effort: Array | None


class JointStateReader:
    """Reads serialized joint states.

    A sender's messages differ in stamp and numbers only. A message that is like the last one in
    all other bytes is read from where these are; any other one is deserialized and checked.

    Args:
        names: Names of the n joints, in the order of the results.
    """

    def __init__(self, names: Sequence[str]) -> None:
        self._names = list(names)
        self._constant: list[tuple[slice, bytes]] = []
        self._size = self._stamp = 0
        self._places: list[int | None] = []

    def read(self, data: bytes) -> JointArrays:
        """Return the contents of a message.

        Args:
            data: The serialized message.

        Raises:
            InputError: The data are no joint state, or see `joint_arrays`.
        """
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
            self._learn(message)
        stamp = message.header.stamp
        return JointArrays(SerializedStamp(stamp.sec, stamp.nanosec), *arrays)

    def _learn(self, message: JointState) -> None:
        """Keep where the numbers are in messages like this one, whose names are those expected."""
        n = len(self._names)
        layout = JointState(name=message.name)
        layout.header.stamp, layout.header.frame_id = STAMP, message.header.frame_id
        present = [field for field in _FIELDS if len(getattr(message, field))]
        for k, field in enumerate(present):
            setattr(layout, field, marks(n, k * n))
        template = MessageTemplate(layout)
        self._size, (self._stamp,) = template.size, template.stamps
        self._constant = [
            (slice(place, place + len(part)), part) for place, part in template.constant_parts()
        ]
        places = dict(zip(present, (place for place, _ in template.runs), strict=True))
        self._places = [places.get(field) for field in _FIELDS]
