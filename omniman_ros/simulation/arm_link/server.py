"""The world's end of the link: it listens, and serves one arm controller at a time."""

from omniman_ros.core.errors import InputError
from omniman_ros.simulation.arm_link.frames import (
    ArmSetpoint,
    ArmState,
    SetpointReader,
    encode_state,
)
from omniman_ros.simulation.link_connection import LinkConnection, LinkError, LinkListener


class ArmLinkServer:
    """Receives setpoints from a controller, and sends it the state of the joints.

    Args:
        port: TCP port on this machine; any free one if 0.

    Attributes:
        port: Number of the port.

    Raises:
        ParameterError: The port is not available.
    """

    def __init__(self, port: int) -> None:
        self._listener = LinkListener("arm_port", port)
        self.port = self._listener.port
        self._connection: LinkConnection | None = None
        self._reader = SetpointReader()

    @property
    def refused(self) -> int:
        """Number of controllers that were refused because one is connected."""
        return self._listener.refused

    @property
    def is_connected(self) -> bool:
        """Whether a controller is connected."""
        return self._connection is not None

    def accept(self) -> bool:
        """Accept a controller that waits; return whether a new one is connected.

        Where one is connected already, others are turned away.
        """
        accepted = self._listener.accept(refuse=self.is_connected)
        if accepted is None:
            return False
        self._connection, self._reader = accepted, SetpointReader()
        return True

    def receive(self) -> list[ArmSetpoint]:
        """Return the setpoints that have arrived.

        Raises:
            LinkError: The connection is lost, and closed.
            InputError: What has arrived is not a setpoint; the connection is closed.
        """
        if self._connection is None:
            return []
        try:
            return self._reader.receive(self._connection.receive())
        except (LinkError, InputError):
            self.disconnect()
            raise

    def send(self, state: ArmState) -> None:
        """Send a state to the controller, if there is one.

        Raises:
            LinkError: The connection is lost, and closed.
        """
        if self._connection is None:
            return
        try:
            self._connection.send(encode_state(state))
        except LinkError:
            self.disconnect()
            raise

    def disconnect(self) -> None:
        """Close the connection to the controller, if there is one."""
        if self._connection is not None:
            self._connection.close()
            self._connection = None

    def close(self) -> None:
        """Close the connection and the port."""
        self.disconnect()
        self._listener.close()
