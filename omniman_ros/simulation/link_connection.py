"""TCP connections on this machine that never block, and the port that accepts them."""

import contextlib
import select
import socket

from omniman_ros.core.errors import OmnimanError, ParameterError

LOOPBACK = "127.0.0.1"
"""Address of both ends: the link stays on one machine, whose clock it shares."""
CHUNK = 65536
"""Largest amount of data read at once [bytes]."""


class LinkError(OmnimanError):
    """The link to the other side does not work any more, or not yet."""


class LinkConnection:
    """One end of the link.

    Args:
        connection: Connected socket, which this object owns from now on.
    """

    def __init__(self, connection: socket.socket) -> None:
        connection.setblocking(False)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket = connection

    def receive(self) -> bytes:
        """Return the bytes that have arrived, b"" if there are none.

        Raises:
            LinkError: The other side has closed the connection.
        """
        try:
            data = self._socket.recv(CHUNK)
        except BlockingIOError:
            return b""
        except OSError as error:
            raise LinkError(f"the connection broke: {error}") from error
        if not data:
            raise LinkError("the other side has closed the connection")
        return data

    def send(self, frame: bytes) -> None:
        """Send a frame as a whole.

        Raises:
            LinkError: The other side does not read, or has closed the connection.
        """
        try:
            sent = self._socket.send(frame)
        except BlockingIOError:
            sent = 0
        except OSError as error:
            raise LinkError(f"the connection broke: {error}") from error
        if sent < len(frame):
            raise LinkError("the other side does not read")

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


class LinkListener:
    """A port at which one other side at a time connects.

    Args:
        name: Name of the parameter that has the number of the port.
        port: TCP port on this machine; any free one if 0.

    Attributes:
        port: Number of the port.
        refused: Number of connections that were refused.

    Raises:
        ParameterError: The port is not available.
    """

    def __init__(self, name: str, port: int) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        try:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            self._socket.bind((LOOPBACK, port))
            self._socket.listen(1)
            self._socket.setblocking(False)
        except OSError as error:
            self._socket.close()
            raise ParameterError(name, port, f"cannot be used: {error}") from error
        self.port = int(self._socket.getsockname()[1])
        self.refused = 0

    def accept(self, *, refuse: bool) -> LinkConnection | None:
        """Accept who waits at the port; return the connection, if there is one.

        Args:
            refuse: Whether to close it at once, and to count it as refused.
        """
        try:
            accepted, _ = self._socket.accept()
        except OSError:
            return None
        if refuse:
            self.refused += 1
            accepted.close()
            return None
        return LinkConnection(accepted)

    def close(self) -> None:
        """Close the port; connections stay open."""
        self._socket.close()
