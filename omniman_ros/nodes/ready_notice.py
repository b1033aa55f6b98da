"""The line by which a person at the terminal learns that the robot can be driven."""

from omniman_ros.control.platform import PlatformController
from omniman_ros.nodes.omniman_node import OmnimanNode


class ReadyNotice:
    """Logs, once, that a platform controller is ready to drive, and by what.

    Args:
        node: Node of the controller, with the parameter `cmd_vel_stamped`.
    """

    def __init__(self, node: OmnimanNode, core: PlatformController) -> None:
        self._node, self._core = node, core
        self._is_logged = False

    def check(self) -> None:
        """Log it if it is due; call this once a tick."""
        if self._is_logged or not self._core.is_ready(self._node.now()):
            return
        self._is_logged = True
        topic = self._node.resolve_topic_name("cmd_vel")
        kind = "TwistStamped" if self._node.get_parameter("cmd_vel_stamped").value else "Twist"
        self._node.get_logger().info(
            f"ready: drive with {topic} (geometry_msgs/msg/{kind}), as omniman teleop does"
        )
