"""RTDE, version 2: packets of the controller's real-time data exchange (TCP port 30004).

Source: Universal Robots, "Real-Time Data Exchange (RTDE) Guide". Everything is big-endian: size
with the header (u16), type (u8), payload.
"""

import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from typing import NamedTuple

from omniman_ros.core.errors import OmnimanError

VERSION = 2  #: Version of the protocol, which has recipe ids and a requested output rate
HEADER = struct.Struct(">HB")  #: Layout of the header of a packet: size with the header, and type
#: Size of the longest packet that is accepted [bytes]; all outputs together need less
MAX_PACKET_SIZE = 4096


class ProtocolError(OmnimanError):
    """The peer violates the protocol or refuses a request; the connection is unusable."""


class PacketType(IntEnum):
    """Types of packets that are sent or received here."""

    PROTOCOL_VERSION = 86
    TEXT_MESSAGE = 77
    DATA = 85
    SETUP_OUTPUTS = 79
    SETUP_INPUTS = 73
    START = 83
    PAUSE = 80


class RtdePacket(NamedTuple):
    """One packet."""

    kind: int  #: Type of the packet; the peer may send any number
    payload: bytes  #: Bytes after the header


FORMATS = {
    "BOOL": "?",
    "UINT8": "B",
    "UINT32": "I",
    "UINT64": "Q",
    "INT32": "i",
    "DOUBLE": "d",
    "VECTOR3D": "3d",
    "VECTOR6D": "6d",
    "VECTOR6INT32": "6i",
    "VECTOR6UINT32": "6I",
}  #: Format of each type of variable, in the notation of `struct`


def pack(kind: PacketType, payload: bytes = b"") -> bytes:
    """Return the bytes of a packet."""
    return HEADER.pack(HEADER.size + len(payload), kind) + payload


def request_version() -> bytes:
    """Return the request for version 2 of the protocol."""
    return pack(PacketType.PROTOCOL_VERSION, struct.pack(">H", VERSION))


def setup_outputs(rate: float, names: Sequence[str]) -> bytes:
    """Return the request for output variables at a rate [Hz]."""
    return pack(PacketType.SETUP_OUTPUTS, struct.pack(">d", rate) + ",".join(names).encode())


def start() -> bytes:
    """Return the request to start the data."""
    return pack(PacketType.START)


def accepted(payload: bytes) -> bool:
    """Return whether an answer to a request is positive; raise ProtocolError if it is none."""
    if len(payload) != 1:
        raise ProtocolError(f"RTDE: an answer must have 1 byte, got {len(payload)}")
    return payload[0] == 1


class PacketReader:
    """Splits a stream of bytes into packets, in whatever pieces the bytes arrive."""

    def __init__(self) -> None:
        self._rest = b""

    def feed(self, data: bytes) -> Iterator[RtdePacket]:
        """Yield the packets that these bytes complete.

        Raises:
            ProtocolError: A size is impossible, so that no later packet can be found either.
        """
        self._rest += data
        while len(self._rest) >= HEADER.size:
            size, kind = HEADER.unpack_from(self._rest)
            if not HEADER.size <= size <= MAX_PACKET_SIZE:
                raise ProtocolError(f"RTDE: a packet of {size} bytes (type {kind})")
            if len(self._rest) < size:
                return
            payload, self._rest = self._rest[HEADER.size : size], self._rest[size:]
            yield RtdePacket(kind, payload)


@dataclass(frozen=True)
class Recipe:
    """Content of a data packet, as the controller has confirmed it."""

    id: int  #: Number of the recipe
    names: tuple[str, ...]  #: Names of the variables
    types: tuple[str, ...]  #: Types of the variables, keys of `FORMATS`

    @classmethod
    def confirmed(cls, names: Sequence[str], payload: bytes) -> "Recipe":
        """Read the answer to :func:`setup_outputs`.

        Raises:
            ProtocolError: A variable is missing or in use, or the answer does not fit.
        """
        if not payload:
            raise ProtocolError("RTDE: the answer to the setup of outputs is empty")
        types = payload[1:].decode("ascii", "replace").split(",")
        for name, kind in zip(names, types, strict=False):
            if kind not in FORMATS:
                raise ProtocolError(f"RTDE: output '{name}': {kind[:40]}")
        if len(types) != len(names):
            raise ProtocolError(f"RTDE: must be {len(names)} types of outputs, got {len(types)}")
        return cls(payload[0], tuple(names), tuple(types))

    @cached_property
    def layout(self) -> struct.Struct:
        """Layout of the values after the id."""
        return struct.Struct(">" + "".join(FORMATS[kind] for kind in self.types))

    def values(self, payload: bytes) -> dict[str, tuple[float, ...]]:
        """Return the values of a data packet by name; a scalar is a tuple of one.

        Raises:
            ProtocolError: The packet has another recipe or size.
        """
        layout = self.layout
        if len(payload) != 1 + layout.size or payload[0] != self.id:
            raise ProtocolError(
                f"RTDE: data of {len(payload)} bytes for recipe {payload[0] if payload else '-'}, "
                f"expected {1 + layout.size} for {self.id}"
            )
        flat, start = layout.unpack_from(payload, 1), 0
        result = {}
        for name, kind in zip(self.names, self.types, strict=True):
            count = int(FORMATS[kind][0]) if FORMATS[kind][0].isdigit() else 1
            result[name] = flat[start : start + count]
            start += count
        return result


def text_message(payload: bytes) -> str:
    """Return a message of the controller as "source: text", as far as it can be decoded."""
    parts, start = [], 0
    for _ in range(2):
        if start >= len(payload):
            break
        length = payload[start]
        parts.append(payload[start + 1 : start + 1 + length].decode("ascii", "replace"))
        start += 1 + length
    return ": ".join(reversed(parts))
