"""TCP sockets that never block, and what goes wrong with them in words."""

import contextlib
import errno
import os
import socket
import struct
from collections.abc import Iterator

from omniman_ros.core.errors import OmnimanError

MOST = 65536
"""Bytes that are read at once: more than a second of real-time data, so the newest come out."""
CALLS = 16
"""Calls that are taken at once: a flood must not hold up anything."""
CLOSED = "closed by the controller"
WORDS = {
    errno.ECONNREFUSED: "connection refused",
    errno.ECONNRESET: "reset",
    errno.EPIPE: "reset",
    errno.ETIMEDOUT: "no answer",
    errno.EHOSTUNREACH: "no route to the host",
    errno.ENETUNREACH: "network unreachable",
}
RESETS = struct.pack("ii", 1, 0)
"""SO_LINGER by which closing resets a connection, and throws away what it has not sent."""


class LinkError(OmnimanError):
    """A connection cannot be had or is of no use; the message says which and why."""


def words(error: OSError) -> str:
    """What went wrong with a socket, for people."""
    return WORDS.get(error.errno or 0) or (error.strerror or str(error) or "no answer").lower()


def address_of(host: str) -> str:
    """Return the IPv4 address of a host; a name is looked up, which may take long.

    Raises:
        LinkError: It has none.
    """
    try:
        return socket.gethostbyname(host)
    except (OSError, UnicodeError) as error:
        raise LinkError(f"ur.host '{host}' has no address: {error}") from error


def listen(port: int, peer: str) -> socket.socket:
    """Return a socket that listens for a peer's calls.

    Args:
        port: Where; 0: any that is free.
        peer: Address of who is to call. If that is this machine nobody else can.

    Raises:
        LinkError: The port cannot be had.
    """
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    listener.setblocking(False)
    # What is left of the connections of a former run must not keep the port.
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind(("127.0.0.1" if peer.startswith("127.") else "", port))
        listener.listen()
    except OSError as error:
        listener.close()
        raise LinkError(f"ur.reverse_port = {port} cannot be had: {words(error)}") from error
    return listener


def connect(host: str, port: int) -> socket.socket:
    """Return a socket that is being connected; it is done when it can be written.

    Raises:
        OSError: It fails at once.
    """
    sock = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    sock.setblocking(False)
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    code = sock.connect_ex((host, port))
    if code not in (0, errno.EINPROGRESS):
        sock.close()
        raise OSError(code, os.strerror(code))
    return sock


def finish(sock: socket.socket) -> None:
    """Look how connecting has ended.

    Raises:
        OSError: It failed.
    """
    code = sock.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
    if code:
        raise OSError(code, os.strerror(code))


def receive(sock: socket.socket) -> bytes | None:
    """Return bytes, none at the end of the stream, None if there is nothing yet.

    Raises:
        OSError: The connection is lost.
    """
    try:
        return sock.recv(MOST)
    except BlockingIOError:
        return None


def send(sock: socket.socket, data: bytes) -> int:
    """Return how many of the bytes were taken.

    Raises:
        OSError: The connection is lost.
    """
    try:
        return sock.send(data)
    except BlockingIOError:
        return 0


def accept(listener: socket.socket) -> Iterator[tuple[socket.socket, str]]:
    """Yield the calls that wait, and where they come from."""
    for _ in range(CALLS):
        try:
            sock, (host, _) = listener.accept()
        except OSError:  # none, or one that is gone already
            return
        sock.setblocking(False)
        yield sock, host


def close(sock: socket.socket | None, reset: bool = False) -> None:
    """Close a connection.

    Args:
        sock: The connection, if there is one.
        reset: Whether what has not been sent is thrown away; else it is sent, then FIN.
    """
    if sock is None:
        return
    with contextlib.suppress(OSError):
        if reset:
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESETS)
        else:
            receive(sock)  # Linux resets a connection that is closed with something unread
    sock.close()
