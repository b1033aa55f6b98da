"""Link to the program on the controller: sends its text, then setpoints once it has connected."""

import fcntl
import socket
import struct
import termios
from collections.abc import Container
from enum import Enum, auto

from omniman_ros.core.errors import InputError
from omniman_ros.ur import sockets
from omniman_ros.ur.reverse_interface import MESSAGE

#: Largest number of setpoints that may be unacknowledged: those sent in 96 ms.
#: A host with delayed TCP acknowledgements delays them by 40 ms, in which five setpoints are sent.
MAX_UNACKNOWLEDGED = 12
C_INT = struct.Struct("i")  #: Layout of a C int, the result of the ioctl SIOCOUTQ


class ProgramState(Enum):
    """State of the program on the controller, as derived from its connections."""

    NONE = auto()  #: The program was not started, or was ended by this host
    STARTING = auto()  #: The program is being sent, or has been sent and not yet connected
    RUNNING = auto()  #: The program has connected and receives setpoints
    LOST = auto()  #: The program did not connect, or its connection is lost


class ProgramLink:
    """Sends a program to a controller, accepts its connection, and sends setpoints over it.

    Args:
        reverse_port: Local port to which the program connects; 0 for any free one.

    Attributes:
        refused_connections: Number of refused connections, by kind: "foreign" ones from other
            hosts, "second" ones while a program runs, and "unawaited" ones when no program is
            expected to connect.

    Raises:
        LinkError: The reverse port is not available.
    """

    def __init__(
        self,
        host: str,
        script_port: int,
        reverse_port: int,
        max_unacknowledged: int = MAX_UNACKNOWLEDGED,
    ) -> None:
        self._host, self._script_port = host, script_port
        self._max_unacknowledged = max_unacknowledged
        self._listener = sockets.listen(reverse_port, host)
        self.port: int = self._listener.getsockname()[1]
        self._script: socket.socket | None = None
        self._connecting = False
        self._unsent_text = b""
        self._deadline = 0.0
        self._timeout = 0.0
        self._hints: dict[str, str] = {}
        self._reverse: socket.socket | None = None
        self.state = ProgramState.NONE
        self.loss_reason = ""
        self.refused_connections = {"foreign": 0, "second": 0, "unawaited": 0}

    def readers(self) -> list[socket.socket]:
        """Return the sockets to wait for until they are readable."""
        script = None if self._connecting else self._script
        return [s for s in (self._listener, script, self._reverse) if s is not None]

    def writers(self) -> list[socket.socket]:
        """Return the sockets to wait for until they are writable."""
        return [self._script] if self._script is not None and self._unsent_text else []

    def start(self, text: str, now: float, timeout: float) -> None:
        """Send a program, which has to connect within a time [s]; an earlier one is ended."""
        if not text.strip():
            raise InputError("the program must not be empty")
        self.end()
        self._accept_connections()  # refuses connections of earlier programs
        self._unsent_text = text.encode()
        self._deadline, self._timeout = now + timeout, timeout
        self._hints = {}
        self.state = ProgramState.STARTING
        try:
            self._script = sockets.connect(self._host, self._script_port)
        except OSError as error:
            self._fail(f"script port: {sockets.error_text(error)}")
            return
        self._connecting = True

    def tick(self, now: float) -> None:
        """Set the state to LOST if a program has not connected in time at `now` [s]."""
        if self.state is ProgramState.STARTING and now > self._deadline:
            self._fail(
                f"the program has not connected within {self._timeout:g} s"
                + "".join(f"; {hint}" for hint in self._hints.values())
            )

    def serve(self, ready: Container[object]) -> None:
        """Read from and write to those of :meth:`readers` and :meth:`writers` that are ready."""
        if self._reverse is not None and self._reverse in ready:
            self._serve_reverse(self._reverse)
        if self._script is not None and self._script in ready:
            self._serve_script(self._script)
        if self._listener in ready:
            self._accept_connections()

    def send(self, data: bytes) -> bool:
        """Send one setpoint without blocking; return False if it cannot be sent.

        The connection is ended if the operating system accepts only a part of the message, because
        the program would misread the following ones, or if the controller's host leaves
        `max_unacknowledged` setpoints unacknowledged. A program that does not read is not detected
        here, since its host buffers and acknowledges setpoints for minutes; `ArmSample.read` shows
        it.
        """
        if self._reverse is None:
            return False
        try:
            has_room = _unacknowledged(self._reverse) < self._max_unacknowledged * MESSAGE.size
            if has_room and sockets.send(self._reverse, data) == len(data):
                return True
            self._fail("the controller accepts no more setpoints", reset=True)
        except OSError as error:
            self._fail(sockets.error_text(error))
        return False

    def end(self) -> None:
        """End the connections of the program; data already sent still arrive, followed by FIN."""
        self._drop()
        self.state, self.loss_reason = ProgramState.NONE, ""

    def close(self) -> None:
        """End the connections of the program, and close the local port."""
        self.end()
        self._listener.close()

    def _serve_script(self, sock: socket.socket) -> None:
        """Send the rest of the program's text, and discard what the controller sends."""
        try:
            if self._connecting:
                sockets.check_connected(sock)
                self._connecting = False
            if self._unsent_text:
                self._unsent_text = self._unsent_text[sockets.send(sock, self._unsent_text) :]
            reason = sockets.CLOSED if sockets.receive(sock) == b"" else ""
        except OSError as error:
            reason = sockets.error_text(error)
        if reason and self._unsent_text:
            self._fail(f"script port: {reason}")
        elif reason:  # the controller has the whole program, which may be about to connect
            self._hints["script port"] = f"script port: {reason}"
            self._drop_script()

    def _serve_reverse(self, sock: socket.socket) -> None:
        """Detect the end of the program's connection, on which the program sends no data."""
        try:
            if sockets.receive(sock) == b"":
                self._fail(sockets.CLOSED)
        except OSError as error:
            self._fail(sockets.error_text(error))

    def _accept_connections(self) -> None:
        """Accept the program's connection, and refuse and count all others."""
        for sock, host in sockets.accept(self._listener):
            refusal = self._refusal(host)
            if refusal:
                self.refused_connections[refusal] += 1
                sock.close()
                continue
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._drop_script()
            self._reverse = sock
            self.state = ProgramState.RUNNING

    def _refusal(self, host: str) -> str:
        """Return the key of `refused_connections` for a connection, or "" if it is accepted."""
        if host != self._host:
            self._hints["foreign"] = f"{host}, which is not ur.host, tried to connect"
            return "foreign"
        if self.state is ProgramState.RUNNING:
            return "second"
        # Until all of its text is sent, the program cannot run and connect.
        is_awaited = self.state is ProgramState.STARTING and not self._unsent_text
        return "" if is_awaited else "unawaited"

    def _fail(self, reason: str, reset: bool = False) -> None:
        self._drop(reset)
        self.state, self.loss_reason = ProgramState.LOST, reason

    def _drop(self, reset: bool = False) -> None:
        self._drop_script()
        sockets.close(self._reverse, reset)
        self._reverse = None

    def _drop_script(self) -> None:
        sockets.close(self._script)
        self._script, self._connecting, self._unsent_text = None, False, b""


def _unacknowledged(sock: socket.socket) -> int:
    """Return the number of sent bytes that the peer has not acknowledged (SIOCOUTQ of tcp(7))."""
    return int(C_INT.unpack(fcntl.ioctl(sock, termios.TIOCOUTQ, bytes(C_INT.size)))[0])
