"""CAN bus of python-can, with a thread that reports received frames."""

import select
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from typing import Any, Protocol

import can

from omniman_ros.can_drives.frame import CanFrame
from omniman_ros.can_drives.reception import enlarge_receive_buffer, is_invalid_frame
from omniman_ros.core.can_parameters import CanParameters
from omniman_ros.core.errors import OmnimanError

BUS_OFF_FLAG = 0x040  #: Flag in the id of SocketCAN's error frames that reports bus-off
#: Longest time for which a read of the thread waits, which bounds the time of closing [s]
READ_TIMEOUT = 0.1
#: Largest number of frames processed at once: a flood must not delay the periods
MAX_TAKEN_FRAMES = 256

CLOSED = "closed"  #: Failure of a bus that was closed


class BusError(OmnimanError):
    """The bus cannot be opened; the message names the bus and the reason."""


class Bus(Protocol):
    """A bus as the bridge uses it."""

    invalid: int  #: Number of received items that were not classic CAN frames

    def take(self) -> Iterator[CanFrame | str]:
        """Yield received frames, or descriptions of bus failures."""

    def wait(self, timeout: float) -> None:
        """Wait for a frame, up to `timeout` seconds."""

    def send(self, frames: Iterable[CanFrame]) -> str:
        """Send all frames, even if one fails; return the last failure, or an empty string."""

    @property
    def failure(self) -> str:
        """Failure of the bus, or an empty string."""

    def close(self) -> None:
        """Close the bus."""


class CanBus(Bus):
    """A bus of python-can.

    If the interface has a file descriptor (socketcan, udp_multicast, serial lines), a thread waits
    until it is readable and :meth:`take` reads the frames; otherwise the thread reads them.

    Args:
        wake: Called from the thread when frames have arrived, after which :meth:`take` must be
            called; None if there is nothing to call.

    Raises:
        BusError: The bus cannot be opened.
    """

    def __init__(self, p: CanParameters, wake: Callable[[], None] | None = None) -> None:
        options: dict[str, Any] = {"interface": p.interface, "channel": p.channel}
        if p.interface == "udp_multicast":
            options |= {"port": p.port, "hop_limit": 0, "fd": False}
        elif p.interface != "virtual":
            options["bitrate"] = p.bitrate
        try:
            self._bus = can.Bus(**options)
            if p.interface == "udp_multicast":
                enlarge_receive_buffer(self._bus)
        except Exception as error:  # each back end of python-can raises its own errors
            reason = str(error) or type(error).__name__
            raise BusError(f"bus {p.interface} {p.channel} cannot be opened: {reason}") from error
        self._wake = wake
        self._received: deque[CanFrame | str] = deque()
        self._event = threading.Event()
        self._closing = threading.Event()
        self.invalid = 0
        try:
            self._socket = self._bus.fileno()
        except NotImplementedError:
            self._socket = -1
        target = self._read if self._socket < 0 else self._watch
        self._thread = threading.Thread(target=target, name="can", daemon=True)
        if wake is not None or self._socket < 0:
            self._thread.start()

    def _watch(self) -> None:
        """Wake the receiver when there are frames, and wait until it has read them."""
        while not self._closing.is_set():
            try:
                ready = select.select([self._socket], [], [], READ_TIMEOUT)[0]
            except (OSError, ValueError):  # closed
                return
            if ready:
                self._event.clear()
                self._call_wake()
                self._event.wait(READ_TIMEOUT)

    def _read(self) -> None:
        """Read from an interface without a file descriptor, and wake the receiver."""
        while not self._closing.is_set():
            item = self._receive(READ_TIMEOUT)
            if item is not None:
                self._received.append(item)
                self._event.set()
                self._call_wake()
                if isinstance(item, str):
                    self._closing.wait(READ_TIMEOUT)

    def _call_wake(self) -> None:
        if self._wake is not None:
            self._wake()

    def _receive(self, timeout: float) -> CanFrame | str | None:
        """Return a frame, the description of a bus failure, or None if there is neither."""
        try:
            message = self._bus.recv(timeout)
        except Exception as error:  # each back end of python-can raises its own errors
            if is_invalid_frame(error):
                self.invalid += 1
                return None
            return f"cannot be read: {str(error) or type(error).__name__}"
        if message is None:
            return None
        number = int(message.arbitration_id)  # over UDP it can be of any type
        if message.is_error_frame:
            return "off (error frame)" if number & BUS_OFF_FLAG else None
        if message.is_fd:
            self.invalid += 1
            return None
        return CanFrame(
            number,
            bytes(message.data),
            bool(message.is_extended_id),
            bool(message.is_remote_frame),
        )

    def take(self) -> Iterator[CanFrame | str]:
        """Yield up to :data:`MAX_TAKEN_FRAMES` received frames, or descriptions of bus failures.

        After a failure, the remaining frames wait until the thread wakes the receiver again. A
        bus that is closed has none.
        """
        if self._closing.is_set():
            return
        if self._socket < 0:
            self._event.clear()
            for _ in range(min(len(self._received), MAX_TAKEN_FRAMES)):
                yield self._received.popleft()
            if self._received:
                self._event.set()
            return
        for _ in range(MAX_TAKEN_FRAMES):
            if not select.select([self._socket], [], [], 0.0)[0]:
                break
            item = self._receive(0.0)
            if item is not None:
                yield item
            if isinstance(item, str):
                return  # the thread waits before it wakes the receiver again
        self._event.set()

    def wait(self, timeout: float) -> None:
        """Wait for a frame, up to `timeout` seconds."""
        if self._closing.is_set():
            time.sleep(max(timeout, 0.0))
        elif self._socket < 0:
            self._event.wait(max(timeout, 0.0))
        else:
            select.select([self._socket], [], [], max(timeout, 0.0))

    def send(self, frames: Iterable[CanFrame]) -> str:
        """Send all frames, even if one fails; return the last failure, or an empty string."""
        if self._closing.is_set():
            return CLOSED
        failure = ""
        for frame in frames:
            message = can.Message(
                arbitration_id=frame.id,
                data=frame.data,
                is_extended_id=frame.extended,
                is_remote_frame=frame.remote,
            )
            try:
                self._bus.send(message)
            except (can.CanError, OSError) as error:
                failure = f"frame {frame} not sent: {error}"
        return failure

    @property
    def failure(self) -> str:
        """Failure that the interface reports, or an empty string."""
        if self._closing.is_set():
            return CLOSED
        try:
            return "off" if self._bus.state is can.BusState.ERROR else ""
        except NotImplementedError:
            return ""
        except (can.CanError, OSError) as error:
            return f"does not report its state: {error}"

    def close(self) -> None:
        """Close the bus and end the thread; its descriptor may be that of another file then."""
        if self._closing.is_set():
            return
        self._closing.set()
        self._event.set()
        if self._thread.is_alive():
            self._thread.join(5 * READ_TIMEOUT)
        self._bus.shutdown()
