"""The connection for real-time data: made, watched, and made again when it is lost."""

import math
import socket
from collections import deque
from collections.abc import Container

from omniman_ros.arm import sockets
from omniman_ros.arm.errors import ProtocolError
from omniman_ros.arm.feedback import ArmSample
from omniman_ros.arm.rtde_session import KEPT, SLIDER, Phase, RtdeSession

AGAIN = 1.0
"""Time from a loss to the next attempt, s."""


class RtdeLink:
    """Keeps a connection to a controller's RTDE port.

    Args:
        host: Address of the controller.
        port: Its port.
        register: See :class:`RtdeSession`.

    Attributes:
        lost: Why there is no connection, or there was none the last time.
        local: Address of this machine in the last connection, or an empty string.
        samples: Usable data that nobody has taken, the newest :data:`KEPT`.
        texts: What the controller has said in words, as many.
        newest: The last usable data, None before the first. They stay when the connection is
            lost: their age tells.

    Raises:
        ParameterError: There is no such register.
    """

    def __init__(self, host: str, port: int, register: int) -> None:
        self._address = host, port
        self._register = register
        self._slider = True
        self._socket: socket.socket | None = None
        self._connecting = False
        self._next = self._began = -math.inf
        self._session = RtdeSession(register)
        self._counts = dict.fromkeys(self._session.counts, 0)
        self.lost = "not connected yet"
        self.local = ""
        self.samples: deque[ArmSample] = deque(maxlen=KEPT)
        self.texts: deque[str] = deque(maxlen=KEPT)
        self.newest: ArmSample | None = None

    @property
    def counts(self) -> dict[str, int]:
        """Data that were not as they should be, of all connections; see :class:`RtdeSession`."""
        return {kind: n + self._session.counts[kind] for kind, n in self._counts.items()}

    def trouble(self, now: float, timeout: float) -> str:
        """Why no data flow at this time, s, or an empty string.

        Args:
            now: Time, s.
            timeout: Age of the last usable data from which on they do not flow, s.
        """
        if self._socket is None or not self._session.running:
            return self.lost
        age = now - self._session.progress
        return f"no data for {age:.3f} s" if age > timeout else ""

    def readers(self) -> list[socket.socket]:
        """What is to be read."""
        return [] if self._socket is None or self._connecting else [self._socket]

    def writers(self) -> list[socket.socket]:
        """What can be written when it is connected."""
        return [self._socket] if self._socket is not None and self._connecting else []

    def tick(self, now: float, patience: float) -> None:
        """Connect if it is time to, give up what takes too long.

        Args:
            now: Time, s.
            patience: How long an answer may take, s.
        """
        if self._socket is None:
            if now >= self._next:
                self._connect(now)
        elif now - max(self._session.progress, self._began) > patience:
            what = "no usable data" if self._session.phase is Phase.RUNNING else "no answer"
            self._lose(f"{what} for {patience:g} s", now)

    def serve(self, ready: Container[object], now: float) -> None:
        """Go on with the connection if it is among the sockets that are ready."""
        sock = self._socket
        if sock is None or sock not in ready:
            return
        try:
            if self._connecting:
                sockets.finish(sock)
                self._connecting = False
                self.local = sock.getsockname()[0]
                self._say(sock, self._session.begin(now))
                return
            data = sockets.receive(sock)
            if data:
                self._say(sock, self._session.feed(data, now))
            elif data is not None:
                self._lose(sockets.CLOSED, now)
        except ProtocolError as error:
            self._lose(str(error), now)
        except OSError as error:
            self._lose(sockets.words(error), now)
        finally:
            self._collect()

    def close(self) -> None:
        """Close the connection."""
        sockets.close(self._socket)
        self._socket = None

    def _connect(self, now: float) -> None:
        self._retire()
        self._began = now
        try:
            self._socket = sockets.connect(*self._address)
        except OSError as error:
            self._lose(sockets.words(error), now)
            return
        self._connecting = True

    def _say(self, sock: socket.socket, data: bytes) -> None:
        if data and sockets.send(sock, data) != len(data):
            raise ProtocolError("RTDE: the controller takes no requests")

    def _lose(self, reason: str, now: float) -> None:
        self.close()
        self.lost = reason
        self._next = now + AGAIN
        if self._session.missing == {SLIDER}:
            self._slider = False
            self._next = now

    def _retire(self) -> None:
        """Take over what the last session has counted, and begin a new one."""
        self._counts = self.counts
        self._session = RtdeSession(self._register, self._slider)

    def _collect(self) -> None:
        for sample in self._session.take_samples():
            self.samples.append(sample)
            self.newest = sample
        self.texts.extend(self._session.take_texts())
