"""Publish where sensors are mounted, on /tf_static."""

from collections.abc import Sequence

from geometry_msgs.msg import TransformStamped
from rclpy.qos import DurabilityPolicy, QoSProfile

from omniman_ros.nodes.omniman_node import OmnimanNode

try:
    from tf2_msgs.msg import TFMessage
except ImportError:  # not among the wheels on PyPI
    TFMessage = None

STATIC = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""Quality of service of /tf_static."""


class StaticTransforms:
    """Publishes transforms that hardly ever change; does nothing where tf2_msgs is missing.

    Args:
        node: Node that owns the publisher.
        parameters: Parameters that have the same poses, for the note that /tf_static is off.
    """

    def __init__(self, node: OmnimanNode, parameters: str) -> None:
        self._publisher = None
        if TFMessage is None:
            node.get_logger().info(
                f"tf2_msgs is not installed: /tf_static is off, {parameters} have the poses"
            )
        else:
            self._publisher = node.create_publisher(TFMessage, "/tf_static", STATIC)

    def publish(self, transforms: Sequence[TransformStamped]) -> None:
        """Publish all transforms, which replace those that were published before."""
        if self._publisher is not None:
            self._publisher.publish(TFMessage(transforms=list(transforms)))
