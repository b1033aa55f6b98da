"""Object dictionary of a simulated CiA 402 drive."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

from canopen import objectdictionary as od

PDOS = 4  #: Number of PDOs in each direction
ENTRIES = 8  #: Largest number of objects in a PDO
HISTORY = 8  #: Number of errors in the history (object 1003)

# Data types of objects.
U8, U16, U32 = od.UNSIGNED8, od.UNSIGNED16, od.UNSIGNED32
I8, I16, I32 = od.INTEGER8, od.INTEGER16, od.INTEGER32
TEXT = od.VISIBLE_STRING

Key = tuple[int, int]  #: Index and sub-index of an object
Value = int | str  #: Value of an object


class Mapping(NamedTuple):
    """Whether an object can be mapped into received and into transmitted PDOs."""

    receive: bool = False
    transmit: bool = False


# Mappings into no PDO, into PDOs of both directions, and into transmitted PDOs only.
NONE, IN, OUT = Mapping(), Mapping(receive=True, transmit=True), Mapping(transmit=True)


@dataclass(frozen=True)
class Object:
    """One object of the dictionary (CiA 301, 7.5 and CiA 402-2)."""

    index: int  #: Index in the dictionary
    sub: int | None  #: Sub-index; None for a plain variable
    name: str  #: Name of the object
    kind: int  #: Data type of the value
    access: str  #: Access of SDO clients: rw, ro or const
    default: Value = 0  #: Value after a start
    mapping: Mapping = NONE  #: PDOs into which the object can be mapped
    allowed: tuple[int, ...] = ()  #: Values that may be written; if empty, all that fit


OBJECTS = (
    Object(0x1000, None, "Device type", U32, "const", 0x0002_0192),  # servo drive, CiA 402
    Object(0x1001, None, "Error register", U8, "ro", 0, OUT),
    Object(0x1003, 0, "Number of errors", U8, "rw", 0, NONE, (0,)),
    *(Object(0x1003, k, f"Error {k}", U32, "ro") for k in range(1, HISTORY + 1)),
    Object(0x1005, None, "COB-ID SYNC", U32, "rw", 0x80),
    Object(0x1008, None, "Device name", TEXT, "const", "simulated drive"),
    Object(0x1014, None, "COB-ID EMCY", U32, "ro", 0x80),
    Object(0x1016, 0, "Number of consumed heartbeats", U8, "const", 1),
    Object(0x1016, 1, "Consumer heartbeat time", U32, "rw"),
    Object(0x1017, None, "Producer heartbeat time", U16, "rw"),
    Object(0x1018, 0, "Number of identities", U8, "const", 4),
    Object(0x1018, 1, "Vendor", U32, "const"),
    Object(0x1018, 2, "Product", U32, "const", 0x402),
    Object(0x1018, 3, "Revision", U32, "const", 0x1_0000),
    Object(0x1018, 4, "Serial number", U32, "const"),
    Object(0x1029, 0, "Number of error classes", U8, "const", 1),
    Object(0x1029, 1, "On communication error", U8, "rw", 0, NONE, (0, 1, 2)),
    Object(0x6007, None, "Abort connection option", I16, "rw", 1, NONE, (0, 1, 2, 3)),
    Object(0x603F, None, "Error code", U16, "ro", 0, OUT),
    Object(0x6040, None, "Controlword", U16, "rw", 0, IN),
    Object(0x6041, None, "Statusword", U16, "ro", 0, OUT),
    Object(0x605A, None, "Quick stop option", I16, "rw", 2, NONE, (0, 1, 2, 5, 6)),
    Object(0x605B, None, "Shutdown option", I16, "rw", 0, NONE, (0, 1)),
    Object(0x605C, None, "Disable operation option", I16, "rw", 1, NONE, (0, 1)),
    Object(0x605E, None, "Fault reaction option", I16, "rw", 2, NONE, (0, 1, 2)),
    Object(0x6060, None, "Modes of operation", I8, "rw", 0, IN),
    Object(0x6061, None, "Modes of operation display", I8, "ro", 0, OUT),
    Object(0x6064, None, "Position actual value", I32, "ro", 0, OUT),
    Object(0x606C, None, "Velocity actual value", I32, "ro", 0, OUT),
    Object(0x6071, None, "Target torque", I16, "rw", 0, IN),
    Object(0x6072, None, "Max torque", U16, "rw", 0xFFFF, IN),
    Object(0x6075, None, "Motor rated current", U32, "rw"),
    Object(0x6076, None, "Motor rated torque", U32, "rw"),
    Object(0x6077, None, "Torque actual value", I16, "ro", 0, OUT),
    Object(0x6078, None, "Current actual value", I16, "ro", 0, OUT),
    Object(0x6079, None, "DC link circuit voltage", U32, "ro", 0, OUT),
    Object(0x6083, None, "Profile acceleration", U32, "rw", 0, IN),
    Object(0x6084, None, "Profile deceleration", U32, "rw", 0, IN),
    Object(0x6085, None, "Quick stop deceleration", U32, "rw", 0, IN),
    Object(0x6087, None, "Torque slope", U32, "rw", 0xFFFF_FFFF, IN),
    Object(0x608F, 0, "Number of encoder data", U8, "const", 2),
    Object(0x608F, 1, "Encoder increments", U32, "const"),
    Object(0x608F, 2, "Motor revolutions", U32, "const", 1),
    Object(0x60B1, None, "Velocity offset", I32, "rw", 0, IN),
    Object(0x60B2, None, "Torque offset", I16, "rw", 0, IN),
    Object(0x60C2, 0, "Number of interpolation times", U8, "const", 2),
    Object(0x60C2, 1, "Interpolation time", U8, "rw", 1),
    Object(0x60C2, 2, "Interpolation time index", I8, "rw", -3),
    Object(0x60FF, None, "Target velocity", I32, "rw", 0, IN),
    Object(0x6502, None, "Supported drive modes", U32, "ro"),
)

#: Length of the data types that stand for unused bits in received PDOs, by their index [bit]
DUMMIES = {0x0002: 8, 0x0003: 16, 0x0004: 32, 0x0005: 8, 0x0006: 16, 0x0007: 32}


def _pdo_objects() -> Iterator[Object]:
    """Yield the records of the PDOs (CiA 301, 7.5.2.35 to 38)."""
    for k in range(PDOS):
        yield Object(0x1400 + k, 0, f"RPDO{k + 1} highest", U8, "const", 2)
        yield Object(0x1400 + k, 1, f"RPDO{k + 1} COB-ID", U32, "rw")
        yield Object(0x1400 + k, 2, f"RPDO{k + 1} transmission type", U8, "rw", 255)
        yield Object(0x1800 + k, 0, f"TPDO{k + 1} highest", U8, "const", 5)
        yield Object(0x1800 + k, 1, f"TPDO{k + 1} COB-ID", U32, "rw")
        yield Object(0x1800 + k, 2, f"TPDO{k + 1} transmission type", U8, "rw", 255)
        yield Object(0x1800 + k, 3, f"TPDO{k + 1} inhibit time", U16, "rw")
        yield Object(0x1800 + k, 5, f"TPDO{k + 1} event timer", U16, "rw")
        for index, name in ((0x1600 + k, f"RPDO{k + 1}"), (0x1A00 + k, f"TPDO{k + 1}")):
            yield Object(index, 0, f"{name} number mapped", U8, "rw")
            for sub in range(1, ENTRIES + 1):
                yield Object(index, sub, f"{name} entry {sub}", U32, "rw")


#: All objects by index and sub-index
ALL = {(entry.index, entry.sub or 0): entry for entry in (*OBJECTS, *_pdo_objects())}


def dictionary() -> od.ObjectDictionary:
    """Build the object dictionary for the `canopen` library."""
    result = od.ObjectDictionary()
    records: dict[int, od.ODRecord] = {}
    for (index, sub), entry in ALL.items():
        variable = od.ODVariable(entry.name, index, sub)
        variable.data_type, variable.access_type = entry.kind, entry.access
        if entry.sub is None:
            result.add_object(variable)
            continue
        if index not in records:
            records[index] = od.ODRecord(f"Record {index:04X}", index)
            result.add_object(records[index])
        records[index].add_member(variable)
    return result
