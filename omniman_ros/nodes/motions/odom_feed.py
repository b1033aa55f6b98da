"""What the node hears of where the platform is."""

from collections.abc import Callable

import numpy as np
from nav_msgs.msg import Odometry
from numpy.typing import NDArray

from omniman_ros import conversions
from omniman_ros.core import plausible, se2
from omniman_ros.nodes.runtime import OmnimanNode

Array = NDArray[np.float64]

AT_REST = 0.02
"""Speed below which a motion may begin [m/s, rad/s]."""


class OdomFeed:
    """Input `odom`.

    Args:
        node: Where the topic is.
        frame: Of its poses.
        heard: Called with the pose and its time on the node's clock [s].

    Attributes:
        pose: (x, y, theta) [m, m, rad], or None.
        velocity: (3,) of the pose, in odom [m/s, m/s, rad/s].
        time: When it was measured, on this node's clock [s].
        silent: Age that it had, and time that has passed since on this node's clock [s].
    """

    def __init__(
        self, node: OmnimanNode, frame: str, heard: Callable[[Array, float], None]
    ) -> None:
        self._node, self._frame, self._tell = node, frame, heard
        self.pose: tuple[float, float, float] | None = None
        self.silent = 0.0
        self.velocity: Array = np.zeros(3)
        self.time = float("-inf")
        node.create_subscription(Odometry, "odom", node.guarded("odom", self._on_odom), 1)

    def _on_odom(self, message: Odometry) -> None:
        conversions.check_frame(message.header.frame_id, self._frame)
        twist = conversions.twist_array(message.twist.twist)
        place, theta = message.pose.pose.position, conversions.yaw(message.pose.pose.orientation)
        plausible.demand(np.array([place.x, place.y]), plausible.LENGTH, "position")
        self.silent = max(self._node.age(message.header.stamp), 0.0)
        self.time = self._node.now() - self.silent
        self.pose = (place.x, place.y, theta)
        self.velocity = se2.to_world(theta, twist)
        self._tell(np.array(self.pose), self.time)

    @property
    def age(self) -> float:
        """Of the pose [s]."""
        return self._node.now() - self.time

    def pass_time(self, elapsed: float) -> None:
        """Let time pass [s]: while the node is held up, it is not odom that is silent."""
        self.silent += elapsed

    def forget(self) -> None:
        """What was heard says nothing about now."""
        self.time = float("-inf")

    def not_yet(self, timeout: float) -> str:
        """Why no motion of the platform can begin from rest yet, or an empty string."""
        age = self.age
        if self.pose is None:
            return "no odom"
        if age > timeout:
            return f"odom is {age:.2f} s old"
        return "the robot moves" if np.abs(self.velocity).max() > AT_REST else ""
