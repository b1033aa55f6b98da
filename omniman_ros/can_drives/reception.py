"""Reception from a bus of python-can: the buffer over UDP multicast, and errors of reading.

A bus over UDP drops what arrives while its buffer is full.
"""

import os
import socket
from typing import Protocol

#: Size of the receive buffer that is asked for [bytes].
#: The 104 KiB that Linux grants unasked hold 256 frames: those of 0.2 s, if four drives answer 100
#: times a second. A process that waits longer for a core, as on a busy machine, lost frames. Up to
#: `net.core.rmem_max` is granted.
RECEIVE_BUFFER = 1 << 20


class HasSocket(Protocol):
    """A bus with a socket, as those of python-can over UDP."""

    def fileno(self) -> int:
        """Return the descriptor of the socket."""


def enlarge_receive_buffer(bus: HasSocket) -> None:
    """Have a bus over UDP keep the frames that arrive while its reader waits for a core."""
    # A second descriptor of the same socket: the first one remains that of the bus.
    with socket.socket(fileno=os.dup(bus.fileno())) as own:
        own.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)


def is_invalid_frame(error: Exception) -> bool:
    """Return whether a received item was no frame; otherwise the bus itself cannot be read."""
    import can

    if isinstance(error, can.CanError):
        return error.__cause__ is not None and not isinstance(error.__cause__, OSError)
    return not isinstance(error, OSError)
