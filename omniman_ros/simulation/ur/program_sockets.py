"""Sockets that a program opens, and helpers for all sockets of the controller."""

import array
import contextlib
import fcntl
import math
import select
import socket
import struct
import termios

CONNECT_TIMEOUT = 0.02  #: Longest time for connecting [s], during which the controller is blocked
CHUNK = 65536  #: Largest amount of data read at once [bytes]
LINGER_RESET = struct.pack("ii", 1, 0)  #: SO_LINGER with which closing sends RST


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
        self._allowances: dict[str, int] = {}

    def admit(self, due_cycles: int) -> None:
        """Determine which of the received bytes the program may read in this cycle.

        A controller that was held up runs the cycles that it missed. What arrived meanwhile is
        spread evenly over them, as if it had been read when it arrived; read all at once, it
        would be a jump that no real controller sees, because none is held up.
        """
        self._allowances.clear()
        if due_cycles > 1:
            for name, connection in self._open.items():
                # At least one byte, because only reading shows the end of a connection.
                fraction = math.ceil(_available(connection) / due_cycles)
                self._allowances[name] = max(fraction, 1)

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
        except (OSError, OverflowError, TypeError, ValueError):
            pass  # the last three are of what is no address or port
        connection.close()
        return False

    def close(self, name: str) -> None:
        """Close a connection; do nothing if it is not open."""
        connection = self._open.pop(name, None)
        self._buffered.pop(name, None)
        self._allowances.pop(name, None)
        if connection is not None:
            connection.close()

    def take(self, name: str, count: int) -> bytes | None:
        """Return exactly `count` bytes, b"" while fewer have arrived, or None if not open."""
        connection = self._open.get(name)
        if connection is None:
            return None
        buffered = self._buffered[name]
        wanted = min(count - len(buffered), self._allowances.get(name, count))
        if wanted > 0:
            try:
                more = connection.recv(wanted)
                if not more:
                    self.close(name)
                    return None
                buffered += more
                if name in self._allowances:
                    self._allowances[name] -= len(more)
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


def _available(connection: socket.socket) -> int:
    """Return how many bytes have arrived and were not yet read (FIONREAD of tcp(7))."""
    count = array.array("i", [0])
    fcntl.ioctl(connection, termios.FIONREAD, count)
    return count[0]
