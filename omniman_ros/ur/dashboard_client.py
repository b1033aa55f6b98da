"""Client of a UR controller's dashboard server: one line per request and reply (TCP port 29999).

Source: Universal Robots, "Dashboard Server". The calls block, so the streaming process must not
make them.
"""

import math
import socket
import time
from collections.abc import Callable, Sequence

from omniman_ros.core.errors import InputError
from omniman_ros.core.stop import ResetRefusedError
from omniman_ros.ur.parameters import UrParameters
from omniman_ros.ur.sockets import LinkError, address_of, error_text

GREETING = "Connected: Universal Robots Dashboard Server"  #: First line of the server
MAX_LINE = 1024  #: Length of the longest line that is accepted [bytes]
#: Commands that unlock a protective stop
UNLOCK_COMMANDS = ("close safety popup", "unlock protective stop")
#: Beginning of the reply of a controller that unlocks its protective stop, in lower case
UNLOCKED_REPLY = "protective stop releasing"


def call(
    host: str,
    port: int,
    commands: Sequence[str],
    timeout: float,
    clock: Callable[[], float] = time.monotonic,
) -> list[str]:
    """Send commands, one line each, over a new connection, and return the reply to each.

    Args:
        timeout: Time limit of the whole exchange [s]; the look-up of a host name is not included.

    Raises:
        LinkError: The server cannot be reached, is not a dashboard server, or does not answer
            in time.
        InputError: A command is not one line, or the time limit is not positive and finite.
    """
    for command in commands:
        if not command.isprintable() or not command.isascii() or not command.strip():
            raise InputError(f"dashboard command {command!r} must be one line of text")
    if not 0.0 < timeout < math.inf:
        raise InputError(f"dashboard timeout {timeout} s must be positive and finite")
    connection = _Connection(timeout, clock)
    try:
        connection.connect(address_of(host), port)
        greeting = connection.read_line()
        if not greeting.startswith(GREETING):
            raise LinkError(f"dashboard: {greeting[:80]!r} is not the greeting of a UR controller")
        replies = []
        for command in commands:
            connection.send(command)
            replies.append(connection.read_line())
        return replies
    except TimeoutError as error:
        raise LinkError(f"dashboard: no answer within {timeout:g} s") from error
    except OSError as error:
        raise LinkError(f"dashboard: {error_text(error)}") from error
    finally:
        connection.close()


def unlock(parameters: UrParameters, clock: Callable[[], float] = time.monotonic) -> str:
    """Ask a controller to leave its protective stop; return its refusal, or an empty string."""
    p = parameters
    reply = call(p.host, p.dashboard_port, UNLOCK_COMMANDS, p.connect_timeout, clock)[-1]
    return "" if reply.lower().startswith(UNLOCKED_REPLY) else reply or "an empty reply"


def unlock_for_reset(
    parameters: UrParameters, clock: Callable[[], float] = time.monotonic
) -> None:
    """Unlock the protective stop of a controller for a reset of the node.

    Raises:
        ResetRefusedError: `ur.unlock` does not allow it, the dashboard server cannot be used, or
            the controller refuses.
    """
    if not parameters.unlock:
        raise ResetRefusedError(
            "protective stop: inspect the arm, then unlock it on the pendant (or set ur.unlock)"
        )
    try:
        refusal = unlock(parameters, clock)
    except LinkError as error:
        raise ResetRefusedError(f"the dashboard server: {error}") from error
    if refusal:
        raise ResetRefusedError(f"the controller reports: {refusal}")


class _Connection:
    """Connection to the server whose steps share one time limit."""

    def __init__(self, timeout: float, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._end = clock() + timeout
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        self._unread = b""

    def connect(self, host: str, port: int) -> None:
        self._set_remaining_timeout()
        self._socket.connect((host, port))

    def send(self, command: str) -> None:
        if self._unread:
            raise LinkError(f"dashboard: unexpected data without a command: {self._unread[:80]!r}")
        self._set_remaining_timeout()
        self._socket.sendall(command.encode() + b"\n")

    def read_line(self) -> str:
        while b"\n" not in self._unread:
            if len(self._unread) > MAX_LINE:
                raise LinkError(f"dashboard: a line must be at most {MAX_LINE} bytes")
            self._set_remaining_timeout()
            data = self._socket.recv(MAX_LINE)
            if not data:
                raise LinkError("dashboard: closed by the controller")
            self._unread += data
        line, self._unread = self._unread.split(b"\n", 1)
        return line.decode("utf-8", "replace").strip()

    def close(self) -> None:
        self._socket.close()

    def _set_remaining_timeout(self) -> None:
        remaining = self._end - self._clock()
        if remaining <= 0.0:
            raise TimeoutError
        self._socket.settimeout(remaining)
