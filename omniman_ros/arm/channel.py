"""Messages between a node and its streaming process; neither waits for the other."""

import contextlib
import pickle
import select
import socket
import struct
from collections.abc import Iterator
from typing import Any

from omniman_ros.core.errors import OmnimanError

HEADER = struct.Struct("=I")
BUFFER = 1 << 20
"""Room for messages on their way, bytes: a preview of 5,000 points takes 720 kB."""
AT_ONCE = 1 << 16


class ChannelError(OmnimanError):
    """The other side is gone, or takes nothing any more."""


class Channel:
    """One end of a pair of connected sockets; messages are Python objects of this package.

    Args:
        sock: The end.
    """

    def __init__(self, sock: socket.socket) -> None:
        sock.setblocking(False)
        for option in (socket.SO_SNDBUF, socket.SO_RCVBUF):
            sock.setsockopt(socket.SOL_SOCKET, option, BUFFER)
        self._sock = sock
        self._heard = bytearray()
        self._unsent = b""
        self._gone = ""

    def fileno(self) -> int:
        """File descriptor, to wait for messages."""
        return self._sock.fileno()

    def send(self, message: Any) -> None:
        """Send a message.

        Raises:
            ChannelError: The other side is gone, or has not read for so long that there is no
                room left.
        """
        body = pickle.dumps(message, pickle.HIGHEST_PROTOCOL)
        self._unsent += HEADER.pack(len(body)) + body
        if len(self._unsent) > 2 * BUFFER:
            raise ChannelError("the other process reads nothing any more")
        self.flush()

    def flush(self) -> None:
        """Send what there was no room for.

        Raises:
            ChannelError: The other side is gone.
        """
        try:
            if self._unsent:
                self._unsent = self._unsent[self._sock.send(self._unsent) :]
        except BlockingIOError:
            pass  # the next call sends it
        except OSError as error:
            raise ChannelError(f"the other process is gone: {error}") from error

    def receive(self) -> list[Any]:
        """Return the messages that have come.

        Raises:
            ChannelError: The other side is gone, and all that it sent has been returned.
        """
        while not self._gone:
            try:
                data = self._sock.recv(AT_ONCE)
            except BlockingIOError:
                break
            except OSError as error:
                self._gone = str(error)
                break
            self._gone = "" if data else "closed"
            self._heard += data
        messages = list(self._messages())
        if self._gone and not messages:
            raise ChannelError(f"the other process is gone: {self._gone}")
        return messages

    def _messages(self) -> Iterator[Any]:
        heard, at = self._heard, 0
        while len(heard) - at >= HEADER.size:
            (length,) = HEADER.unpack_from(heard, at)
            end = at + HEADER.size + length
            if len(heard) < end:
                break
            body = bytes(heard[at + HEADER.size : end])
            at = end
            yield pickle.loads(body)
        del heard[:at]

    def wait_and_receive(self) -> list[Any]:
        """Wait for something to come, and return the messages; errors as :meth:`receive`."""
        select.select([self._sock], [], [])
        return self.receive()

    def shut(self) -> None:
        """Tell the other side that this one is gone, and end what waits here."""
        with contextlib.suppress(OSError):
            self._sock.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """Close this end."""
        self._sock.close()
