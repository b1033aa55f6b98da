"""Errors of a simulated CANopen drive: emergency messages, register and history."""

from canopen.emcy import EmcyProducer

from omniman_ros.drive.can.cia402_objects import HISTORY, Key, Value

OVER_CURRENT = 0x2310
UNDER_VOLTAGE = 0x3220
SENSOR = 0x7305
COMMUNICATION = 0x8100
HEARTBEAT = 0x8130
PDO_SHORT = 0x8210
PDO_LONG = 0x8220

GENERIC = 0x01
REGISTER = ((0xF000, 0x2000, 0x02), (0xF000, 0x3000, 0x04), (0xF000, 0x4000, 0x08),
            (0xF000, 0x8000, 0x10), (0xF000, 0x7000, 0x20))  # fmt: skip
"""Mask and value of an error code to the bit of the error register (CiA 301, 7.5.2.2)."""


class Errors:
    """Which errors there are now. Each one is told once, and the end of all of them.

    Args:
        values: Values of all objects.
        producer: Sends emergency messages (CiA 301, 7.2.7).

    Attributes:
        active: Error codes.
    """

    def __init__(self, values: dict[Key, Value], producer: EmcyProducer) -> None:
        self._values, self._producer = values, producer
        self._untold: list[tuple[int, int]] = []
        self.active: set[int] = set()

    def restart(self) -> None:
        """Know of none."""
        self.active.clear()
        self._untold.clear()

    def add(self, code: int) -> None:
        """An error is there."""
        if code in self.active:
            return
        self.active.add(code)
        count = int(self._values[0x1003, 0])
        for sub in range(min(count + 1, HISTORY), 1, -1):
            self._values[0x1003, sub] = self._values[0x1003, sub - 1]
        self._values[0x1003, 1] = code
        self._values[0x1003, 0] = min(count + 1, HISTORY)
        self._tell(code)

    def remove(self, code: int) -> None:
        """An error has gone."""
        if code in self.active:
            self.active.discard(code)
            self._tell(0)

    def _tell(self, code: int) -> None:
        register = GENERIC if self.active else 0
        for active in self.active:
            for mask, value, bit in REGISTER:
                register |= bit if active & mask == value else 0
        self._values[0x1001, 0] = register
        if code or not self.active:
            self._untold.append((code, register))

    def send(self) -> None:
        """Send what is untold: not while the node is stopped."""
        for code, register in self._untold:
            self._producer.send(code, register)
        self._untold.clear()
