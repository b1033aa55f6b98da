"""The bus itself: python-can, and a thread that tells when there is something to hear."""

import select
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import can

from omniman_ros.can_drive.frame import Frame
from omniman_ros.core.can_parameters import CanParameters
from omniman_ros.core.errors import OmnimanError

BUS_OFF = 0x040
"""Flag of SocketCAN's error frames: the controller is off the bus."""
PATIENCE = 0.1
"""How long one read of the thread waits, s: so long does closing take at most."""
MOST = 256
"""Frames that are taken at once: a flood must not keep the periods from being done."""


class BusError(OmnimanError):
    """The bus cannot be opened; the message says which and why."""


class CanBus:
    """A bus of python-can.

    Where the interface has a file descriptor (socketcan, udp_multicast, serial lines) a thread
    waits for it and the frames are read by whoever takes them; else the thread reads.

    Args:
        p: Interface, channel and bit rate.
        wake: Called from the thread when there is something to take; :meth:`take` must follow.
            None if nobody is to be woken.

    Raises:
        BusError: It cannot be opened.
    """

    def __init__(self, p: CanParameters, wake: Callable[[], None] | None = None) -> None:
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
        self._closing = threading.Event()
        self.garbage = 0
        try:
            self._socket = self._bus.fileno()
        except NotImplementedError:
            self._socket = -1
        reader = self._read if self._socket < 0 else self._watch
        self._thread = threading.Thread(target=reader, name="can", daemon=True)
        if wake is not None or self._socket < 0:
            self._thread.start()

    # ---- the thread: it wakes, and reads where there is nothing to wait for --------------------

    def _watch(self) -> None:
        """Wake whoever takes frames when there are some, and wait until they are taken."""
        while not self._closing.is_set():
            try:
                ready = select.select([self._socket], [], [], PATIENCE)[0]
            except (OSError, ValueError):  # closed
                return
            if ready:
                self._event.clear()
                self._call()
                self._event.wait(PATIENCE)

    def _read(self) -> None:
        """Read, from an interface that cannot be waited for otherwise."""
        while not self._closing.is_set():
            item = self._receive(PATIENCE)
            if item is not None:
                self._heard.append(item)
                self._event.set()
                self._call()
                if isinstance(item, str):
                    self._closing.wait(PATIENCE)

    def _call(self) -> None:
        if self._wake is not None:
            self._wake()

    # ---- receiving ------------------------------------------------------------------------------

    def _receive(self, timeout: float) -> Frame | str | None:
        """A frame, a failure of the bus in words, or None: nothing that counts."""
        try:
            message = self._bus.recv(timeout)
        except Exception as error:  # each back end of python-can raises what its library does
            if _is_nonsense(error):
                self.garbage += 1
                return None
            return f"cannot be read: {str(error) or type(error).__name__}"
        if message is None:
            return None
        number = int(message.arbitration_id)  # UDP brings whatever somebody has packed
        if message.is_error_frame:
            return "off (error frame)" if number & BUS_OFF else None
        if message.is_fd:
            self.garbage += 1
            return None
        return Frame(
            number, bytes(message.data), bool(message.is_extended_id),
            bool(message.is_remote_frame),
        )  # fmt: skip

    def take(self) -> Iterator[Frame | str]:
        """Yield what was heard, :data:`MOST` at once: frames, and failures of the bus in words."""
        if self._socket < 0:
            self._event.clear()
            for _ in range(min(len(self._heard), MOST)):
                yield self._heard.popleft()
            if self._heard:
                self._event.set()
            return
        for _ in range(MOST):
            if not select.select([self._socket], [], [], 0.0)[0]:
                break
            item = self._receive(0.0)
            if item is not None:
                yield item
            if isinstance(item, str):
                return  # the thread waits before it wakes anybody again
        self._event.set()

    def wait(self, timeout: float) -> None:
        """Wait until something was heard, at most so long, s."""
        if self._socket < 0:
            self._event.wait(max(timeout, 0.0))
        else:
            select.select([self._socket], [], [], max(timeout, 0.0))

    # ---- sending --------------------------------------------------------------------------------

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
        try:
            return "off" if self._bus.state is can.BusState.ERROR else ""
        except NotImplementedError:
            return ""
        except (can.CanError, OSError) as error:
            return f"does not tell its state: {error}"

    def close(self) -> None:
        """Close the bus and end the thread."""
        self._closing.set()
        self._event.set()
        if self._thread.is_alive():
            self._thread.join(5 * PATIENCE)
        self._bus.shutdown()


def _is_nonsense(error: Exception) -> bool:
    """Whether what was read was no frame; else the bus itself cannot be read."""
    if isinstance(error, OSError):
        return False
    if isinstance(error, can.CanError):
        return error.__cause__ is not None and not isinstance(error.__cause__, OSError)
    return True
