"""PDOs of a simulated CANopen drive: configuration and packing (CiA 301, 7.2.2, 7.5.2)."""

from canopen import SdoAbortedError
from canopen import objectdictionary as od

from omniman_ros.simulation.can_drives.cia402.objects import (
    ALL,
    DUMMIES,
    ENTRIES,
    PDOS,
    Key,
    Value,
)

INVALID = 1 << 31  #: Bit of a COB-ID: the PDO is disabled
NO_RTR = 1 << 30  #: Bit of a TPDO's COB-ID: no remote requests
EXTENDED = 1 << 29  #: Bit of a COB-ID: the id has 29 bits
ID_BITS = 0x1FFF_FFFF  #: Mask of the id in a COB-ID

# Abort codes (CiA 301, table 22)
UNSUPPORTED = 0x0601_0000  #: Abort code: unsupported access
NO_OBJECT = 0x0602_0000  #: Abort code: no such object
NOT_MAPPABLE = 0x0604_0041  #: Abort code: the object cannot be mapped
TOO_LONG = 0x0604_0042  #: Abort code: too many or too long objects in a PDO
NO_SUBINDEX = 0x0609_0011  #: Abort code: no such sub-index
INVALID_VALUE = 0x0609_0030  #: Abort code: invalid value

SYNCHRONOUS = range(0, 241)  #: Transmission types of PDOs that are sent or applied at a SYNC
EVENT = (254, 255)  #: Transmission types of event-driven PDOs
RESTRICTED = (
    range(0x000, 0x080),
    range(0x101, 0x181),
    range(0x581, 0x600),
    range(0x601, 0x680),
    range(0x6E0, 0x780),
    range(0x780, 0x800),
)  #: CAN ids that no PDO may use (CiA 301, 7.3.5)

DEFAULTS: dict[int, tuple[bool, tuple[int, ...]]] = {
    0x1400: (True, (0x6040_0010,)),
    0x1401: (True, (0x6040_0010, 0x6060_0008)),
    0x1402: (False, ()),
    0x1403: (True, (0x6040_0010, 0x60FF_0020)),
    0x1800: (True, (0x6041_0010,)),
    0x1801: (True, (0x6041_0010, 0x6061_0008)),
    0x1802: (False, (0x6041_0010, 0x6064_0020)),
    0x1803: (False, (0x6041_0010, 0x606C_0020)),
}  #: Whether each PDO is enabled after a start, and its mapping (CiA 402-2, generic PDOs)


class Pdo:
    """One PDO: its records in the object dictionary, and its pending data."""

    def __init__(
        self,
        number: int,
        transmit: bool,
        node: int,
        values: dict[Key, Value],
        variables: dict[Key, od.ODVariable],
    ) -> None:
        self.transmit = transmit  #: Whether the drive sends it
        self.parameters = (0x1800 if transmit else 0x1400) + number
        self.mapping = self.parameters + 0x200
        self._default_id = (0x180 if transmit else 0x200) + 0x100 * number + node
        self._values, self._variables = values, variables
        self.restore()

    def restore(self) -> None:
        """Set the records to their values after a start."""
        enabled, entries = DEFAULTS[self.parameters]
        flags = (NO_RTR if self.transmit else 0) | (0 if enabled else INVALID)
        self._values[self.parameters, 1] = self._default_id | flags
        self._values[self.parameters, 2] = 255
        for sub in range(1, ENTRIES + 1):
            self._values[self.mapping, sub] = entries[sub - 1] if sub <= len(entries) else 0
        self._values[self.mapping, 0] = len(entries)
        self.refresh()

    def refresh(self) -> None:
        """Apply the records after a write."""
        cob = self._number(self.parameters, 1)
        self.enabled, self.id = not cob & INVALID, cob & ID_BITS
        self.transmission = self._number(self.parameters, 2)
        self.inhibit = 1e-4 * self._number(self.parameters, 3) if self.transmit else 0.0
        self.event_timer = 1e-3 * self._number(self.parameters, 5) if self.transmit else 0.0
        entries = [
            self._number(self.mapping, sub) for sub in range(1, self._number(self.mapping, 0) + 1)
        ]
        self.fields = [((e >> 16, e >> 8 & 0xFF), (e & 0xFF) // 8) for e in entries]
        self.length = sum(size for _, size in self.fields)
        self.begin()

    def begin(self) -> None:
        """Discard pending data, because the node became operational or the PDO was changed."""
        self.received: bytes | None = None  #: Received data that wait for the next SYNC
        self.syncs = 0  #: Number of SYNCs since the PDO was last sent
        self.sent: bytes | None = None  #: Data that were last sent
        self.sent_at = -1e9  #: Time at which the PDO was last sent [s]

    def carries(self, *indices: int) -> bool:
        """Return whether at least one of the objects with these indices is mapped."""
        return any(key[0] in indices for key, _ in self.fields)

    def _number(self, index: int, sub: int) -> int:
        return int(self._values.get((index, sub), 0))

    def pack(self) -> bytes:
        """Return the values of the mapped objects."""
        return b"".join(
            self._variables[key].encode_raw(self._values[key]) for key, _ in self.fields
        )

    def unpack(self, data: bytes) -> list[tuple[Key, int]]:
        """Return the objects and values in data; bytes beyond the mapping are ignored."""
        result, start = [], 0
        for key, size in self.fields:
            if key[0] not in DUMMIES:
                value = self._variables[key].decode_raw(data[start : start + size])
                result.append((key, int(value)))
            start += size
        return result

    def check(self, key: Key, value: int) -> None:
        """Check that a value may be written now, or raise an SdoAbortedError (CiA 301)."""
        index, sub = key
        if index == self.mapping:
            self._check_mapping(sub, value)
        elif sub == 1:
            self._check_id(value)
        elif sub == 2:
            if value not in SYNCHRONOUS and value not in EVENT:
                raise SdoAbortedError(INVALID_VALUE)
        elif sub == 3 and self.enabled:
            raise SdoAbortedError(INVALID_VALUE)

    def _check_id(self, value: int) -> None:
        number = value & ID_BITS
        if value & EXTENDED or number > 0x7FF:
            raise SdoAbortedError(INVALID_VALUE)
        if not value & INVALID and any(number in ids for ids in RESTRICTED):
            raise SdoAbortedError(INVALID_VALUE)
        if self.enabled and not value & INVALID and number != self.id:
            raise SdoAbortedError(INVALID_VALUE)

    def _check_mapping(self, sub: int, value: int) -> None:
        """Check a mapping: the PDO must be disabled, and entries need a number of entries of 0."""
        if self.enabled or (sub and self._number(self.mapping, 0)):
            raise SdoAbortedError(UNSUPPORTED)
        if sub:
            if value:
                self._check_entry(value)
            return
        if value > ENTRIES:
            raise SdoAbortedError(TOO_LONG)
        entries = [self._number(self.mapping, k) for k in range(1, value + 1)]
        for entry in entries:
            self._check_entry(entry)
        if sum(entry & 0xFF for entry in entries) > 64:
            raise SdoAbortedError(TOO_LONG)

    def _check_entry(self, entry: int) -> None:
        index, sub, bits = entry >> 16, entry >> 8 & 0xFF, entry & 0xFF
        if index in DUMMIES and not sub:
            if self.transmit or bits != DUMMIES[index]:
                raise SdoAbortedError(NOT_MAPPABLE)
            return
        if (index, sub) not in ALL:
            has_index = any(key[0] == index for key in ALL)
            raise SdoAbortedError(NO_SUBINDEX if has_index else NO_OBJECT)
        mapping = ALL[index, sub].mapping
        if not (mapping.transmit if self.transmit else mapping.receive):
            raise SdoAbortedError(NOT_MAPPABLE)
        if bits != len(self._variables[index, sub]):
            raise SdoAbortedError(NOT_MAPPABLE)


def all_pdos(
    node: int, values: dict[Key, Value], variables: dict[Key, od.ODVariable]
) -> tuple[tuple[Pdo, ...], tuple[Pdo, ...]]:
    """Return the PDOs that a drive receives, and those that it transmits."""
    received, transmitted = (
        tuple(Pdo(number, transmit, node, values, variables) for number in range(PDOS))
        for transmit in (False, True)
    )
    return received, transmitted
