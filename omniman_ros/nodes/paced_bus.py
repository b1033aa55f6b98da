"""The bridge's end of a simulated bus in simulated time."""

import math
import socket
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator

from omniman_ros.can_drives.bus import CLOSED, Bus, BusError, CanBus
from omniman_ros.can_drives.frame import Frame
from omniman_ros.can_drives.link import OpenBus
from omniman_ros.core.errors import InputError
from omniman_ros.simulation.can_link.records import (
    BusFrame,
    Instant,
    Record,
    RecordReader,
    encode,
)
from omniman_ros.simulation.link_connection import LOOPBACK, LinkConnection, LinkError

CONNECT_TIMEOUT = 0.5
"""Longest time for connecting [s]."""
MAX_WAIT = 0.002
"""Longest real time between two looks at what has arrived [s]."""
PATIENCE = 1.0
"""Real time for which the drives are waited for [s]; who is stopped is found by its silence."""
TOLERANCE = 1e-6
"""Difference of two instants that are the same [s]."""


def bus_opener(port: int, clock: Callable[[], float], poll: Callable[[], None]) -> OpenBus:
    """Return what opens the bus of an installation, or the simulated one at a port.

    Args:
        port: TCP port of simulated drives on this machine; 0 for the installation's bus.
        clock: Returns simulated time [s].
        poll: Takes the simulated time that has arrived.
    """
    return (lambda parameters, wake: PacedBus(port, clock, poll)) if port else CanBus


class PacedBus(Bus):
    """A bus whose drives wait for the bridge, over TCP.

    Drives and bridge take turns, in one stream each way. At each step of simulated time the drives
    send their frames and the instant. The bridge takes them when its own time has come there,
    sends its frames, takes the answers, and tells that it is done, for which the drives wait. So
    no frame is late, however long a process has to wait, and an answer takes no time.

    Args:
        port: TCP port of the drives on this machine.
        clock: Returns simulated time [s].
        poll: Takes the simulated time that has arrived, as the bridge waits.

    Attributes:
        garbage: Number of received items that were not frames; always 0.

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
        self._frames: deque[tuple[Frame, float]] = deque()
        self._heard = -math.inf
        self._is_answered = True
        self._failure = ""
        self.garbage = 0

    def _receive(self) -> None:
        """Read what has arrived; each frame gets the instant before it."""
        try:
            records = self._reader.receive(self._connection.receive())
        except (LinkError, InputError) as error:
            self._failure = f"lost: {error}"
            return
        for record in records:
            if isinstance(record, Instant):
                self._heard, self._is_answered = record.time, True
            else:
                frame = Frame(record.id, record.data, record.extended, record.remote)
                self._frames.append((frame, self._heard))

    def _catch_up(self) -> None:
        """Wait for what the drives send up to the present, and for their answers."""
        deadline = time.monotonic() + PATIENCE
        self._receive()
        while not self._failure and time.monotonic() < deadline:
            if self._is_answered and self._heard >= self._clock() - TOLERANCE:
                return
            self._connection.wait(MAX_WAIT)
            self._receive()

    def take(self) -> Iterator[Frame | str]:
        """Yield the frames up to the present, and at last why the bus has failed, if it has."""
        if self._failure:
            return
        self._catch_up()
        now = self._clock() + TOLERANCE
        while self._frames and self._frames[0][1] <= now:
            yield self._frames.popleft()[0]
        if self._failure:
            yield self._failure

    def wait(self, timeout: float) -> None:
        """Let simulated time pass, as soon as it does; `timeout` [s] is not waited for."""
        self._poll()
        if timeout > 0.0 and not self._failure:
            self._connection.wait(MAX_WAIT)

    def send(self, frames: Iterable[Frame]) -> str:
        """Send all frames or, where there are none, that the bridge is done with the present.

        Args:
            frames: The frames.

        Returns:
            Why the bus has failed, or an empty string.
        """
        if self._failure:
            return self._failure
        records: list[Record] = [BusFrame(f.id, f.data, f.extended, f.remote) for f in frames]
        self._is_answered = self._is_answered and not records
        done = min(self._clock(), self._heard)
        if not records and math.isfinite(done):
            records.append(Instant(done))
        try:
            self._connection.send(b"".join(map(encode, records)))
        except LinkError as error:
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
