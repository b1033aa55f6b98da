"""Handle of a streaming process in its node."""

import socket
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Callable
from typing import Any

from omniman_ros.core.arm_parameters import ArmParameters
from omniman_ros.ur.parameters import UrParameters
from omniman_ros.ur.process_channel import ProcessChannel, ProcessChannelError
from omniman_ros.ur.sockets import LinkError
from omniman_ros.ur.streaming_messages import CommandMessage, StreamingCommand, StreamingReport

#: Failure of a process that has ended without reporting a reason
ENDED = "the streaming process has ended"
#: How long the process may take to end [s]: the node's shutdown must not last much longer
EXIT_TIMEOUT = 4.0


class StreamingProcess:
    """Starts a streaming process, sends it commands, and collects its reports.

    Args:
        wake: Called from another thread when a message has arrived.
        clock: Returns the simulated time [s], which the process then gets by
            `StreamingCommand.TIME`; None for the monotonic clock.
    """

    def __init__(
        self,
        arm: ArmParameters,
        ur: UrParameters,
        wake: Callable[[], None] = lambda: None,
        clock: Callable[[], float] | None = None,
    ) -> None:
        node_end, process_end = socket.socketpair()
        self._channel = ProcessChannel(node_end)
        with process_end:
            # In a session of its own, Ctrl-C reaches the node only, which then ends the process.
            self._process = subprocess.Popen(
                [sys.executable, "-m", "omniman_ros.ur.streaming_loop", str(process_end.fileno())],
                pass_fds=[process_end.fileno()],
                stdin=subprocess.DEVNULL,
                start_new_session=True,
            )
        self._wake = wake
        self.report = StreamingReport()
        self.failure = self.priority_warning = ""
        self._received: deque[Any] = deque()
        self._arrival = threading.Event()
        self._channel.send((arm, ur, None if clock is None else clock()))
        self._reader = threading.Thread(target=self._read, name="arm reports", daemon=True)
        self._reader.start()

    def send(self, command: StreamingCommand, *arguments: Any) -> None:
        """Send a command, unless the process has ended."""
        self._attempt(lambda: self._channel.send(CommandMessage(command, arguments)))

    def flush(self) -> None:
        """Send messages that did not fit into the buffer; to be called periodically."""
        self._attempt(self._channel.flush)

    def _attempt(self, send: Callable[[], None]) -> None:
        if self.failure:
            return
        try:
            send()
        except ProcessChannelError as error:
            self.failure = ENDED if error.__cause__ else str(error)

    def take(self) -> list[StreamingReport]:
        """Return the reports that have arrived since the last call, oldest first."""
        self._arrival.clear()
        reports = []
        while self._received:
            message = self._received.popleft()
            if isinstance(message, StreamingReport):
                self.report = message
                reports.append(message)
            elif isinstance(message, ProcessChannelError):
                self.failure = self.failure or ENDED
            elif isinstance(message, LinkError):
                self.failure = str(message)
            else:
                self.priority_warning = message
        return reports

    def wait(self, timeout: float) -> bool:
        """Wait up to `timeout` [s] for a message; return whether one has arrived."""
        return self._arrival.wait(timeout)

    def _read(self) -> None:
        """Receive messages until the process has ended; runs in a thread."""
        while True:
            try:
                for message in self._channel.wait_and_receive():
                    self._received.append(message)
                    self._notify()
            except ProcessChannelError as error:
                self._received.append(error)
                self._notify()
                return

    def _notify(self) -> None:
        self._arrival.set()
        self._wake()

    def close(self, kill: bool = False) -> None:
        """End the process, which brings the arm to rest first unless it hangs and is killed."""
        self._wake = lambda: None
        self._channel.shut_down()
        try:
            self._process.wait(0.0 if kill else EXIT_TIMEOUT)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._reader.join(1.0)
        self._channel.close()
