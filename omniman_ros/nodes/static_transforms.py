"""Publish transforms that hold for ever, on /tf_static."""

from collections.abc import Sequence

from geometry_msgs.msg import TransformStamped

from omniman_ros.nodes import tf_messages
from omniman_ros.nodes.omniman_node import OmnimanNode


class StaticTransforms:
    """Publishes transforms that hardly ever change; does nothing where tf2_msgs is missing."""

    def __init__(self, node: OmnimanNode, parameters: str) -> None:
        self._publisher = None
        if tf_messages.TFMessage is None:
            node.get_logger().info(
                f"tf2_msgs is not installed: /tf_static is off, {parameters} have the poses"
            )
        else:
            self._publisher = node.create_publisher(
                tf_messages.TFMessage, tf_messages.STATIC_TOPIC, tf_messages.STATIC_PUBLISHER
            )

    def publish(self, transforms: Sequence[TransformStamped]) -> None:
        """Publish all transforms, which replace those that were published before."""
        if self._publisher is not None:
            self._publisher.publish(tf_messages.TFMessage(transforms=list(transforms)))
