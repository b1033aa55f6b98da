"""The connections of the program on the controller: it is sent, it calls, it gets setpoints."""

import fcntl
import socket
import struct
import termios
from collections.abc import Container
from enum import Enum, auto

from omniman_ros.arm import sockets
from omniman_ros.arm.reverse import MESSAGE
from omniman_ros.core.errors import InputError

WAITING = 12
"""Setpoints that the controller's host may leave unacknowledged: 96 ms of them.

A host that delays its acknowledgements does so by 40 ms, five setpoints.
"""
NUMBER = struct.Struct("i")


class ProgramState(Enum):
    """Of the program, as its connection shows it."""

    NONE = auto()
    """Not asked for, or ended from here."""
    STARTING = auto()
    """Being sent, or its call is awaited."""
    RUNNING = auto()
    """It has called and takes setpoints."""
    LOST = auto()
    """It did not call, or its connection is gone."""


class ProgramLink:
    """Sends a program to a controller and takes its call.

    Args:
        host: Address of the controller.
        script_port: Its port that takes programs.
        reverse_port: Port here that the program calls; 0: any that is free.
        waiting: Setpoints that may be on their way, see :meth:`send`.

    Attributes:
        state: Of the program.
        trouble: Why it is lost, or an empty string.
        calls: Calls that were closed: of "foreign" hosts, a "second" one while a program runs,
            and "unawaited" ones.
        port: Port here that the program has to call.

    Raises:
        LinkError: The reverse port cannot be had.
    """

    def __init__(
        self, host: str, script_port: int, reverse_port: int, waiting: int = WAITING
    ) -> None:
        self._host, self._script_port, self._waiting = host, script_port, waiting
        self._listener = sockets.listen(reverse_port, host)
        self.port: int = self._listener.getsockname()[1]
        self._script: socket.socket | None = None
        self._connecting = False
        self._text = b""
        self._due = 0.0
        self._patience = 0.0
        self._hints: dict[str, str] = {}
        self._reverse: socket.socket | None = None
        self.state = ProgramState.NONE
        self.trouble = ""
        self.calls = {"foreign": 0, "second": 0, "unawaited": 0}

    def readers(self) -> list[socket.socket]:
        """What is to be read."""
        script = None if self._connecting else self._script
        return [s for s in (self._listener, script, self._reverse) if s is not None]

    def writers(self) -> list[socket.socket]:
        """What is to be written, or is connected when it can be."""
        return [self._script] if self._script is not None and self._text else []

    def start(self, text: str, now: float, patience: float) -> None:
        """Send a program and await its call; one before it is ended.

        Args:
            text: The program.
            now: Time, s.
            patience: How long all that may take, s.

        Raises:
            InputError: There is nothing to send.
        """
        if not text.strip():
            raise InputError("an empty program")
        self.end()
        self._serve_calls()  # whoever called before is not this program
        self._text = text.encode()
        self._due, self._patience = now + patience, patience
        self._hints = {}
        self.state = ProgramState.STARTING
        try:
            self._script = sockets.connect(self._host, self._script_port)
        except OSError as error:
            self._fail(f"script port: {sockets.words(error)}")
            return
        self._connecting = True

    def tick(self, now: float) -> None:
        """Give up a program that takes too long; time in s."""
        if self.state is ProgramState.STARTING and now > self._due:
            self._fail(
                f"no call from the program within {self._patience:g} s"
                + "".join(f"; {hint}" for hint in self._hints.values())
            )

    def serve(self, ready: Container[object]) -> None:
        """Go on with the connections that are ready."""
        if self._reverse is not None and self._reverse in ready:
            self._serve_reverse(self._reverse)
        if self._script is not None and self._script in ready:
            self._serve_script(self._script)
        if self._listener in ready:
            self._serve_calls()

    def send(self, data: bytes) -> bool:
        """Send one setpoint; False if there is no program that takes it.

        Never blocks. A message that is not taken whole ends the connection, as what followed
        would be read across the messages' borders; so does a host that does not acknowledge
        `waiting` of them. A program that does
        not read is no such host: its host acknowledges for minutes what it keeps for it. That
        shows in `ArmSample.read` only.
        """
        if self._reverse is None:
            return False
        try:
            taken = _unacknowledged(self._reverse) < self._waiting * MESSAGE.size
            if taken and sockets.send(self._reverse, data) == len(data):
                return True
            self._fail("the controller takes no more setpoints", reset=True)
        except OSError as error:
            self._fail(sockets.words(error))
        return False

    def end(self) -> None:
        """End the connections of the program: what was sent arrives, then FIN."""
        self._drop()
        self.state, self.trouble = ProgramState.NONE, ""

    def close(self) -> None:
        """Close everything."""
        self.end()
        self._listener.close()

    def _serve_script(self, sock: socket.socket) -> None:
        """Send what is left of the text; what the port sends is thrown away."""
        try:
            if self._connecting:
                sockets.finish(sock)
                self._connecting = False
            if self._text:
                self._text = self._text[sockets.send(sock, self._text) :]
            reason = sockets.CLOSED if sockets.receive(sock) == b"" else ""
        except OSError as error:
            reason = sockets.words(error)
        if reason and self._text:
            self._fail(f"script port: {reason}")
        elif reason:  # it has the program, which may be about to call
            self._hints["script port"] = f"script port: {reason}"
            self._drop_script()

    def _serve_reverse(self, sock: socket.socket) -> None:
        """Notice the end of the program; it says nothing else."""
        try:
            if sockets.receive(sock) == b"":
                self._fail(sockets.CLOSED)
        except OSError as error:
            self._fail(sockets.words(error))

    def _serve_calls(self) -> None:
        for sock, host in sockets.accept(self._listener):
            refusal = self._refusal(host)
            if refusal:
                self.calls[refusal] += 1
                sock.close()
                continue
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._drop_script()
            self._reverse = sock
            self.state = ProgramState.RUNNING

    def _refusal(self, host: str) -> str:
        """Why a call is not taken: a key of `calls`, or an empty string."""
        if host != self._host:
            self._hints["foreign"] = f"{host} called, which is not ur.host"
            return "foreign"
        if self.state is ProgramState.RUNNING:
            return "second"
        # before all of the text is out it cannot be this program
        return "unawaited" if self.state is not ProgramState.STARTING or self._text else ""

    def _fail(self, reason: str, reset: bool = False) -> None:
        self._drop(reset)
        self.state, self.trouble = ProgramState.LOST, reason

    def _drop(self, reset: bool = False) -> None:
        self._drop_script()
        sockets.close(self._reverse, reset)
        self._reverse = None

    def _drop_script(self) -> None:
        sockets.close(self._script)
        self._script, self._connecting, self._text = None, False, b""


def _unacknowledged(sock: socket.socket) -> int:
    """Bytes that the other host has not acknowledged: SIOCOUTQ of tcp(7)."""
    return int(NUMBER.unpack(fcntl.ioctl(sock, termios.TIOCOUTQ, bytes(NUMBER.size)))[0])
