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

from omniman_ros.arm.errors import ProtocolError

VERSION = 2
"""Of the protocol: with recipe ids, and an output rate that is asked for."""
HEADER = struct.Struct(">HB")
LARGEST = 4096
"""Longest packet that is believed, bytes: all outputs together need less."""


class PacketType(IntEnum):
    """Types of packets that are sent or heard here."""

    PROTOCOL_VERSION = 86
    TEXT_MESSAGE = 77
    DATA = 85
    SETUP_OUTPUTS = 79
    SETUP_INPUTS = 73
    START = 83
    PAUSE = 80


class Packet(NamedTuple):
    """One packet.

    Attributes:
        kind: Its type; any number that the peer may send.
        payload: What follows the header.
    """

    kind: int
    payload: bytes


FORMATS = {
    "BOOL": "?", "UINT8": "B", "UINT32": "I", "UINT64": "Q", "INT32": "i", "DOUBLE": "d",
    "VECTOR3D": "3d", "VECTOR6D": "6d", "VECTOR6INT32": "6i", "VECTOR6UINT32": "6I",
}  # fmt: skip
"""Type of a variable to its format."""


def pack(kind: PacketType, payload: bytes = b"") -> bytes:
    """Return the bytes of a packet."""
    return HEADER.pack(HEADER.size + len(payload), kind) + payload


def request_version() -> bytes:
    """Ask for version 2."""
    return pack(PacketType.PROTOCOL_VERSION, struct.pack(">H", VERSION))


def setup_outputs(rate: float, names: Sequence[str]) -> bytes:
    """Ask for variables at a rate, Hz."""
    return pack(PacketType.SETUP_OUTPUTS, struct.pack(">d", rate) + ",".join(names).encode())


def start() -> bytes:
    """Ask for the data to begin."""
    return pack(PacketType.START)


def accepted(payload: bytes) -> bool:
    """Tell the answer to a version or a start.

    Raises:
        ProtocolError: It is none.
    """
    if len(payload) != 1:
        raise ProtocolError(f"RTDE: an answer of {len(payload)} bytes, expected 1")
    return payload[0] == 1


class PacketReader:
    """Cuts a stream of bytes into packets, however it arrives."""

    def __init__(self) -> None:
        self._rest = b""

    def feed(self, data: bytes) -> Iterator[Packet]:
        """Yield the packets that are complete with these bytes.

        Raises:
            ProtocolError: A size that cannot be: the stream is out of step for good.
        """
        self._rest += data
        while len(self._rest) >= HEADER.size:
            size, kind = HEADER.unpack_from(self._rest)
            if not HEADER.size <= size <= LARGEST:
                raise ProtocolError(f"RTDE: a packet of {size} bytes (type {kind})")
            if len(self._rest) < size:
                return
            payload, self._rest = self._rest[HEADER.size : size], self._rest[size:]
            yield Packet(kind, payload)


@dataclass(frozen=True)
class Recipe:
    """What a data packet holds, as the controller confirmed it.

    Attributes:
        id: Of the recipe.
        names: Of the variables.
        types: Of the variables, keys of FORMATS.
    """

    id: int
    names: tuple[str, ...]
    types: tuple[str, ...]

    @classmethod
    def confirmed(cls, names: Sequence[str], payload: bytes) -> "Recipe":
        """Read the answer to :func:`setup_outputs`.

        Raises:
            ProtocolError: A variable is not there or in use, or the answer does not fit.
        """
        if not payload:
            raise ProtocolError("RTDE: an empty answer to the set-up of outputs")
        types = payload[1:].decode("ascii", "replace").split(",")
        for name, kind in zip(names, types, strict=False):
            if kind not in FORMATS:
                raise ProtocolError(f"RTDE: output '{name}': {kind[:40]}")
        if len(types) != len(names):
            raise ProtocolError(f"RTDE: {len(types)} types for {len(names)} outputs")
        return cls(payload[0], tuple(names), tuple(types))

    @cached_property
    def layout(self) -> struct.Struct:
        """Layout of the values after the id."""
        return struct.Struct(">" + "".join(FORMATS[kind] for kind in self.types))

    def values(self, payload: bytes) -> dict[str, tuple[float, ...]]:
        """Values of a data packet by name; a scalar is a tuple of one.

        Raises:
            ProtocolError: Another recipe or size.
        """
        layout = self.layout
        if len(payload) != 1 + layout.size or payload[0] != self.id:
            raise ProtocolError(
                f"RTDE: data of {len(payload)} bytes for recipe {payload[0] if payload else '-'}, "
                f"expected {1 + layout.size} for {self.id}"
            )
        flat, at = layout.unpack_from(payload, 1), 0
        result = {}
        for name, kind in zip(self.names, self.types, strict=True):
            count = int(FORMATS[kind][0]) if FORMATS[kind][0].isdigit() else 1
            result[name] = flat[at : at + count]
            at += count
        return result


def text_message(payload: bytes) -> str:
    """Text of a message of the controller, "source: text"; what can be read of it."""
    parts, at = [], 0
    for _ in range(2):
        if at >= len(payload):
            break
        length = payload[at]
        parts.append(payload[at + 1 : at + 1 + length].decode("ascii", "replace"))
        at += 1 + length
    return ": ".join(reversed(parts))
