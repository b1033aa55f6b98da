"""The bus itself: python-can, and a thread that only carries frames over."""

import threading
import time
from collections import deque
from collections.abc import Callable, Iterable
from typing import Any

import can

from omniman_ros.can_drive.frame import Frame
from omniman_ros.core.can_parameters import CanParameters
from omniman_ros.core.errors import OmnimanError

BUS_OFF = 0x040
"""Flag of SocketCAN's error frames: the controller is off the bus."""
PATIENCE = 0.1
"""How long one read of the thread waits, s: so long does closing take at most."""


class BusError(OmnimanError):
    """The bus cannot be opened; the message says which and why."""


class CanBus:
    """A bus of python-can, read by a thread that never dies of what it hears.

    Args:
        p: Interface, channel and bit rate.
        wake: Called from the thread when there is something to take.

    Raises:
        BusError: It cannot be opened.
    """

    def __init__(self, p: CanParameters, wake: Callable[[], None] = lambda: None) -> None:
        options: dict[str, Any] = {"interface": p.interface, "channel": p.channel}
        if p.interface == "udp_multicast":
            options |= {"port": p.port, "hop_limit": 0, "fd": False}
        elif p.interface != "virtual":
            options["bitrate"] = p.bitrate
        try:
            self._bus = can.Bus(**options)
        except Exception as error:  # each back end of python-can raises what its library does
            reason = str(error) or type(error).__name__
            raise BusError(f"no bus {p.interface} {p.channel}: {reason}") from error
        self._wake = wake
        self._heard: deque[Frame | str] = deque()
        self._event = threading.Event()
        self._pending = False
        self._closing = False
        self.garbage = 0
        self._thread = threading.Thread(target=self._read, name="can", daemon=True)
        self._thread.start()

    def _read(self) -> None:
        while not self._closing:
            try:
                message = self._bus.recv(PATIENCE)
            except can.CanError as error:
                self._on_error(error)
                continue
            if message is None:
                continue
            if message.is_error_frame:
                if message.arbitration_id & BUS_OFF:
                    self._put("off (error frame)")
                continue
            if message.is_fd:
                self.garbage += 1
                continue
            self._put(
                Frame(
                    message.arbitration_id, bytes(message.data), message.is_extended_id,
                    message.is_remote_frame,
                )
            )  # fmt: skip

    def _on_error(self, error: can.CanError) -> None:
        """Nonsense on the wire is counted; a bus that cannot be read has failed."""
        if isinstance(error.__cause__, OSError):
            if not self._closing:
                self._put(f"cannot be read: {error}")
                time.sleep(PATIENCE)
        else:
            self.garbage += 1

    def _put(self, item: Frame | str) -> None:
        self._heard.append(item)
        self._event.set()
        if not self._pending:
            self._pending = True
            self._wake()

    def take(self) -> Iterable[Frame | str]:
        """Yield what was heard: frames, and failures of the bus in words."""
        self._pending = False
        self._event.clear()
        while self._heard:
            yield self._heard.popleft()

    def wait(self, timeout: float) -> None:
        """Wait until something was heard, at most so long, s."""
        self._event.wait(max(timeout, 0.0))

    def send(self, frames: Iterable[Frame]) -> str:
        """Send frames; return what went wrong, or nothing. All of them are tried."""
        failure = ""
        for frame in frames:
            message = can.Message(
                arbitration_id=frame.id, data=frame.data, is_extended_id=frame.extended,
                is_remote_frame=frame.remote,
            )  # fmt: skip
            try:
                self._bus.send(message)
            except (can.CanError, OSError) as error:
                failure = f"frame {frame} not sent: {error}"
        return failure

    @property
    def failure(self) -> str:
        """What the interface says of its own state, where it says something."""
        return "off" if self._bus.state is can.BusState.ERROR else ""

    def close(self) -> None:
        """Close the bus and end the thread."""
        self._closing = True
        self._thread.join(5 * PATIENCE)
        self._bus.shutdown()
