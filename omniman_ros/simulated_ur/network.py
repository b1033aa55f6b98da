"""Sockets: those of the program, and what all of them here have in common."""

import contextlib
import select
import socket
import struct

CONNECTING = 0.02
"""How long a connection may take to open [s]; the controller waits so long."""
CHUNK = 65536
ABORT = struct.pack("ii", 1, 0)
"""SO_LINGER that makes closing send RST."""


def prepare(connection: socket.socket) -> None:
    """Have a connection neither block nor delay small packages."""
    connection.setblocking(False)
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)


def abort(connection: socket.socket) -> None:
    """Close a connection by RST."""
    with contextlib.suppress(OSError):
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, ABORT)
    connection.close()


class ProgramNetwork:
    """Connections that a program opens; what they receive waits in the kernel until it is read."""

    def __init__(self) -> None:
        self._open: dict[str, socket.socket] = {}
        self._taken: dict[str, bytes] = {}

    def open(self, host: str, port: int, name: str) -> bool:
        """Connect within 20 ms; false if that fails."""
        self.close(name)
        connection = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        try:
            prepare(connection)
            with contextlib.suppress(BlockingIOError):
                connection.connect((host, port))
            _, writable, _ = select.select([], [connection], [], CONNECTING)
            if writable and not connection.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR):
                self._open[name], self._taken[name] = connection, b""
                return True
        except (OSError, OverflowError, UnicodeError):
            pass
        connection.close()
        return False

    def close(self, name: str) -> None:
        """Close; nothing if it is not open."""
        connection = self._open.pop(name, None)
        self._taken.pop(name, None)
        if connection is not None:
            connection.close()

    def take(self, name: str, count: int) -> bytes | None:
        """Exactly `count` bytes if so many have come, else b""; None: closed, or never open."""
        connection = self._open.get(name)
        if connection is None:
            return None
        held = self._taken[name]
        if len(held) < count:
            try:
                more = connection.recv(count - len(held))
                if not more:
                    self.close(name)
                    return None
                held += more
            except BlockingIOError:
                pass
            except OSError:
                self.close(name)
                return None
        whole = len(held) >= count
        self._taken[name] = held[count:] if whole else held
        return held[:count] if whole else b""

    def send(self, name: str, data: bytes) -> bool:
        """Send; false if it is not open or the peer does not take it."""
        connection = self._open.get(name)
        if connection is None:
            return False
        try:
            return connection.send(data) == len(data)
        except OSError:
            return False

    def abort_all(self) -> None:
        """Close all connections by RST."""
        for connection in self._open.values():
            abort(connection)
        self._open.clear()
        self._taken.clear()

    def close_all(self) -> None:
        """Close all connections."""
        for name in list(self._open):
            self.close(name)
