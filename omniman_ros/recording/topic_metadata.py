"""Metadata of a topic to be recorded; it does not need the library that writes recordings."""

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class OfferedQos:
    """Quality of service that a publisher offers."""

    reliable: bool = True  #: Whether lost messages are sent again
    transient_local: bool = False  #: Whether late subscribers receive the last messages
    depth: int = 10  #: Number of messages that the publisher keeps; 0 if unknown


@dataclass(frozen=True)
class TopicMetadata:
    """Metadata of a topic that a recording stores."""

    name: str  #: Absolute name
    message_type: str  #: Type of its messages, PACKAGE/msg/NAME
    definition: str  #: Definition of the type; see `MessageDefinitions.lookup`
    type_hash: str  #: Hash of the type; see `MessageDefinitions.lookup`
    offered_qos: Sequence[OfferedQos] = ()  #: Quality of service of each of its publishers
