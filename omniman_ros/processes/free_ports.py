"""TCP ports on this machine that no process uses."""

import socket
from collections.abc import Iterable
from contextlib import ExitStack


def are_free(ports: Iterable[int]) -> bool:
    """Return whether no process on this machine listens on any of the ports."""
    try:
        with ExitStack() as stack:
            for port in ports:
                stack.enter_context(_listen(port))
    except OSError:
        return False
    return True


def find_free_ports(count: int) -> list[int]:
    """Return different ports on which no process on this machine listens."""
    with ExitStack() as stack:
        listeners = [stack.enter_context(_listen(0)) for _ in range(count)]
        return [listener.getsockname()[1] for listener in listeners]


def _listen(port: int) -> socket.socket:
    """Return a socket that listens on a port of this machine, or on any free one if it is 0."""
    listener = socket.socket()
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(("127.0.0.1", port))
        listener.listen()
    except OSError:
        listener.close()
        raise
    return listener
