"""The drives' end of the stream: it listens, and serves one host at a time."""

from collections.abc import Iterable

from omniman_ros.core.errors import InputError
from omniman_ros.simulation.can_link.records import Record, RecordReader, encode
from omniman_ros.simulation.link_connection import LinkConnection, LinkError, LinkListener


class CanLinkServer:
    """Exchanges records with the host of a simulated bus.

    Args:
        port: TCP port on this machine; any free one if 0.

    Attributes:
        port: Number of the port.

    Raises:
        ParameterError: The port is not available.
    """

    def __init__(self, port: int) -> None:
        self._listener = LinkListener("bus_port", port)
        self.port = self._listener.port
        self._connection: LinkConnection | None = None
        self._reader = RecordReader()

    @property
    def is_connected(self) -> bool:
        """Whether a host is connected."""
        return self._connection is not None

    @property
    def refused(self) -> int:
        """Number of hosts that were refused because one is connected."""
        return self._listener.refused

    def accept(self) -> bool:
        """Accept a host that waits; return whether a new one is connected.

        Where one is connected already, others are turned away.
        """
        accepted = self._listener.accept(refuse=self.is_connected)
        if accepted is None:
            return False
        self._connection, self._reader = accepted, RecordReader()
        return True

    def receive(self) -> list[Record]:
        """Return the records that have arrived.

        Raises:
            LinkError: The connection is lost, and closed.
            InputError: What has arrived is not a record; the connection is closed.
        """
        if self._connection is None:
            return []
        try:
            return self._reader.receive(self._connection.receive())
        except (LinkError, InputError):
            self.disconnect()
            raise

    def send(self, records: Iterable[Record]) -> None:
        """Send records to the host, if there is one.

        Raises:
            LinkError: The connection is lost, and closed.
        """
        if self._connection is None:
            return
        data = b"".join(map(encode, records))
        try:
            self._connection.send(data)
        except LinkError:
            self.disconnect()
            raise

    def disconnect(self) -> None:
        """Close the connection to the host, if there is one."""
        if self._connection is not None:
            self._connection.close()
            self._connection = None

    def close(self) -> None:
        """Close the connection and the port."""
        self.disconnect()
        self._listener.close()
