"""A port on this machine at which one client at a time is served."""

import socket
from collections.abc import Callable
from typing import Generic, Protocol, TypeVar

from omniman_ros.core.errors import InputError, ParameterError
from omniman_ros.simulation.link_connection import LOOPBACK, LinkConnection, SimulationLinkError

Received = TypeVar("Received")  #: Type of an item that a client sends
Sent = TypeVar("Sent")  #: Type of what is sent to a client in one call


class Reader(Protocol[Received]):
    """Decodes items from a stream of bytes that arrive in pieces."""

    def receive(self, data: bytes) -> list[Received]:
        """Return the items that are complete now; an InputError says that these are none."""


class LinkServer(Generic[Received, Sent]):
    """Listens at a port, and exchanges items with one client at a time.

    A lost connection raises a LinkError, received bytes that are no item an InputError: both close
    the connection.

    Raises:
        ParameterError: The port is not available.
    """

    def __init__(
        self,
        name: str,
        port: int,
        make_reader: Callable[[], Reader[Received]],
        encode: Callable[[Sent], bytes],
    ) -> None:
        self._make_reader, self._encode = make_reader, encode
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        try:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            self._socket.bind((LOOPBACK, port))
            self._socket.listen(1)
            self._socket.setblocking(False)
        except OSError as error:
            self._socket.close()
            raise ParameterError(name, port, f"cannot be used: {error}") from error
        self.port = int(self._socket.getsockname()[1])  #: Number of the port
        self.refused = 0  #: Number of clients that were refused because one is connected
        self._connection: LinkConnection | None = None
        self._reader = make_reader()

    @property
    def is_connected(self) -> bool:
        """Whether a client is connected."""
        return self._connection is not None

    def accept(self) -> bool:
        """Accept a client that waits; return whether a new one is connected.

        While one is connected, others are refused.
        """
        try:
            accepted, _ = self._socket.accept()
        except OSError:
            return False
        if self.is_connected:
            self.refused += 1
            accepted.close()
            return False
        self._connection, self._reader = LinkConnection(accepted), self._make_reader()
        return True

    def receive(self) -> list[Received]:
        """Return the items that have arrived."""
        if self._connection is None:
            return []
        try:
            return self._reader.receive(self._connection.receive())
        except (SimulationLinkError, InputError):
            self.disconnect()
            raise

    def send(self, item: Sent) -> None:
        """Send to the client, if there is one."""
        if self._connection is None:
            return
        try:
            self._connection.send(self._encode(item))
        except SimulationLinkError:
            self.disconnect()
            raise

    def disconnect(self) -> None:
        """Close the connection to the client, if there is one."""
        if self._connection is not None:
            self._connection.close()
            self._connection = None

    def close(self) -> None:
        """Close the connection and the port."""
        self.disconnect()
        self._socket.close()
