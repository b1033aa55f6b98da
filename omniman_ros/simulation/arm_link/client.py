"""The controller's end of the link."""

import socket

from omniman_ros.core.errors import InputError
from omniman_ros.simulation.arm_link.frames import (
    ArmSetpoint,
    ArmState,
    StateReader,
    encode_setpoint,
)
from omniman_ros.simulation.link_connection import LOOPBACK, LinkConnection, SimulationLinkError

CONNECT_TIMEOUT = 0.02  #: Longest time for connecting [s], during which the caller is blocked


class ArmLinkClient:
    """Sends setpoints to the joints in a world, and receives their state."""

    def __init__(self, port: int) -> None:
        self._port = port
        self._connection: LinkConnection | None = None
        self._reader = StateReader()
        self.failure = "not connected yet"  #: Why there is no connection; empty while there is one

    @property
    def is_open(self) -> bool:
        """Whether there is a connection."""
        return self._connection is not None

    def open(self) -> bool:
        """Try to connect; return whether that succeeded."""
        try:
            connected = socket.create_connection((LOOPBACK, self._port), CONNECT_TIMEOUT)
        except OSError as error:
            self.failure = f"no world at port {self._port}: {error}"
            return False
        self._connection, self._reader, self.failure = LinkConnection(connected), StateReader(), ""
        return True

    def receive(self) -> list[ArmState]:
        """Return the states that have arrived; none if there is no connection (any more)."""
        if self._connection is None:
            return []
        try:
            return self._reader.receive(self._connection.receive())
        except (SimulationLinkError, InputError) as error:
            self.close(str(error))
            return []

    def send(self, setpoint: ArmSetpoint) -> None:
        """Send a setpoint, if there is a connection."""
        if self._connection is None:
            return
        try:
            self._connection.send(encode_setpoint(setpoint))
        except SimulationLinkError as error:
            self.close(str(error))

    def wait(self, timeout: float) -> bool:
        """Wait until something has arrived, up to `timeout` [s]; return whether it has."""
        return self._connection is None or self._connection.wait(timeout)

    def close(self, reason: str) -> None:
        """Close the connection, if there is one, for a reason."""
        if self._connection is not None:
            self._connection.close()
            self._connection, self.failure = None, reason
