"""Who publishes a topic, and whether a subscription receives it."""

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

from omniman_ros.core.source_monitor import SourcePublisher


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
