"""Measured pose and velocity of the platform."""

import math
from collections.abc import Callable

import numpy as np
from nav_msgs.msg import Odometry

from omniman_ros.conversions.geometry import twist_array, yaw_from_quaternion
from omniman_ros.conversions.headers import check_frame
from omniman_ros.core import plausible, se2
from omniman_ros.core.arrays import Array
from omniman_ros.core.stamps import MAX_LEAD
from omniman_ros.nodes.omniman_node import OmnimanNode

#: Speed of the platform [m/s, rad/s] and of joints [rad/s] up to which they are at rest
AT_REST = 0.02


class OdomFeed:
    """Subscribes to an odometry, and keeps the latest pose and velocity.

    Attributes:
        pose: Pose (x, y, theta) of base_link in odom [m, m, rad]; None before the first message.
        velocity: (3,) rate of the pose, in odom [m/s, m/s, rad/s].
        time: Time of the measurement on the node's clock [s].
        silence: Age of the pose on arrival plus the node's own time since then [s].
    """

    def __init__(
        self,
        node: OmnimanNode,
        topic: str,
        frame: str,
        on_pose: Callable[[Array, float], None],
    ) -> None:
        self._node, self._frame, self._on_pose = node, frame, on_pose
        self.pose: tuple[float, float, float] | None = None
        self.silence = 0.0
        self.velocity: Array = np.zeros(3)
        self.time = float("-inf")
        node.create_subscription(Odometry, topic, node.guarded(topic, self._on_odom), 1)

    def _on_odom(self, message: Odometry) -> None:
        check_frame(message.header.frame_id, self._frame)
        twist = twist_array(message.twist.twist)
        position, theta = (
            message.pose.pose.position,
            yaw_from_quaternion(message.pose.pose.orientation),
        )
        plausible.demand(np.array([position.x, position.y]), plausible.LENGTH, "position")
        instant, now = self._node.instant(message.header.stamp), self._node.now()
        self.time = min(instant, now)
        self.silence = now - self.time
        self.pose = (position.x, position.y, theta)
        self.velocity = se2.to_world(theta, twist)
        self._on_pose(np.array(self.pose), self.time)

    @property
    def age(self) -> float:
        """Age of the pose [s]; infinite without one, and after time went back behind it."""
        age = self._node.now() - self.time
        return age if age >= -MAX_LEAD else math.inf

    def pass_time(self, elapsed: float) -> None:
        """Advance the silence by the node's own time [s].

        Time during which the node itself is held up must not be counted in full, because odom is
        not silent then.
        """
        self.silence += elapsed

    def forget(self) -> None:
        """Treat the last pose as too old, because time went back."""
        self.time = float("-inf")

    def blocking_reason(self, timeout: float) -> str:
        """Return why no motion can start from rest; odom older than `timeout` [s] is a reason."""
        age = self.age
        if self.pose is None:
            return "no odom"
        if age > timeout:
            return f"odom is {age:.2f} s old"
        return "the robot moves" if np.abs(self.velocity).max() > AT_REST else ""
