"""Messages between a node and its streaming process; neither side waits for the other."""

import contextlib
import pickle
import select
import socket
import struct
from collections.abc import Iterator
from typing import Any

from omniman_ros.core.errors import OmnimanError

HEADER = struct.Struct("=I")  #: Header of a message: the length of its body [bytes]
#: Size of the buffers of each socket [bytes]: a preview of 5,000 points needs 720 kB
BUFFER_SIZE = 1 << 20
READ_SIZE = 1 << 16  #: Largest amount of data that one call of the socket reads [bytes]


class ProcessChannelError(OmnimanError):
    """The other process has ended, or does not read any more."""


class ProcessChannel:
    """One end, made non-blocking, of connected sockets; a message is a picklable object."""

    def __init__(self, sock: socket.socket) -> None:
        sock.setblocking(False)
        for option in (socket.SO_SNDBUF, socket.SO_RCVBUF):
            sock.setsockopt(socket.SOL_SOCKET, option, BUFFER_SIZE)
        self._sock = sock
        self._received = bytearray()
        self._unsent = b""
        self._end_reason = ""

    def fileno(self) -> int:
        """Return the file descriptor, to wait for messages with `select`."""
        return self._sock.fileno()

    def send(self, message: Any) -> None:
        """Send a message, or keep it until :meth:`flush` if the buffer is full.

        Raises:
            ProcessChannelError: The other process has ended, or has not read for so long that
                the buffer overflows.
        """
        body = pickle.dumps(message, pickle.HIGHEST_PROTOCOL)
        self._unsent += HEADER.pack(len(body)) + body
        if len(self._unsent) > 2 * BUFFER_SIZE:
            raise ProcessChannelError("the other process does not read any more")
        self.flush()

    def flush(self) -> None:
        """Send messages that did not fit before; raise ProcessChannelError at the peer's end."""
        try:
            if self._unsent:
                self._unsent = self._unsent[self._sock.send(self._unsent) :]
        except BlockingIOError:
            pass  # the next call sends it
        except OSError as error:
            raise ProcessChannelError(f"the other process has ended: {error}") from error

    def receive(self) -> list[Any]:
        """Return what has arrived; raise ProcessChannelError after the peer's last message."""
        while not self._end_reason:
            try:
                data = self._sock.recv(READ_SIZE)
            except BlockingIOError:
                break
            except OSError as error:
                self._end_reason = str(error)
                break
            self._end_reason = "" if data else "closed"
            self._received += data
        messages = list(self._complete_messages())
        if self._end_reason and not messages:
            raise ProcessChannelError(f"the other process has ended: {self._end_reason}")
        return messages

    def _complete_messages(self) -> Iterator[Any]:
        received, start = self._received, 0
        while len(received) - start >= HEADER.size:
            (length,) = HEADER.unpack_from(received, start)
            end = start + HEADER.size + length
            if len(received) < end:
                break
            body = bytes(received[start + HEADER.size : end])
            start = end
            yield pickle.loads(body)
        del received[:start]

    def wait_and_receive(self) -> list[Any]:
        """Wait for messages, and return them; errors as in :meth:`receive`."""
        select.select([self._sock], [], [])
        return self.receive()

    def shut_down(self) -> None:
        """Signal the end to the other process, and wake a thread that waits at this end."""
        with contextlib.suppress(OSError):
            self._sock.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """Close this end."""
        self._sock.close()
