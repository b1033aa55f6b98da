"""The nodes that move something, found in the graph by their stop_state, and called together."""

from collections.abc import Callable
from typing import Any

from rclpy.node import Node
from std_srvs.srv import Trigger

TRIGGER = "std_srvs/srv/Trigger"
STOP_STATE = "stop_state"
STATE_TYPE = "diagnostic_msgs/msg/DiagnosticStatus"


def nodes_that_move(node: Node, namespace: str = "") -> list[str]:
    """Full names of nodes that publish stop_state, in the graph as it is known now.

    Args:
        node: Whose view of the graph.
        namespace: Only in and below this one.
    """
    inside = f"/{namespace.strip('/')}/" if namespace.strip("/") else "/"
    topics = [
        topic
        for topic, types in node.get_topic_names_and_types()
        if topic.endswith(f"/{STOP_STATE}") and STATE_TYPE in types
    ]
    names = {
        f"{info.node_namespace.rstrip('/')}/{info.node_name}"
        for topic in topics
        for info in node.get_publishers_info_by_topic(topic)
    }
    return sorted(name for name in names if name.startswith(inside))


def has_service(node: Node, service: str) -> bool:
    """Whether a Trigger service is in the graph."""
    return (service, [TRIGGER]) in node.get_service_names_and_types()


class Calls:
    """Calls one service of each node that moves something, as they are found.

    Args:
        node: Who calls.
        action: "stop" or "reset".
        namespace: Only nodes in it.
        on_answer: Called with the node's name, success and message as each answer comes.

    Attributes:
        answers: Full node name to success and message, or None while there is no answer.
    """

    def __init__(
        self, node: Node, action: str, namespace: str = "",
        on_answer: Callable[[str, bool, str], None] = lambda name, good, text: None,
    ) -> None:  # fmt: skip
        self._node = node
        self._action = action
        self._namespace = namespace
        self._on_answer = on_answer
        self._clients: list[Any] = []
        self._futures: dict[str, Any] = {}
        self.answers: dict[str, tuple[bool, str] | None] = {}

    def look(self) -> bool:
        """Call the nodes that are new in the graph; True if all that are known have answered."""
        for name in nodes_that_move(self._node, self._namespace):
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
        """Give the clients back; what has not answered yet is not heard."""
        for client in self._clients:
            self._node.destroy_client(client)
        self._clients.clear()
