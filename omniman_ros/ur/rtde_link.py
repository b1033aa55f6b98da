"""Connection for real-time data, which is supervised and re-established after a loss."""

import math
import socket
from collections import deque
from collections.abc import Container

from omniman_ros.ur import sockets
from omniman_ros.ur.feedback import ArmSample
from omniman_ros.ur.rtde_packets import ProtocolError
from omniman_ros.ur.rtde_session import MAX_UNREAD_SAMPLES, SLIDER, RtdeSession, SessionPhase

RECONNECT_DELAY = 1.0  #: Time from a loss to the next attempt to connect [s]


class RtdeLink:
    """Keeps a connection to a controller's RTDE port.

    Attributes:
        local: Address of this machine in the last connection, or an empty string.
        samples: Usable data that have not been read, at most the newest `MAX_UNREAD_SAMPLES`.
        texts: Text messages of the controller that have not been read, as many.
        newest: Newest usable data; None before the first. It remains when the connection is lost,
            which its age shows.
    """

    def __init__(self, host: str, port: int, register: int) -> None:
        self._address = host, port
        self._register = register
        self._slider = True
        self._socket: socket.socket | None = None
        self._connecting = False
        self._next_attempt = self._attempt_time = -math.inf
        self._session = RtdeSession(register)
        self._counts = dict.fromkeys(self._session.counts, 0)
        self.loss_reason = "not connected yet"
        self.local = ""
        self.samples: deque[ArmSample] = deque(maxlen=MAX_UNREAD_SAMPLES)
        self.texts: deque[str] = deque(maxlen=MAX_UNREAD_SAMPLES)
        self.newest: ArmSample | None = None

    @property
    def counts(self) -> dict[str, int]:
        """Number of unusable data of all connections, by kind; see :class:`RtdeSession`."""
        return {kind: n + self._session.counts[kind] for kind, n in self._counts.items()}

    def blocking_reason(self, now: float, timeout: float) -> str:
        """Return why no data flow, or an empty string; older ones than `timeout` [s] do not."""
        if self._socket is None or not self._session.running:
            return self.loss_reason
        age = now - self._session.progress
        return f"no data for {age:.3f} s" if age > timeout else ""

    def readers(self) -> list[socket.socket]:
        """Return the sockets to wait for until they are readable."""
        return [] if self._socket is None or self._connecting else [self._socket]

    def writers(self) -> list[socket.socket]:
        """Return the sockets to wait for until they are writable, which means connected."""
        return [self._socket] if self._socket is not None and self._connecting else []

    def tick(self, now: float, timeout: float) -> None:
        """Connect if that is due; give up a connection without an answer for `timeout` [s]."""
        if self._socket is None:
            if now >= self._next_attempt:
                self._connect(now)
        elif now - max(self._session.progress, self._attempt_time) > timeout:
            is_running = self._session.phase is SessionPhase.RUNNING
            symptom = "no usable data" if is_running else "no answer"
            self._lose(f"{symptom} for {timeout:g} s", now)

    def serve(self, ready: Container[object], now: float) -> None:
        """Serve the connection if it is among the sockets that are ready."""
        sock = self._socket
        if sock is None or sock not in ready:
            return
        try:
            if self._connecting:
                sockets.check_connected(sock)
                self._connecting = False
                self.local = sock.getsockname()[0]
                self._send(sock, self._session.begin(now))
                return
            data = sockets.receive(sock)
            if data:
                self._send(sock, self._session.feed(data, now))
            elif data is not None:
                self._lose(sockets.CLOSED, now)
        except ProtocolError as error:
            self._lose(str(error), now)
        except OSError as error:
            self._lose(sockets.error_text(error), now)
        finally:
            self._collect()

    def close(self) -> None:
        """Close the connection."""
        sockets.close(self._socket)
        self._socket = None

    def _connect(self, now: float) -> None:
        self._retire()
        self._attempt_time = now
        try:
            self._socket = sockets.connect(*self._address)
        except OSError as error:
            self._lose(sockets.error_text(error), now)
            return
        self._connecting = True

    def _send(self, sock: socket.socket, data: bytes) -> None:
        if data and sockets.send(sock, data) != len(data):
            raise ProtocolError("RTDE: the controller accepts no requests")

    def _lose(self, reason: str, now: float) -> None:
        self.close()
        self.loss_reason = reason
        self._next_attempt = now + RECONNECT_DELAY
        if self._session.missing == {SLIDER}:
            self._slider = False
            self._next_attempt = now

    def _retire(self) -> None:
        """Add the counts of the last session to the total, and create a new session."""
        self._counts = self.counts
        self._session = RtdeSession(self._register, self._slider)

    def _collect(self) -> None:
        for sample in self._session.take_samples():
            self.samples.append(sample)
            self.newest = sample
        self.texts.extend(self._session.take_texts())
