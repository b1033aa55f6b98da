"""A bus of python-can, and the thread that receives its frames."""

import threading
import time
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from omniman_ros.can_drives.reception import enlarge_receive_buffer, is_invalid_frame
from omniman_ros.core.can_parameters import CanParameters
from omniman_ros.core.errors import ParameterError

if TYPE_CHECKING:  # needs python-can, which is optional
    import can

#: Time that the receiver waits for a frame, or after an error of the bus [s]
RECEIVE_TIMEOUT = 0.1
MAX_FRAME_AGE = 1.0  #: Largest age of a frame that is believed [s]


def open_bus(parameters: CanParameters) -> "can.BusABC":
    """Open the bus of an installation; raise ParameterError if that is impossible."""
    import can

    multicast = parameters.interface == "udp_multicast"
    more: dict[str, Any] = (
        {"port": parameters.port, "hop_limit": 0} if multicast else {"bitrate": parameters.bitrate}
    )
    try:
        bus = can.Bus(interface=parameters.interface, channel=parameters.channel, **more)
        if multicast:
            enlarge_receive_buffer(bus)
        return bus
    except (can.CanError, OSError, ValueError, NotImplementedError, ImportError) as error:
        raise ParameterError("can.interface", parameters.interface, str(error)) from error


def frame_age(message: "can.Message") -> float:
    """Return how long ago a frame arrived [s]; 0 if the bus does not report it.

    On a busy machine a process and its frames may wait: drives that considered the frames late
    would stop, which real drives would not.
    """
    age: float = time.time() - message.timestamp
    return age if 0.0 <= age <= MAX_FRAME_AGE else 0.0


class CanReceiver:
    """Receives the frames of a bus in a thread, until :meth:`close`.

    Attributes:
        received: Received frames, the oldest first; the caller takes them out.
        errors: The last error of reception, unless the caller has taken it out.
    """

    def __init__(self, bus: "can.BusABC", on_received: Callable[[], None]) -> None:
        self._bus, self._on_received = bus, on_received
        self.received: deque[can.Message] = deque()
        self.errors: deque[str] = deque(maxlen=1)
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._receive_frames, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread."""
        self._closing.set()
        self._thread.join(2.0 * RECEIVE_TIMEOUT + 1.0)

    def _receive_frames(self) -> None:
        while not self._closing.is_set():
            try:
                message = self._bus.recv(RECEIVE_TIMEOUT)
                normalized = None if message is None else _normalized(message)
            except Exception as error:  # over UDP a frame can hold anything
                self.errors.append(str(error))
                if not is_invalid_frame(error):
                    self._closing.wait(RECEIVE_TIMEOUT)
                continue
            if normalized is None:
                continue
            first = not self.received
            self.received.append(normalized)
            if first and not self._closing.is_set():
                self._on_received()


def _normalized(message: "can.Message") -> "can.Message":
    """Return a message with fields of the proper types; raise an error if that is impossible."""
    import can

    return can.Message(
        timestamp=float(message.timestamp),
        arbitration_id=int(message.arbitration_id),
        is_extended_id=bool(message.is_extended_id),
        is_remote_frame=bool(message.is_remote_frame),
        is_error_frame=bool(message.is_error_frame),
        data=bytes(message.data),
        check=True,
    )
