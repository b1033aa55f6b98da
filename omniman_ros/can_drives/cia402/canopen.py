"""Frames of CANopen, CiA 301 (EN 50325-4): NMT, SYNC, heartbeat, EMCY, expedited SDO, PDO.

All data are little-endian. Section numbers are those of CiA 301 version 4.2. Texts of error codes
are from the tables of the `canopen` library.
"""

import struct
from dataclasses import dataclass
from enum import IntEnum

from canopen.emcy import EmcyError
from canopen.sdo.exceptions import SdoAbortedError

from omniman_ros.can_drives.frame import CanFrame
from omniman_ros.core.errors import InputError

# Function codes of the predefined connection set (7.3.3): COB-id = code + node.
NMT = 0x000  #: COB-id of NMT node control
SYNC = 0x080  #: COB-id of SYNC
EMCY = 0x080  #: Function code of emergency messages
HEARTBEAT = 0x700  #: Function code of heartbeats
SDO_ANSWER = 0x580  #: Function code of frames from an SDO server
SDO_REQUEST = 0x600  #: Function code of frames to an SDO server
TPDO = (0x180, 0x280, 0x380, 0x480)  #: Function codes of the PDOs that a device transmits
RPDO = (0x200, 0x300, 0x400, 0x500)  #: Function codes of the PDOs that a device receives

NODES = range(1, 128)  #: Valid node ids


class NmtCommand(IntEnum):
    """Command specifier of NMT node control (7.2.8.2.1)."""

    START = 0x01
    STOP = 0x02
    PRE_OPERATIONAL = 0x80
    RESET_NODE = 0x81
    RESET_COMMUNICATION = 0x82


class NmtState(IntEnum):
    """NMT state in a heartbeat (7.2.8.3.2.2)."""

    BOOT_UP = 0x00
    STOPPED = 0x04
    OPERATIONAL = 0x05
    PRE_OPERATIONAL = 0x7F

    def __str__(self) -> str:
        return self.name.lower().replace("_", "-")


def nmt(command: NmtCommand, node: int) -> CanFrame:
    """Return an NMT command to one node; CiA 301 7.2.8.2.1.

    Raises:
        InputError: The node is not one of 1 to 127 (0 would mean all).
    """
    return CanFrame(NMT, bytes((command, _checked_node(node))))


def sync() -> CanFrame:
    """Return a SYNC frame without a counter; CiA 301 7.2.5."""
    return CanFrame(SYNC, b"")


def heartbeat(node: int, state: NmtState) -> CanFrame:
    """Return a heartbeat of a node 1 to 127 (or raise InputError); CiA 301 7.2.8.3.2.2."""
    return CanFrame(HEARTBEAT + _checked_node(node), bytes((state,)))


def parse_heartbeat(data: bytes) -> NmtState | None:
    """Return the state in a heartbeat, or None if the data are invalid."""
    if len(data) != 1 or data[0] not in NmtState._value2member_map_:
        return None
    return NmtState(data[0])


@dataclass(frozen=True, slots=True)
class Emergency:
    """An emergency message; CiA 301 7.2.7."""

    code: int  #: Error code, as in object 603F of CiA 402; 0 if no error is left
    register: int  #: Error register (object 1001)
    vendor: bytes  #: 5 vendor-specific bytes

    def __str__(self) -> str:
        return f"EMCY {error_text(self.code)}, error register {self.register:02X}"


def parse_emergency(data: bytes) -> Emergency | None:
    """Return the message in the 8 bytes of an EMCY frame, or None if the length is another."""
    return Emergency(*struct.unpack("<HB5s", data)) if len(data) == 8 else None


def error_text(code: int) -> str:
    """Return an error code of EMCY or object 603F with the name of its class; CiA 301 table 26."""
    text = EmcyError(code, 0, b"", 0.0).get_desc()
    return f"{code:04X} ({text})" if text else f"{code:04X}"


def abort_text(code: int) -> str:
    """Return an SDO abort code with its description; CiA 301 table 22."""
    text = SdoAbortedError.CODES.get(code)
    return f"{code:08X} ({text})" if text else f"{code:08X}"


@dataclass(frozen=True, slots=True)
class Entry:
    """Integer entry of the object dictionary that fits into one expedited SDO."""

    index: int  #: Index of the object
    sub: int  #: Sub-index
    format: str  #: Format character of `struct`: b, B, h, H, i or I
    name: str  #: Name of the entry

    def __str__(self) -> str:
        return f"{self.index:04X}:{self.sub:02X} ({self.name})"

    @property
    def size(self) -> int:
        """Size [bytes]."""
        return struct.calcsize("<" + self.format)

    @property
    def mapping(self) -> int:
        """Entry of a PDO mapping, index << 16 | sub << 8 | bits; CiA 301 7.5.2.36."""
        return self.index << 16 | self.sub << 8 | 8 * self.size

    def pack(self, value: int) -> bytes:
        """Return the bytes of a value; raise InputError if it does not fit."""
        try:
            return struct.pack("<" + self.format, value)
        except struct.error as error:
            raise InputError(f"{self}: {value} does not fit: {error}") from None

    def unpack(self, data: bytes) -> int:
        """Return the value of 1 to 4 bytes; bytes beyond the size of the entry are ignored."""
        signed = self.format.islower()
        return int.from_bytes(data[: self.size], "little", signed=signed)


def download(node: int, entry: Entry, value: int) -> CanFrame:
    """Return an expedited request to write an entry; CiA 301 7.2.4.3.3.

    Raises:
        InputError: The value does not fit, or the node is not one of 1 to 127.
    """
    data = entry.pack(value)
    # ccs = 1, e = 1, s = 1, n = bytes without data
    head = struct.pack("<BHB", 0x23 | (4 - len(data)) << 2, entry.index, entry.sub)
    return CanFrame(SDO_REQUEST + _checked_node(node), head + data.ljust(4, b"\0"))


def upload(node: int, entry: Entry) -> CanFrame:
    """Return a request to read an entry of a node 1 to 127; CiA 301 7.2.4.3.6."""
    head = struct.pack("<BHB", 0x40, entry.index, entry.sub)
    return CanFrame(SDO_REQUEST + _checked_node(node), head + bytes(4))


@dataclass(frozen=True, slots=True)
class SdoAnswer:
    """Answer of an SDO server."""

    index: int  #: Index of the object
    sub: int  #: Sub-index
    data: bytes | None = None  #: Read data, 1 to 4 bytes; None if nothing was read
    abort: int = 0  #: Abort code; 0 if the request succeeded


def parse_sdo(data: bytes) -> SdoAnswer | None:
    """Return the answer to an expedited request, or None if it is none; CiA 301 7.2.4.3."""
    if len(data) != 8:
        return None
    command, index, sub = struct.unpack_from("<BHB", data)
    match command >> 5:
        case 2 if command & 0x2:  # expedited upload; with s = 0 the length is not stated
            unused = command >> 2 & 3 if command & 0x1 else 0
            return SdoAnswer(index, sub, data[4 : 8 - unused])
        case 3:
            return SdoAnswer(index, sub)
        case 4:
            # A code of 0 would mean success.
            return SdoAnswer(index, sub, abort=struct.unpack_from("<I", data, 4)[0] or 0x08000000)
    return None


def _checked_node(node: int) -> int:
    if node not in NODES:
        raise InputError(f"CANopen node {node} must be 1 to 127")
    return node
