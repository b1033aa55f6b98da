"""Services of the running robot: those of its nodes, and the dashboard of the arm's controller."""

import socket
from collections.abc import Callable
from typing import Any

from rcl_interfaces.srv import SetParameters
from rclpy.node import Node
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

from omniman_ros.console.errors import CommandError

SERVICE_TIMEOUT = 10.0  #: longest time for the answer of a service [s]
CALLS = 3  #: number of calls of a service that does not answer


class RobotServices:
    """Clients of the services of the robot's nodes."""

    def __init__(self, node: Node, wait: Callable[[Callable[[], bool], float], bool]) -> None:
        self._node, self._wait = node, wait
        self._clients: dict[str, Any] = {}
        self.unanswered: list[str] = []

    def trigger(self, node: str, action: str) -> None:
        """Call a Trigger service of a node if it is there, without waiting for the answer."""
        client = self._client(Trigger, f"{node}/{action}")
        if client.service_is_ready():
            client.call_async(Trigger.Request())

    def connect(self, node: str, action: str) -> None:
        """Wait until a Trigger service of a node can be called."""
        client = self._client(Trigger, f"{node}/{action}")
        if not self._wait(client.service_is_ready, SERVICE_TIMEOUT):
            raise CommandError(f"{node}/{action} is not there")

    def _client(self, kind: type, service: str) -> Any:
        """Return a client, which is kept."""
        if service not in self._clients:
            self._clients[service] = self._node.create_client(kind, service)
        return self._clients[service]

    def set_parameter(self, node: str, name: str, value: bool | float | tuple[str, ...]) -> None:
        """Set a parameter of a node."""
        service = f"{node}/set_parameters"
        client = self._client(SetParameters, service)
        if not self._wait(client.service_is_ready, SERVICE_TIMEOUT):
            raise CommandError(f"{service} is not there")
        kind = Parameter.Type.STRING_ARRAY if isinstance(value, tuple) else None
        listed = list(value) if isinstance(value, tuple) else value
        parameter = (
            Parameter(name, kind, listed) if kind is not None else Parameter(name, value=listed)
        )
        request = SetParameters.Request(parameters=[parameter.to_parameter_msg()])
        for _ in range(CALLS):
            future = client.call_async(request)
            if self._wait(future.done, SERVICE_TIMEOUT):
                break
            self.unanswered.append(service)
        else:
            raise CommandError(f"{service} does not answer")
        answer = future.result().results[0]
        if not answer.successful:
            raise CommandError(f"{node}: {name} is refused: {answer.reason}")


def send_to_dashboard(port: int, command: str) -> None:
    """Send a command to the dashboard of the simulated arm's controller."""
    try:
        with socket.create_connection(("127.0.0.1", port), SERVICE_TIMEOUT) as connection:
            connection.recv(1024)  # its greeting
            connection.sendall(f"{command}\n".encode())
            connection.recv(1024)
    except OSError as error:
        raise CommandError(f"dashboard: {error}") from error
