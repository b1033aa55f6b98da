"""TCP connections on this machine that never block."""

import contextlib
import select
import socket

from omniman_ros.core.errors import OmnimanError

LOOPBACK = "127.0.0.1"  #: Address of both ends, which share a machine and its clock
CHUNK = 65536  #: Largest amount of data read at once [bytes]


class SimulationLinkError(OmnimanError):
    """The link to the other side does not work any more, or not yet."""


class LinkConnection:
    """One end of the link; it raises a LinkError once the other side does not read or is gone."""

    def __init__(self, connection: socket.socket) -> None:
        connection.setblocking(False)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket = connection

    def receive(self) -> bytes:
        """Return the bytes that have arrived, b"" if there are none."""
        try:
            data = self._socket.recv(CHUNK)
        except BlockingIOError:
            return b""
        except OSError as error:
            raise SimulationLinkError(f"the connection broke: {error}") from error
        if not data:
            raise SimulationLinkError("the other side has closed the connection")
        return data

    def send(self, frame: bytes) -> None:
        """Send a frame as a whole."""
        try:
            sent = self._socket.send(frame)
        except BlockingIOError:
            sent = 0
        except OSError as error:
            raise SimulationLinkError(f"the connection broke: {error}") from error
        if sent < len(frame):
            raise SimulationLinkError("the other side does not read")

    def wait(self, timeout: float) -> bool:
        """Wait until bytes have arrived, up to `timeout` [s]; return whether they have."""
        try:
            return bool(select.select([self._socket], [], [], timeout)[0])
        except (OSError, ValueError):
            return True  # the next call of receive raises the error

    def close(self) -> None:
        """Close the connection; do nothing if it is closed."""
        with contextlib.suppress(OSError):
            self._socket.close()
