"""Topic `unseen`: where somebody may step out, and how fast the robot may be there."""

import numpy as np
from nav_msgs.msg import OccupancyGrid
from rclpy.qos import QoSProfile

from omniman_ros.collision.body_outline import BodyOutline
from omniman_ros.collision.monitor import CollisionMonitor, RobotMotion
from omniman_ros.collision.rectangles import Rectangles
from omniman_ros.collision.unseen import Arrivals, UnseenLimit
from omniman_ros.conversions.headers import check_frame
from omniman_ros.conversions.unseen import arrivals_from_message
from omniman_ros.core.arrays import Array
from omniman_ros.nodes.collision_monitor_parameters import CollisionMonitorParameters
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.parameters import ParameterSet

POSTURE_TOLERANCE = 0.02  #: Rotation of a joint up to which the robot's outline stays [rad]


class UnseenInterface:
    """Subscribes to `unseen`, and has a collision monitor respect it."""

    def __init__(
        self,
        node: OmnimanNode,
        settings: ParameterSet[CollisionMonitorParameters],
        core: CollisionMonitor,
    ) -> None:
        self._node, self._settings, self._core = node, settings, core
        self._latest: tuple[float, Arrivals] | None = None
        self._outline: tuple[Array, Rectangles] | None = None
        handler = node.guarded("unseen", self._receive)
        node.create_subscription(OccupancyGrid, "unseen", handler, QoSProfile(depth=1))

    def configure(self) -> None:
        """Look at the shape of the robot anew."""
        self._outline = None

    def _receive(self, message: OccupancyGrid) -> str | None:
        p, now = self._settings.value, self._node.now()
        check_frame(message.header.frame_id, p.frames.odom.odom_frame)
        sent = min(self._node.instant(message.header.stamp), now)
        if now - sent > p.unseen.timeout:
            return f"stale, {now - sent:.3f} s old"
        if self._latest is not None and 0.0 < self._latest[0] - sent <= p.unseen.timeout:
            return f"out of order, {self._latest[0] - sent:.3f} s before the last one"
        self._latest = sent, arrivals_from_message(message)
        return None

    def fault(self) -> str:
        """Return why the topic cannot be used, or an empty string if it can or need not be."""
        p = self._settings.value.unseen
        if not p.use:
            return ""
        if self._latest is None:
            return "no unseen"
        age = self._node.now() - self._latest[0]
        return "" if 0.0 <= age <= p.timeout else f"unseen is {age:.2f} s old"

    def limit(self, robot: RobotMotion, demands: list[Array], *, sees_arm: bool) -> UnseenLimit:
        """Return the limit of the platform's speed for motions (9,) that are asked for."""
        p = self._settings.value.unseen
        if not p.use or self._latest is None:
            return UnseenLimit()
        sent, arrivals = self._latest
        arrivals = arrivals.after(max(self._node.now() - sent, 0.0))
        outline = self._footprint(robot.joints, sees_arm)
        return self._core.unseen_limit(robot, demands, arrivals, outline, p)

    def _footprint(self, joints: Array, sees_arm: bool) -> Rectangles:
        """Return rectangles around the robot, without an arm whose posture is not known."""
        if self._outline is None or np.abs(joints - self._outline[0]).max() > POSTURE_TOLERANCE:
            p = self._settings.value
            made = BodyOutline(p.description, p.tool, p.load).footprint(joints[None], 0.0)
            self._outline = joints, made.whole if sees_arm else made.platform
        return self._outline[1]
