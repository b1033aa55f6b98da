"""The world's end of the link: it listens, and serves one arm controller at a time."""

import socket

from omniman_ros.core.errors import InputError, ParameterError
from omniman_ros.simulation.arm_link.connection import LOOPBACK, LinkConnection, LinkError
from omniman_ros.simulation.arm_link.frames import (
    ArmSetpoint,
    ArmState,
    SetpointReader,
    encode_state,
)


class ArmLinkServer:
    """Receives setpoints from a controller, and sends it the state of the joints.

    Args:
        port: TCP port on this machine; any free one if 0.

    Attributes:
        port: Number of the port.
        refused: Number of controllers that were refused because one is connected.

    Raises:
        ParameterError: The port is not available.
    """

    def __init__(self, port: int) -> None:
        self._listening = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        try:
            self._listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            self._listening.bind((LOOPBACK, port))
            self._listening.listen(1)
            self._listening.setblocking(False)
        except OSError as error:
            self._listening.close()
            raise ParameterError("arm_port", port, f"cannot be used: {error}") from error
        self.port = int(self._listening.getsockname()[1])
        self.refused = 0
        self._connection: LinkConnection | None = None
        self._reader = SetpointReader()

    @property
    def is_connected(self) -> bool:
        """Whether a controller is connected."""
        return self._connection is not None

    def accept(self) -> bool:
        """Accept a controller that waits; return whether a new one is connected.

        Where one is connected already, others are turned away.
        """
        try:
            accepted, _ = self._listening.accept()
        except OSError:
            return False
        if self._connection is not None:
            self.refused += 1
            accepted.close()
            return False
        self._connection, self._reader = LinkConnection(accepted), SetpointReader()
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
        self._listening.close()
