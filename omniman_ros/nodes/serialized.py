"""Messages that a node receives serialized, and unpacks when it needs them."""

import struct
from typing import TypeVar

from rclpy.serialization import deserialize_message

from omniman_ros.conversions.headers import SerializedStamp
from omniman_ros.core.errors import InputError
from omniman_ros.nodes.rclpy_compat import RMWError

Message = TypeVar("Message")  #: Type of a message
_STAMP_END = 12  #: Number of bytes up to the end of the stamp


def deserialized(data: bytes, kind: type[Message]) -> Message:
    """Return the message that a raw subscription has received; raise InputError for other data."""
    try:
        message: Message = deserialize_message(data, kind)
    except (RMWError, UnicodeError) as error:
        raise InputError(f"{len(data)} bytes are no {kind.__name__}") from error
    return message


def serialized_stamp(data: bytes) -> SerializedStamp:
    """Return the stamp of a serialized message that begins with a header; zero if it is cut off.

    The stamp follows the 4 bytes of the encapsulation, whose second one says the byte order.
    """
    if len(data) < _STAMP_END:
        return SerializedStamp(0, 0)
    return SerializedStamp(*struct.unpack_from("<iI" if data[1] & 1 else ">iI", data, 4))
