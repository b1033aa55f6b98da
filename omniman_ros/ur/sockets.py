"""TCP sockets that never block, and texts for their errors."""

import contextlib
import errno
import os
import socket
import struct
from collections.abc import Iterator

from omniman_ros.core.errors import OmnimanError

#: Largest amount of data that is read at once [bytes]: more than a second of real-time data
READ_SIZE = 65536
#: Largest number of connections that are accepted at once: a flood must not delay the cycle
MAX_ACCEPTS = 16
#: Loss reason of a connection that the controller has closed regularly
CLOSED = "closed by the controller"
ERROR_TEXTS = {
    errno.ECONNREFUSED: "connection refused",
    errno.ECONNRESET: "reset",
    errno.EPIPE: "reset",
    errno.ETIMEDOUT: "no answer",
    errno.EHOSTUNREACH: "no route to the host",
    errno.ENETUNREACH: "network unreachable",
}  #: Short texts of common errors
#: Value of SO_LINGER with which closing resets a connection and discards unsent data
LINGER_RESET = struct.pack("ii", 1, 0)


class LinkError(OmnimanError):
    """A connection is not available; the message says which one and why."""


def error_text(error: OSError) -> str:
    """Return the error of a socket as a short text."""
    return (
        ERROR_TEXTS.get(error.errno or 0) or (error.strerror or str(error) or "no answer").lower()
    )


def address_of(host: str) -> str:
    """Return the IPv4 address of a host, for whose name this may block, or raise LinkError."""
    try:
        return socket.gethostbyname(host)
    except (OSError, UnicodeError) as error:
        raise LinkError(f"ur.host '{host}' has no address: {error}") from error


def listen(port: int, peer: str) -> socket.socket:
    """Return a socket that listens for connections of a peer.

    Args:
        port: TCP port; 0 selects any free one.
        peer: Address of the peer. If that is this machine, no other host can connect.

    Raises:
        LinkError: The port is not available.
    """
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    listener.setblocking(False)
    # Connections left over from an earlier run must not keep the port busy.
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind(("127.0.0.1" if peer.startswith("127.") else "", port))
        listener.listen()
    except OSError as error:
        listener.close()
        raise LinkError(
            f"ur.reverse_port = {port} is not available: {error_text(error)}"
        ) from error
    return listener


def connect(host: str, port: int) -> socket.socket:
    """Return a socket that is connected once it is writable, or raise OSError."""
    sock = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    sock.setblocking(False)
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    code = sock.connect_ex((host, port))
    if code not in (0, errno.EINPROGRESS):
        sock.close()
        raise OSError(code, os.strerror(code))
    return sock


def check_connected(sock: socket.socket) -> None:
    """Raise OSError if connecting has failed."""
    code = sock.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
    if code:
        raise OSError(code, os.strerror(code))


def receive(sock: socket.socket) -> bytes | None:
    """Return received bytes, b"" at the end, None if there are none; raise OSError if lost."""
    try:
        return sock.recv(READ_SIZE)
    except BlockingIOError:
        return None


def send(sock: socket.socket, data: bytes) -> int:
    """Send as many bytes as the socket accepts, and return their number, or raise OSError."""
    try:
        return sock.send(data)
    except BlockingIOError:
        return 0


def accept(listener: socket.socket) -> Iterator[tuple[socket.socket, str]]:
    """Yield the waiting connections, each with the address of its peer."""
    for _ in range(MAX_ACCEPTS):
        try:
            sock, (host, _) = listener.accept()
        except OSError:  # there is none, or it was closed already
            return
        sock.setblocking(False)
        yield sock, host


def close(sock: socket.socket | None, reset: bool = False) -> None:
    """Close a connection, if any: with `reset`, unsent data are discarded (RST)."""
    if sock is None:
        return
    with contextlib.suppress(OSError):
        if reset:
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, LINGER_RESET)
        else:
            receive(sock)  # Linux resets a connection that is closed with unread data
    sock.close()
