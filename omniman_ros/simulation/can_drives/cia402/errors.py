"""Errors of a simulated CANopen drive: emergency messages, error register and history."""

from canopen.emcy import EmcyProducer

from omniman_ros.simulation.can_drives.cia402 import indices
from omniman_ros.simulation.can_drives.cia402.objects import HISTORY, Key, Value

OVER_CURRENT = 0x2310  #: Error code: over-current
UNDER_VOLTAGE = 0x3220  #: Error code: under-voltage
SENSOR = 0x7305  #: Error code: encoder
COMMUNICATION = 0x8100  #: Error code: communication
HEARTBEAT = 0x8130  #: Error code: missing heartbeat
PDO_SHORT = 0x8210  #: Error code: PDO too short
PDO_LONG = 0x8220  #: Error code: PDO too long

GENERIC = 0x01  #: Bit of the error register for any error
REGISTER = (
    (0xF000, 0x2000, 0x02),
    (0xF000, 0x3000, 0x04),
    (0xF000, 0x4000, 0x08),
    (0xF000, 0x8000, 0x10),
    (0xF000, 0x7000, 0x20),
)  #: Mask and value of error codes, and their bit of the error register (CiA 301, 7.5.2.2)


class Errors:
    """Active errors of a drive: each is reported once, and so is the end of the last one."""

    def __init__(self, values: dict[Key, Value], producer: EmcyProducer) -> None:
        self._values, self._producer = values, producer
        self._pending: list[tuple[int, int]] = []
        self.active: set[int] = set()  #: Codes of the active errors

    def restart(self) -> None:
        """Forget all errors."""
        self.active.clear()
        self._pending.clear()

    def add(self, code: int) -> None:
        """Add an error unless it is active already."""
        if code in self.active:
            return
        self.active.add(code)
        count = int(self._values[indices.ERROR_HISTORY, 0])
        for sub in range(min(count + 1, HISTORY), 1, -1):
            self._values[indices.ERROR_HISTORY, sub] = self._values[indices.ERROR_HISTORY, sub - 1]
        self._values[indices.ERROR_HISTORY, 1] = code
        self._values[indices.ERROR_HISTORY, 0] = min(count + 1, HISTORY)
        self._report(code)

    def remove(self, code: int) -> None:
        """Remove an error if it is active."""
        if code in self.active:
            self.active.discard(code)
            self._report(0)

    def _report(self, code: int) -> None:
        register = GENERIC if self.active else 0
        for active in self.active:
            for mask, value, bit in REGISTER:
                register |= bit if active & mask == value else 0
        self._values[indices.ERROR_REGISTER, 0] = register
        if code or not self.active:
            self._pending.append((code, register))

    def send(self) -> None:
        """Send the pending emergency messages; not to be called while the node is stopped."""
        for code, register in self._pending:
            self._producer.send(code, register)
        self._pending.clear()
