"""Records of the stream: frames of a CAN bus, and instants up to which the sender has come.

A record has 20 bytes, in network byte order:

* 4 bytes: MAGIC, which includes the version;
* uint8: kind, 1 for a frame, 2 for an instant;
* uint8: flags of a frame, bit 0 for an id of 29 bits, bit 1 for a remote frame; else 0;
* uint8: number of bytes of a frame's payload; else 0;
* 1 byte: zero;
* uint32: arbitration id of a frame; else 0;
* 8 bytes: payload of a frame, filled up with zeros; float64 of an instant.

What was sent before an instant arrives before it: that is what the stream is for.
"""

import math
import struct
from dataclasses import dataclass

from omniman_ros.core.errors import InputError

MAGIC = b"OCL1"  #: First bytes of each record
MAX_PAYLOAD = 8  #: Largest payload of a frame [bytes]
MAX_ID, MAX_EXTENDED_ID = 2**11 - 1, 2**29 - 1  #: Largest ids of 11 and of 29 bits

_HEADER = struct.Struct(">4sBBBxI")
_INSTANT = struct.Struct(">d")
_FRAME_KIND, _INSTANT_KIND = 1, 2
_EXTENDED, _REMOTE = 1, 2
RECORD_SIZE = _HEADER.size + MAX_PAYLOAD  #: Length of a record [bytes]


@dataclass(frozen=True)
class BusFrame:
    """A frame on the bus."""

    id: int  #: Arbitration id of 11 bits, or of 29 bits if `extended`
    data: bytes  #: Payload of 0 to 8 bytes
    extended: bool = False  #: Whether the id has 29 bits
    remote: bool = False  #: Whether this is a remote frame


@dataclass(frozen=True)
class Instant:
    """How far the sender has come."""

    time: float  #: Simulated time [s]


Record = BusFrame | Instant  #: What a record holds


def encode(record: Record) -> bytes:
    """Return the bytes of a record."""
    if isinstance(record, Instant):
        return _HEADER.pack(MAGIC, _INSTANT_KIND, 0, 0, 0) + _INSTANT.pack(record.time)
    flags = _EXTENDED * record.extended | _REMOTE * record.remote
    header = _HEADER.pack(MAGIC, _FRAME_KIND, flags, len(record.data), record.id)
    return header + record.data.ljust(MAX_PAYLOAD, b"\0")


class RecordReader:
    """Cuts a stream of bytes into records."""

    def __init__(self) -> None:
        self._buffer = b""

    def receive(self, data: bytes) -> list[Record]:
        """Return the records that are complete now.

        Raises:
            InputError: The bytes are not those of a record; nothing after them can be read.
        """
        self._buffer += data
        found = []
        while len(self._buffer) >= RECORD_SIZE:
            record, self._buffer = self._buffer[:RECORD_SIZE], self._buffer[RECORD_SIZE:]
            found.append(_decode(record))
        return found


def _decode(record: bytes) -> Record:
    """Return what a record holds; raises an InputError if it is none."""
    magic, kind, flags, length, number = _HEADER.unpack_from(record)
    if magic != MAGIC or kind not in (_FRAME_KIND, _INSTANT_KIND):
        raise InputError(f"no record of a simulated bus: {record[:8].hex()}")
    if kind == _INSTANT_KIND:
        (time,) = _INSTANT.unpack_from(record, _HEADER.size)
        if not math.isfinite(time):
            raise InputError(f"an instant of {time} s")
        return Instant(time)
    extended = bool(flags & _EXTENDED)
    if length > MAX_PAYLOAD or number > (MAX_EXTENDED_ID if extended else MAX_ID):
        raise InputError(f"no frame: id {number:#x}, {length} bytes")
    data = record[_HEADER.size : _HEADER.size + length]
    return BusFrame(number, data, extended, bool(flags & _REMOTE))
