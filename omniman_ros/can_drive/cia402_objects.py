"""Entries of CiA 402 (IEC 61800-7-201) that are used, and which PDO carries which of them."""

import struct
from dataclasses import dataclass

from canopen.profiles.p402 import OperationMode

from omniman_ros.can_drive.canopen import RPDO, TPDO, Entry

DEVICE_TYPE = Entry(0x1000, 0, "I", "device type")
CONSUMER_HEARTBEAT = Entry(0x1016, 1, "I", "consumer heartbeat time")
PRODUCER_HEARTBEAT = Entry(0x1017, 0, "H", "producer heartbeat time")
ERROR_BEHAVIOUR = Entry(0x1029, 1, "B", "error behaviour: communication")
ABORT_OPTION = Entry(0x6007, 0, "h", "abort connection option code")
ERROR_CODE = Entry(0x603F, 0, "H", "error code")
CONTROLWORD = Entry(0x6040, 0, "H", "controlword")
STATUSWORD = Entry(0x6041, 0, "H", "statusword")
QUICK_STOP_OPTION = Entry(0x605A, 0, "h", "quick stop option code")
FAULT_REACTION_OPTION = Entry(0x605E, 0, "h", "fault reaction option code")
MODE = Entry(0x6060, 0, "b", "modes of operation")
MODE_DISPLAY = Entry(0x6061, 0, "b", "modes of operation display")
POSITION = Entry(0x6064, 0, "i", "position actual value")
VELOCITY = Entry(0x606C, 0, "i", "velocity actual value")
TARGET_TORQUE = Entry(0x6071, 0, "h", "target torque")
RATED_TORQUE = Entry(0x6076, 0, "I", "motor rated torque")
TORQUE = Entry(0x6077, 0, "h", "torque actual value")
BUS_VOLTAGE = Entry(0x6079, 0, "I", "DC link circuit voltage")
QUICK_STOP_DECELERATION = Entry(0x6085, 0, "I", "quick stop deceleration")
TORQUE_OFFSET = Entry(0x60B2, 0, "h", "torque offset")
CYCLE = Entry(0x60C2, 1, "B", "interpolation time period value")
CYCLE_EXPONENT = Entry(0x60C2, 2, "b", "interpolation time index")
VELOCITY_OFFSET = Entry(0x60B1, 0, "i", "velocity offset")
TARGET_VELOCITY = Entry(0x60FF, 0, "i", "target velocity")
SUPPORTED_MODES = Entry(0x6502, 0, "I", "supported drive modes")

PROFILE = 402
"""Low 16 bits of 1000 of a drive."""


@dataclass(frozen=True, slots=True)
class Pdo:
    """One process data object.

    Attributes:
        number: 1 to 4.
        transmit: Whether the drive sends it.
        entries: What is in it, in their order.
        period: In SYNCs (its transmission type).
    """

    number: int
    transmit: bool
    entries: tuple[Entry, ...] = ()
    period: int = 1

    @property
    def name(self) -> str:
        """As in CiA 301."""
        return f"{'TPDO' if self.transmit else 'RPDO'}{self.number}"

    @property
    def base(self) -> int:
        """COB-id without the node."""
        return (TPDO if self.transmit else RPDO)[self.number - 1]

    @property
    def size(self) -> int:
        """Bytes."""
        return sum(entry.size for entry in self.entries)

    def pack(self, *values: int) -> bytes:
        """Bytes of values, one an entry."""
        return struct.pack("<" + "".join(e.format for e in self.entries), *values)

    def unpack(self, data: bytes) -> tuple[int, ...] | None:
        """Values, one an entry; None if there are fewer bytes.

        More bytes than are mapped are left out, as CiA 301 7.2.2.5 has it of RPDOs.
        """
        if len(data) < self.size:
            return None
        return struct.unpack_from("<" + "".join(e.format for e in self.entries), data)

    @property
    def cob_id(self) -> Entry:
        """Entry of its COB-id; bit 31: it is not used."""
        return Entry(self._record, 1, "I", f"{self.name} COB-id")

    @property
    def transmission(self) -> Entry:
        """Entry of its transmission type."""
        return Entry(self._record, 2, "B", f"{self.name} transmission type")

    def mapping(self, sub: int) -> Entry:
        """Entry of its mapping: 0 the number of entries, 1 to 8 what they are."""
        return Entry(self._record + 0x200, sub, "I" if sub else "B", f"{self.name} mapping")

    @property
    def _record(self) -> int:
        return (0x1800 if self.transmit else 0x1400) + self.number - 1


# One frame a tick carries controlword, mode and setpoint together, whichever the mode.
RPDO_VELOCITY = Pdo(1, False, (CONTROLWORD, TARGET_VELOCITY, MODE))
RPDO_TORQUE = Pdo(2, False, (CONTROLWORD, TARGET_TORQUE, MODE))
RPDO_OFFSET = Pdo(3, False, (TORQUE_OFFSET,))
TPDO_STATUS = Pdo(1, True, (STATUSWORD, MODE_DISPLAY, TORQUE))
TPDO_MOTION = Pdo(2, True, (POSITION, VELOCITY))
TPDO_SUPPLY = Pdo(3, True, (ERROR_CODE, BUS_VOLTAGE), period=10)
TPDO_ERROR = Pdo(3, True, (ERROR_CODE,), period=10)
"""In the place of TPDO_SUPPLY with a drive that does not tell its voltage."""


def mode_text(code: int) -> str:
    """Number of a mode of operation with its name."""
    name = OperationMode.CODE2NAME.get(code)
    return f"{code} ({name.lower()})" if name else str(code)
