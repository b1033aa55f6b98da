"""Find the nodes that have a stop state, and call one service of all of them."""

from collections.abc import Callable
from typing import Any

from rclpy.node import Node
from std_srvs.srv import Trigger

from omniman_ros.nodes.stop_interface import STOP_STATE, publisher_nodes

_TRIGGER_TYPE = "std_srvs/srv/Trigger"
_STOP_STATE_TYPE = "diagnostic_msgs/msg/DiagnosticStatus"


def find_stoppable_nodes(node: Node, namespace: str = "") -> list[str]:
    """Return the full names of nodes in or below a namespace that publish a stop state."""
    prefix = f"/{namespace.strip('/')}/" if namespace.strip("/") else "/"
    topics = [
        topic
        for topic, types in node.get_topic_names_and_types()
        if topic.endswith(f"/{STOP_STATE}") and _STOP_STATE_TYPE in types
    ]
    names = {name for topic in topics for name in publisher_nodes(node, topic)}
    return sorted(name for name in names if name.startswith(prefix))


def has_service(node: Node, service: str) -> bool:
    """Return whether a Trigger service is in the graph as `node` sees it."""
    return (service, [_TRIGGER_TYPE]) in node.get_service_names_and_types()


class TriggerCalls:
    """Calls one Trigger service of each node that has a stop state, as the nodes are found.

    Attributes:
        answers: Success and message by full node name; None while there is no answer.
    """

    def __init__(
        self,
        node: Node,
        action: str,
        namespace: str = "",
        on_answer: Callable[[str, bool, str], None] = lambda name, success, message: None,
    ) -> None:
        self._node = node
        self._action = action
        self._namespace = namespace
        self._on_answer = on_answer
        self._clients: list[Any] = []
        self._futures: dict[str, Any] = {}
        self.answers: dict[str, tuple[bool, str] | None] = {}

    def poll(self) -> bool:
        """Call the nodes that are new in the graph; return whether all have answered."""
        for name in find_stoppable_nodes(self._node, self._namespace):
            service = f"{name}/{self._action}"
            if name in self.answers or not has_service(self._node, service):
                continue
            client = self._node.create_client(Trigger, service)
            if not client.service_is_ready():
                self._node.destroy_client(client)
                continue
            self._clients.append(client)
            self._futures[name] = client.call_async(Trigger.Request())
            self.answers[name] = None
        for name, future in self._futures.items():
            if future.done() and self.answers[name] is None:
                answer = future.result()
                self.answers[name] = (answer.success, answer.message)
                self._on_answer(name, answer.success, answer.message)
        return all(answer is not None for answer in self.answers.values())

    def close(self) -> None:
        """Destroy the clients; answers that are still missing are lost."""
        for client in self._clients:
            self._node.destroy_client(client)
        self._clients.clear()
