"""Sockets that a program opens, and helpers for all sockets of the controller."""

import contextlib
import select
import socket
import struct

CONNECT_TIMEOUT = 0.02
"""Longest time for connecting [s], during which the controller is blocked."""
CHUNK = 65536
"""Largest amount of data read at once [bytes]."""
LINGER_RESET = struct.pack("ii", 1, 0)
"""SO_LINGER with which closing sends RST."""


def prepare(connection: socket.socket) -> None:
    """Make a connection non-blocking, and have it send small packages at once."""
    connection.setblocking(False)
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)


def abort(connection: socket.socket) -> None:
    """Close a connection with RST."""
    with contextlib.suppress(OSError):
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, LINGER_RESET)
    connection.close()


class ProgramSockets:
    """Connections that a program opens, by name; received bytes stay in the kernel until read."""

    def __init__(self) -> None:
        self._open: dict[str, socket.socket] = {}
        self._buffered: dict[str, bytes] = {}

    def open(self, host: str, port: int, name: str) -> bool:
        """Connect within 20 ms; return whether that succeeded."""
        self.close(name)
        connection = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        try:
            prepare(connection)
            with contextlib.suppress(BlockingIOError):
                connection.connect((host, port))
            _, writable, _ = select.select([], [connection], [], CONNECT_TIMEOUT)
            if writable and not connection.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR):
                self._open[name], self._buffered[name] = connection, b""
                return True
        except (OSError, OverflowError, UnicodeError):
            pass
        connection.close()
        return False

    def close(self, name: str) -> None:
        """Close a connection; do nothing if it is not open."""
        connection = self._open.pop(name, None)
        self._buffered.pop(name, None)
        if connection is not None:
            connection.close()

    def take(self, name: str, count: int) -> bytes | None:
        """Return exactly `count` bytes, b"" while fewer have arrived, or None if not open."""
        connection = self._open.get(name)
        if connection is None:
            return None
        buffered = self._buffered[name]
        if len(buffered) < count:
            try:
                more = connection.recv(count - len(buffered))
                if not more:
                    self.close(name)
                    return None
                buffered += more
            except BlockingIOError:
                pass
            except OSError:
                self.close(name)
                return None
        complete = len(buffered) >= count
        self._buffered[name] = buffered[count:] if complete else buffered
        return buffered[:count] if complete else b""

    def send(self, name: str, data: bytes) -> bool:
        """Send; return False if the connection is not open, or the peer does not accept it."""
        connection = self._open.get(name)
        if connection is None:
            return False
        try:
            return connection.send(data) == len(data)
        except OSError:
            return False

    def abort_all(self) -> None:
        """Close all connections with RST."""
        for connection in self._open.values():
            abort(connection)
        self._open.clear()
        self._buffered.clear()

    def close_all(self) -> None:
        """Close all connections."""
        for name in list(self._open):
            self.close(name)
