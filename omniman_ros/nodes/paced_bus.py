"""The bridge's end of a simulated bus in simulated time."""

import math
import socket
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator

from omniman_ros.can_drives.bus import CLOSED, Bus, BusError, CanBus
from omniman_ros.can_drives.frame import CanFrame
from omniman_ros.can_drives.link import OpenBus
from omniman_ros.core.errors import InputError
from omniman_ros.simulation.can_link.records import (
    BusFrame,
    Instant,
    Record,
    RecordReader,
    encode,
)
from omniman_ros.simulation.link_connection import LOOPBACK, LinkConnection, SimulationLinkError

CONNECT_TIMEOUT = 0.5  #: Longest time for connecting [s]
MAX_WAIT = 0.002  #: Longest real time between two reads of the connection [s]
#: Longest real time to wait for the drives [s]; the bridge then goes on without them
DRIVES_TIMEOUT = 1.0
TOLERANCE = 1e-6  #: Difference up to which two instants count as the same [s]


def bus_opener(port: int, clock: Callable[[], float], poll: Callable[[], None]) -> OpenBus:
    """Return a function that opens the bus of an installation, or of a port above 0."""
    return (lambda parameters, wake: PacedBus(port, clock, poll)) if port else CanBus


class PacedBus(Bus):
    """A bus over TCP, whose simulated drives wait for the bridge.

    Drives and bridge take turns; each sends one stream of records. At each step of simulated time,
    the drives send their frames, and then the instant. Once the bridge's own time has reached that
    instant, it reads these frames, sends its own, reads the answers, and sends the instant to
    report that it is done. Until then the drives wait. No frame is late, however long a process
    waits for a core, and an answer takes no simulated time.

    Raises:
        BusError: There are no drives at the port.
    """

    def __init__(self, port: int, clock: Callable[[], float], poll: Callable[[], None]) -> None:
        try:
            connected = socket.create_connection((LOOPBACK, port), CONNECT_TIMEOUT)
        except OSError as error:
            raise BusError(f"no simulated drives at port {port}: {error}") from error
        self._connection, self._reader = LinkConnection(connected), RecordReader()
        self._clock, self._poll = clock, poll
        self._frames: deque[tuple[CanFrame, float]] = deque()
        self._last_time = -math.inf
        self._is_answered = True
        self._failure = ""
        self.invalid = 0

    def _receive(self) -> None:
        """Read what has arrived; each frame gets the instant before it."""
        try:
            records = self._reader.receive(self._connection.receive())
        except (SimulationLinkError, InputError) as error:
            self._failure = f"lost: {error}"
            return
        for record in records:
            if isinstance(record, Instant):
                self._last_time, self._is_answered = record.time, True
            else:
                frame = CanFrame(record.id, record.data, record.extended, record.remote)
                self._frames.append((frame, self._last_time))

    def _catch_up(self) -> None:
        """Wait for the frames that the drives send up to the present, and for their answers."""
        deadline = time.monotonic() + DRIVES_TIMEOUT
        self._receive()
        while not self._failure and time.monotonic() < deadline:
            if self._is_answered and self._last_time >= self._clock() - TOLERANCE:
                return
            self._connection.wait(MAX_WAIT)
            self._receive()

    def take(self) -> Iterator[CanFrame | str]:
        """Yield the frames up to the present and then, if the bus has failed, the reason."""
        if self._failure:
            return
        self._catch_up()
        now = self._clock() + TOLERANCE
        while self._frames and self._frames[0][1] <= now:
            yield self._frames.popleft()[0]
        if self._failure:
            yield self._failure

    def wait(self, timeout: float) -> None:
        """Receive simulated time, and wait for up to `MAX_WAIT` if `timeout` [s] is positive."""
        self._poll()
        if timeout > 0.0 and not self._failure:
            self._connection.wait(MAX_WAIT)

    def send(self, frames: Iterable[CanFrame]) -> str:
        """Send all frames, or an empty step's end; return why the bus has failed, or ""."""
        if self._failure:
            return self._failure
        records: list[Record] = [BusFrame(f.id, f.data, f.extended, f.remote) for f in frames]
        self._is_answered = self._is_answered and not records
        done = min(self._clock(), self._last_time)
        if not records and math.isfinite(done):
            records.append(Instant(done))
        try:
            self._connection.send(b"".join(map(encode, records)))
        except SimulationLinkError as error:
            self._failure = f"lost: {error}"
        return self._failure

    @property
    def failure(self) -> str:
        """Why the bus has failed, or an empty string."""
        return self._failure

    def close(self) -> None:
        """Close the connection."""
        self._failure = CLOSED
        self._connection.close()
