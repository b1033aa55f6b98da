"""Messages that a node receives serialized, and unpacks when it needs them."""

from typing import TypeVar

from rclpy.serialization import deserialize_message

from omniman_ros.core.errors import InputError
from omniman_ros.nodes.rclpy_compat import RMWError

Message = TypeVar("Message")  #: Type of a message


def deserialized(data: bytes, kind: type[Message]) -> Message:
    """Return the message that a raw subscription has received; raise InputError for other data."""
    try:
        message: Message = deserialize_message(data, kind)
    except (RMWError, UnicodeError) as error:
        raise InputError(f"{len(data)} bytes are no {kind.__name__}") from error
    return message
