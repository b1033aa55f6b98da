"""Objects of CiA 402 (IEC 61800-7-201) that are used, their PDOs, and the units of values."""

import math
import struct
from dataclasses import dataclass

from canopen.profiles.p402 import OperationMode

from omniman_ros.can_drives.axis import AxisSettings
from omniman_ros.can_drives.cia402.canopen import RPDO, TPDO, Entry

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

#: Low 16 bits of the device type (object 1000) of a CiA 402 drive: its profile number
PROFILE = 402


@dataclass(frozen=True, slots=True)
class PdoMapping:
    """One process data object."""

    number: int  #: Number of the PDO, 1 to 4
    transmit: bool  #: Whether the drive sends it
    entries: tuple[Entry, ...] = ()  #: Mapped entries, in the order of their bytes
    period: int = 1  #: Number of SYNCs per transmission (the transmission type)

    @property
    def name(self) -> str:
        """Name as in CiA 301, for example TPDO1."""
        return f"{'TPDO' if self.transmit else 'RPDO'}{self.number}"

    @property
    def base(self) -> int:
        """COB-id without the node id."""
        return (TPDO if self.transmit else RPDO)[self.number - 1]

    @property
    def size(self) -> int:
        """Size [bytes]."""
        return sum(entry.size for entry in self.entries)

    def pack(self, *values: int) -> bytes:
        """Return the bytes of values, one per entry."""
        return struct.pack("<" + "".join(e.format for e in self.entries), *values)

    def unpack(self, data: bytes) -> tuple[int, ...] | None:
        """Return the values, one per entry, or None if there are too few bytes.

        Bytes beyond the mapping are ignored, as CiA 301 7.2.2.5 requires for RPDOs.
        """
        if len(data) < self.size:
            return None
        return struct.unpack_from("<" + "".join(e.format for e in self.entries), data)

    @property
    def cob_id(self) -> Entry:
        """Entry with the COB-id of the PDO, whose bit 31 disables it."""
        return Entry(self._record, 1, "I", f"{self.name} COB-id")

    @property
    def transmission(self) -> Entry:
        """Entry with the transmission type of the PDO."""
        return Entry(self._record, 2, "B", f"{self.name} transmission type")

    def mapping(self, sub: int) -> Entry:
        """Return an entry of the mapping: 0 for the number of entries, 1 to 8 for the entries."""
        return Entry(self._record + 0x200, sub, "I" if sub else "B", f"{self.name} mapping")

    @property
    def _record(self) -> int:
        return (0x1800 if self.transmit else 0x1400) + self.number - 1


# In each mode one frame per tick carries controlword, mode and setpoint together.
RPDO_VELOCITY = PdoMapping(1, False, (CONTROLWORD, TARGET_VELOCITY, MODE))
"""PDO of the setpoint in velocity mode."""
#: PDO of the setpoint in torque mode
RPDO_TORQUE = PdoMapping(2, False, (CONTROLWORD, TARGET_TORQUE, MODE))
RPDO_OFFSET = PdoMapping(3, False, (TORQUE_OFFSET,))  #: PDO of the feed-forward torque
TPDO_STATUS = PdoMapping(1, True, (STATUSWORD, MODE_DISPLAY, TORQUE))  #: PDO of state and torque
TPDO_MOTION = PdoMapping(2, True, (POSITION, VELOCITY))  #: PDO of position and velocity
#: PDO of error code and supply voltage
TPDO_SUPPLY = PdoMapping(3, True, (ERROR_CODE, BUS_VOLTAGE), period=10)
#: PDO in place of TPDO_SUPPLY for a drive that does not report its supply voltage
TPDO_ERROR = PdoMapping(3, True, (ERROR_CODE,), period=10)


def mode_text(code: int) -> str:
    """Return the number of a mode of operation, with its name if it has one."""
    name = OperationMode.CODE2NAME.get(code)
    return f"{code} ({name.lower()})" if name else str(code)


class Units:
    """Converts between a drive's integers and quantities at the motor's shaft.

    Args:
        rated_torque: Rated torque of the motor [N m]; the drive's torques are thousandths of it.
    """

    def __init__(self, settings: AxisSettings, rated_torque: float) -> None:
        self._settings, self._rated_torque = settings, rated_torque

    def position(self, count: int) -> float:
        """Return the angle of an unwrapped count [rad]."""
        return count * math.tau / self._settings.counts

    def velocity(self, units: int) -> float:
        """Return the speed of a velocity actual value (object 606C) [rad/s]."""
        return units / self._settings.velocity_scale * math.tau

    def torque(self, thousandths: int) -> float:
        """Return the torque of a torque actual value (object 6077) [N m]."""
        return 1e-3 * thousandths * self._rated_torque

    def from_velocity(self, velocity: float) -> int:
        """Return the target velocity (object 60FF) of a speed [rad/s].

        It is clipped to the largest speed and to 32 bits.
        """
        velocity = _clip(velocity, self._settings.max_speed)
        return round(_clip(velocity / math.tau * self._settings.velocity_scale, 0x7FFF_FFFF))

    def from_torque(self, torque: float) -> int:
        """Return the target torque or torque offset (objects 6071, 60B2) of a torque [N m].

        It is clipped to the largest torque and to 16 bits.
        """
        torque = _clip(torque, self._settings.max_torque)
        return round(_clip(1e3 * torque / self._rated_torque, 0x7FFF))


def _clip(value: float, bound: float) -> float:
    return max(-bound, min(bound, value))
