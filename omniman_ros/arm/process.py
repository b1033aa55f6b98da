"""A node's handle of its streaming process."""

import socket
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Callable
from typing import Any

from omniman_ros.arm.channel import Channel, ChannelError
from omniman_ros.arm.loop import Order
from omniman_ros.arm.parameters import UrParameters
from omniman_ros.arm.report import ArmReport
from omniman_ros.arm.sockets import LinkError
from omniman_ros.core.arm_parameters import ArmParameters

ENDED = "the streaming process has ended"
ENDING = 4.0
"""How long the process may take to end [s]; nodes are ended by the kernel soon after."""


class StreamProcess:
    """Starts the process, sends it orders, collects its reports.

    Args:
        arm, ur: Parameters.
        wake: Called from another thread when something has come.

    Attributes:
        report: The last one.
        failure: Why the process is gone, or empty.
        punctual: Why the process has no priority over others, or empty.
    """

    def __init__(
        self, arm: ArmParameters, ur: UrParameters, wake: Callable[[], None] = lambda: None
    ) -> None:
        ours, its = socket.socketpair()
        self._channel = Channel(ours)
        with its:
            # A group of its own: Ctrl-C is for the node, which ends it in order.
            self._process = subprocess.Popen(
                [sys.executable, "-m", "omniman_ros.arm.loop", str(its.fileno())],
                pass_fds=[its.fileno()], stdin=subprocess.DEVNULL, start_new_session=True,
            )  # fmt: skip
        self._wake = wake
        self.report = ArmReport()
        self.failure = self.punctual = ""
        self._heard: deque[Any] = deque()
        self._news = threading.Event()
        self._channel.send((arm, ur))
        self._reader = threading.Thread(target=self._read, name="arm reports", daemon=True)
        self._reader.start()

    def order(self, do: str, *arguments: Any) -> None:
        """Send an order; see :class:`loop.StreamLoop`. A process that is gone gets none."""
        self._try(lambda: self._channel.send(Order(do, arguments)))

    def flush(self) -> None:
        """Send orders that there was no room for: call it now and then."""
        self._try(self._channel.flush)

    def _try(self, send: Callable[[], None]) -> None:
        if self.failure:
            return
        try:
            send()
        except ChannelError as error:
            self.failure = ENDED if error.__cause__ else str(error)

    def take(self) -> list[ArmReport]:
        """Return the reports that have come since the last call, oldest first."""
        self._news.clear()
        reports = []
        while self._heard:
            message = self._heard.popleft()
            if isinstance(message, ArmReport):
                self.report = message
                reports.append(message)
            elif isinstance(message, ChannelError):
                self.failure = self.failure or ENDED
            elif isinstance(message, LinkError):
                self.failure = str(message)
            else:
                self.punctual = message
        return reports

    def wait(self, timeout: float) -> bool:
        """Wait for something to come [s]; whether it did."""
        return self._news.wait(timeout)

    def _read(self) -> None:
        while True:
            try:
                for message in self._channel.wait_and_receive():
                    self._heard.append(message)
                    self._tell()
            except ChannelError as error:
                self._heard.append(error)
                self._tell()
                return

    def _tell(self) -> None:
        self._news.set()
        self._wake()

    def close(self, hung: bool = False) -> None:
        """End the process: it brings the arm to rest first. One that hangs is killed."""
        self._wake = lambda: None
        self._channel.shut()
        try:
            self._process.wait(0.0 if hung else ENDING)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._reader.join(1.0)
        self._channel.close()
