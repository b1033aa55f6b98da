"""Publishers of another type than a node reads: the middleware matches none, and says nothing."""

from collections.abc import Callable
from typing import Any

from rclpy.node import Node
from rclpy.topic_endpoint_info import TopicEndpointInfo

#: Name of the node of an endpoint that is in the graph before its node is, or has none
UNKNOWN = "_NODE_NAME_UNKNOWN_"


class ForeignTypes:
    """Warns, once for each publisher, that a topic which a node reads is published otherwise.

    Attributes:
        selectors: Parameters that select the type of a topic, by the topic's name in the node.
    """

    def __init__(self, node: Node, warn: Callable[[str, str], None]) -> None:
        self._node, self._warn = node, warn
        self._named: set[bytes] = set()
        self.selectors: dict[str, str] = {}

    def check(self) -> None:
        """Look for such publishers in the graph; once a second is often enough."""
        read: dict[str, set[str]] = {}
        for subscription in self._node.subscriptions:
            kinds = read.setdefault(subscription.topic_name, set())
            kinds.add(_type_name(subscription.msg_type))
        # The types of all topics at once: only where they differ are the publishers looked up.
        found = {
            bytes(info.endpoint_gid): (topic, info)
            for topic, types in self._node.get_topic_names_and_types()
            if topic in read and not read[topic].issuperset(types)
            for info in self._node.get_publishers_info_by_topic(topic)
            if info.topic_type not in read[topic]
        }
        for endpoint in found.keys() - self._named:
            topic, info = found[endpoint]
            self._warn(
                f"{topic} type",
                f"{topic}: {_publisher(info)} publishes {info.topic_type}, and nothing of it is "
                f"received: this node reads {' and '.join(sorted(read[topic]))}"
                f"{self._hint(topic)}",
            )
        self._named = set(found)

    def _hint(self, topic: str) -> str:
        """Return what selects the type of a topic, as the end of a sentence."""
        for name, parameter in self.selectors.items():
            if self._node.resolve_topic_name(name) == topic:
                return f"; the parameter {parameter} selects the type"
        return ""


def _publisher(info: TopicEndpointInfo) -> str:
    """Return the full name of the node of a publisher, if it is known."""
    if info.node_name == UNKNOWN:
        return "somebody"
    return f"{info.node_namespace.rstrip('/')}/{info.node_name}"


def _type_name(kind: Any) -> str:
    """Return the name of a message type, such as `geometry_msgs/msg/Twist`."""
    package, interface, *_ = kind.__module__.split(".")
    return f"{package}/{interface}/{kind.__name__}"
