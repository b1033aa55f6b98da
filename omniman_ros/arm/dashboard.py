"""The dashboard server of a UR controller: a line asks, a line answers (TCP port 29999).

Source: Universal Robots, "Dashboard Server". Blocks: not for the process that streams.
"""

import math
import socket
import time
from collections.abc import Callable, Sequence

from omniman_ros.arm.parameters import UrParameters
from omniman_ros.arm.sockets import LinkError, address_of, words
from omniman_ros.core.errors import InputError

GREETING = "Connected: Universal Robots Dashboard Server"
LONGEST = 1024
"""Bytes of the longest line that is believed."""
UNLOCK = ("close safety popup", "unlock protective stop")
UNLOCKED = "protective stop releasing"


def call(
    host: str, port: int, commands: Sequence[str], timeout: float,
    clock: Callable[[], float] = time.monotonic,
) -> list[str]:  # fmt: skip
    """Ask for things one after the other on a connection of its own.

    Args:
        host: Address of the controller.
        port: Of its dashboard server.
        commands: What to ask, a line each.
        timeout: How long all of it may take, s; the look-up of a name comes on top.
        clock: Gives the time, s, steady.

    Returns:
        The reply to each command, without the end of the line.

    Raises:
        LinkError: The server cannot be reached, is none, or does not answer in time.
        InputError: A command is not one line, or the time is none.
    """
    for command in commands:
        if not command.isprintable() or not command.isascii() or not command.strip():
            raise InputError(f"dashboard command {command!r} is not one line of text")
    if not 0.0 < timeout < math.inf:
        raise InputError(f"dashboard time-out {timeout} s")
    server = _Server(timeout, clock)
    try:
        server.connect(address_of(host), port)
        greeting = server.line()
        if not greeting.startswith(GREETING):
            raise LinkError(f"dashboard: {greeting[:80]!r} is no greeting of a UR controller")
        replies = []
        for command in commands:
            server.ask(command)
            replies.append(server.line())
        return replies
    except TimeoutError as error:
        raise LinkError(f"dashboard: no answer within {timeout:g} s") from error
    except OSError as error:
        raise LinkError(f"dashboard: {words(error)}") from error
    finally:
        server.close()


def unlock(parameters: UrParameters, clock: Callable[[], float] = time.monotonic) -> str:
    """Ask a controller to leave its protective stop.

    Args:
        parameters: Where it is, and how long it may take.
        clock: Gives the time, s, steady.

    Returns:
        Its refusal in its own words, or an empty string.

    Raises:
        LinkError: It cannot be asked.
    """
    p = parameters
    reply = call(p.host, p.dashboard_port, UNLOCK, p.connect_timeout, clock)[-1]
    return "" if reply.lower().startswith(UNLOCKED) else reply or "an empty reply"


class _Server:
    """A connection whose every step has what is left of the time."""

    def __init__(self, timeout: float, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._end = clock() + timeout
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        self._rest = b""

    def connect(self, host: str, port: int) -> None:
        self._limit()
        self._socket.connect((host, port))

    def ask(self, command: str) -> None:
        if self._rest:
            raise LinkError(f"dashboard: {self._rest[:80]!r} before anything was asked")
        self._limit()
        self._socket.sendall(command.encode() + b"\n")

    def line(self) -> str:
        while b"\n" not in self._rest:
            if len(self._rest) > LONGEST:
                raise LinkError(f"dashboard: a line of more than {LONGEST} bytes")
            self._limit()
            data = self._socket.recv(LONGEST)
            if not data:
                raise LinkError("dashboard: closed by the controller")
            self._rest += data
        line, self._rest = self._rest.split(b"\n", 1)
        return line.decode("utf-8", "replace").strip()

    def close(self) -> None:
        self._socket.close()

    def _limit(self) -> None:
        left = self._end - self._clock()
        if left <= 0.0:
            raise TimeoutError
        self._socket.settimeout(left)
