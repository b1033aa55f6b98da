"""Frames of CANopen, CiA 301 (EN 50325-4): NMT, SYNC, heartbeat, EMCY, expedited SDO, PDO.

Little-endian throughout. Section numbers are those of CiA 301 version 4.2. Texts of error codes
are the tables of the `canopen` library.
"""

import struct
from dataclasses import dataclass
from enum import IntEnum

from canopen.emcy import EmcyError
from canopen.sdo.exceptions import SdoAbortedError

from omniman_ros.can_drive.frame import Frame
from omniman_ros.core.errors import InputError

# Function codes of the predefined connection set (7.3.3): COB-id = code + node.
NMT, SYNC, EMCY, HEARTBEAT = 0x000, 0x080, 0x080, 0x700
SDO_ANSWER, SDO_REQUEST = 0x580, 0x600
TPDO = (0x180, 0x280, 0x380, 0x480)
RPDO = (0x200, 0x300, 0x400, 0x500)

NODES = range(1, 128)


class NmtCommand(IntEnum):
    """Command specifier of NMT node control (7.2.8.2.1)."""

    START = 0x01
    STOP = 0x02
    PRE_OPERATIONAL = 0x80
    RESET_NODE = 0x81
    RESET_COMMUNICATION = 0x82


class NmtState(IntEnum):
    """What a heartbeat says (7.2.8.3.2.2)."""

    BOOT_UP = 0x00
    STOPPED = 0x04
    OPERATIONAL = 0x05
    PRE_OPERATIONAL = 0x7F

    def __str__(self) -> str:
        return self.name.lower().replace("_", "-")


def nmt(command: NmtCommand, node: int) -> Frame:
    """Command to one node; CiA 301 7.2.8.2.1.

    Raises:
        InputError: The node is not one of 1 to 127 (0 would mean all).
    """
    return Frame(NMT, bytes((command, _checked(node))))


def sync() -> Frame:
    """SYNC without a counter; CiA 301 7.2.5."""
    return Frame(SYNC, b"")


def heartbeat(node: int, state: NmtState) -> Frame:
    """Heartbeat of a node; CiA 301 7.2.8.3.2.2.

    Raises:
        InputError: The node is not one of 1 to 127.
    """
    return Frame(HEARTBEAT + _checked(node), bytes((state,)))


def parse_heartbeat(data: bytes) -> NmtState | None:
    """State in a heartbeat, or None if there is none in it."""
    if len(data) != 1 or data[0] not in NmtState._value2member_map_:
        return None
    return NmtState(data[0])


@dataclass(frozen=True, slots=True)
class Emergency:
    """An emergency message; CiA 301 7.2.7.

    Attributes:
        code: Error code (603F of CiA 402); 0: nothing is wrong any more.
        register: Error register 1001.
        vendor: 5 bytes of the vendor's.
    """

    code: int
    register: int
    vendor: bytes

    def __str__(self) -> str:
        return f"EMCY {error_text(self.code)}, error register {self.register:02X}"


def parse_emergency(data: bytes) -> Emergency | None:
    """Message in the 8 bytes of an EMCY frame, or None if there are fewer."""
    return Emergency(*struct.unpack("<HB5s", data)) if len(data) == 8 else None


def error_text(code: int) -> str:
    """Error code of EMCY and of 603F with its class in words; CiA 301 table 26."""
    text = EmcyError(code, 0, b"", 0.0).get_desc()
    return f"{code:04X} ({text})" if text else f"{code:04X}"


def abort_text(code: int) -> str:
    """Abort code of an SDO in words; CiA 301 table 22."""
    text = SdoAbortedError.CODES.get(code)
    return f"{code:08X} ({text})" if text else f"{code:08X}"


@dataclass(frozen=True, slots=True)
class Entry:
    """An entry of the object dictionary, of a kind that fits into one SDO.

    Attributes:
        index, sub: Where it is.
        format: Letter of `struct`: b, B, h, H, i or I.
        name: In words.
    """

    index: int
    sub: int
    format: str
    name: str

    def __str__(self) -> str:
        return f"{self.index:04X}:{self.sub:02X} ({self.name})"

    @property
    def size(self) -> int:
        """Bytes."""
        return struct.calcsize("<" + self.format)

    @property
    def mapping(self) -> int:
        """The entry as one of a PDO mapping, index << 16 | sub << 8 | bits; CiA 301 7.5.2.36."""
        return self.index << 16 | self.sub << 8 | 8 * self.size

    def pack(self, value: int) -> bytes:
        """Bytes of a value.

        Raises:
            InputError: It does not fit.
        """
        try:
            return struct.pack("<" + self.format, value)
        except struct.error as error:
            raise InputError(f"{self}: {value} does not fit: {error}") from None

    def unpack(self, data: bytes) -> int:
        """Value of 1 to 4 bytes, of which those beyond the entry's own are left out."""
        signed = self.format.islower()
        return int.from_bytes(data[: self.size], "little", signed=signed)


def download(node: int, entry: Entry, value: int) -> Frame:
    """Request to write an entry, expedited; CiA 301 7.2.4.3.3.

    Raises:
        InputError: The value does not fit, or the node is not one of 1 to 127.
    """
    data = entry.pack(value)
    # ccs = 1, e = 1, s = 1, n = bytes without data
    head = struct.pack("<BHB", 0x23 | (4 - len(data)) << 2, entry.index, entry.sub)
    return Frame(SDO_REQUEST + _checked(node), head + data.ljust(4, b"\0"))


def upload(node: int, entry: Entry) -> Frame:
    """Request to read an entry; CiA 301 7.2.4.3.6.

    Raises:
        InputError: The node is not one of 1 to 127.
    """
    head = struct.pack("<BHB", 0x40, entry.index, entry.sub)
    return Frame(SDO_REQUEST + _checked(node), head + bytes(4))


@dataclass(frozen=True, slots=True)
class SdoAnswer:
    """What a server answers.

    Attributes:
        index, sub: Of the entry it is about.
        data: What was read, 1 to 4 bytes; None if nothing was.
        abort: Abort code; 0 if the request was done.
    """

    index: int
    sub: int
    data: bytes | None = None
    abort: int = 0


def parse_sdo(data: bytes) -> SdoAnswer | None:
    """Answer in a frame, or None if it is none to an expedited request; CiA 301 7.2.4.3."""
    if len(data) != 8:
        return None
    command, index, sub = struct.unpack_from("<BHB", data)
    match command >> 5:
        case 2 if command & 0x2:  # upload, expedited; s = 0 leaves the length open
            unused = command >> 2 & 3 if command & 0x1 else 0
            return SdoAnswer(index, sub, data[4 : 8 - unused])
        case 3:
            return SdoAnswer(index, sub)
        case 4:
            # A code of 0 would read as "done".
            return SdoAnswer(index, sub, abort=struct.unpack_from("<I", data, 4)[0] or 0x08000000)
    return None


def _checked(node: int) -> int:
    if node not in NODES:
        raise InputError(f"CANopen node {node}: nodes are 1 to 127")
    return node
