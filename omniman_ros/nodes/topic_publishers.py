"""Who publishes a topic, and whether a subscription receives it."""

from collections.abc import Callable
from typing import Any

from rclpy.node import Node
from rclpy.qos import (
    DurabilityPolicy,
    QoSCompatibility,
    QoSProfile,
    ReliabilityPolicy,
    qos_check_compatible,
)
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo

from omniman_ros.core.source_monitor import SourcePublisher

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


def topic_publishers(node: Node, subscription: Subscription) -> list[SourcePublisher]:
    """Return who publishes the topic of a node's subscription, and what keeps it from being read.

    It is what the graph knows at present: names may come later than publishers.
    """
    wanted: Any = subscription.msg_type
    kind = f"{wanted.__module__.split('.')[0]}/msg/{wanted.__name__}"
    found = []
    for info in node.get_publishers_info_by_topic(subscription.topic_name):
        name = f"{info.node_namespace.rstrip('/')}/{info.node_name}"
        if info.topic_type != kind:
            mismatch = f"it is {info.topic_type}, expected {kind}"
        else:
            mismatch = qos_mismatch(info.qos_profile, subscription.qos_profile)
        found.append(SourcePublisher(name, mismatch))
    return found


def qos_mismatch(offered: QoSProfile, wanted: QoSProfile) -> str:
    """Return why a publisher's quality of service does not reach a subscription, or empty."""
    compatibility, reason = qos_check_compatible(offered, wanted)
    if compatibility != QoSCompatibility.ERROR:
        return ""
    differs = []
    is_unreliable = offered.reliability == ReliabilityPolicy.BEST_EFFORT
    if is_unreliable and wanted.reliability == ReliabilityPolicy.RELIABLE:
        differs.append("best effort, expected reliable")
    is_volatile = offered.durability == DurabilityPolicy.VOLATILE
    if is_volatile and wanted.durability == DurabilityPolicy.TRANSIENT_LOCAL:
        differs.append("volatile, expected transient local")
    return f"its quality of service is {' and '.join(differs) or reason}"
