"""Metadata of a topic to be recorded; it does not need the library that writes recordings."""

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class OfferedQos:
    """Quality of service that a publisher offers.

    Attributes:
        reliable: Whether lost messages are sent again.
        transient_local: Whether late subscribers receive the last messages.
        depth: Number of messages that the publisher keeps; 0 if unknown.
    """

    reliable: bool = True
    transient_local: bool = False
    depth: int = 10


@dataclass(frozen=True)
class TopicMetadata:
    """Metadata of a topic that a recording stores.

    Attributes:
        name: Absolute name.
        message_type: Type of its messages, PACKAGE/msg/NAME.
        definition: Definition of the type; see `MessageDefinitions.lookup`.
        type_hash: Hash of the type; see `MessageDefinitions.lookup`.
        offered_qos: Quality of service of each of its publishers.
    """

    name: str
    message_type: str
    definition: str
    type_hash: str
    offered_qos: Sequence[OfferedQos] = ()
