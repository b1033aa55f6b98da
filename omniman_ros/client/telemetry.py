"""What a robot tells of itself, with the times at which it was heard."""

import math
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from rclpy.time import Time
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from omniman_ros.client.shared_node import SharedNode
from omniman_ros.client.state import BodyTwist, PlanarPose, Reading
from omniman_ros.conversions.geometry import twist_array, yaw_from_quaternion
from omniman_ros.core import plausible
from omniman_ros.nodes.stop_interface import ALL_LATCHED, STOP_STATE

REST_SPEED = 0.01  #: Speed below which a platform stands [m/s]
REST_TIME = 200_000_000  #: Time without a higher speed after which a robot stands [ns]
TIME_JUMP = 1_000_000_000  #: Step back from which the robot's time counts as set back [ns]
REST_RATE = 0.02  #: Rate below which a platform and an arm's joint stand [rad/s]


class Telemetry:
    """Hears a robot's state; only threads that hold the node's lock may call it."""

    def __init__(self, shared: SharedNode) -> None:
        self._shared = shared
        self._heard: dict[str, tuple[float, Any]] = {}
        self._rates: list[float] = []
        self._odom_stamp = self._newest_stamp = 0  # [ns]
        self._moved_at = -REST_TIME  # by the robot's time [ns]
        self._stop_states: dict[str, str] = {}
        for kind, topic, handler, qos in (
            (Odometry, "odom", self._on_odom, 10),
            (JointState, "arm/joint_states", self._on_arm, 10),
            (PoseStamped, "tool_pose", self._on_tool, 10),
            (String, "active_source", self._on_source, ALL_LATCHED),
            (DiagnosticStatus, STOP_STATE, self._on_stop_state, ALL_LATCHED),
        ):
            shared.subscribe(kind, topic, handler, qos)

    def knows(self, *names: str) -> bool:
        """Return whether all of some values have been heard."""
        return all(name in self._heard for name in names)

    def reading(self, name: str) -> Reading[Any]:
        """Return the latest value of a topic, and its age; `twist` is that of `odom`."""
        if name not in self._heard:
            return Reading(name)
        at, value = self._heard[name]
        return Reading(name, max(self._shared.now() - at, 0.0), value)

    def next_stamp(self) -> Any:
        """Return a stamp that no other message has had: the robot's time, or one just after it.

        It is that of the latest `odom`. So it is right for robots on simulated time, too, and on
        another machine. A time that went back is the robot's time from then on.
        """
        now = self._odom_stamp or self._shared.node.get_clock().now().nanoseconds
        went_back = self._newest_stamp - now > TIME_JUMP
        self._newest_stamp = now if went_back else max(now, self._newest_stamp + 1)
        return Time(nanoseconds=self._newest_stamp).to_msg()

    @property
    def stands(self) -> bool:
        """Whether platform and arm have been at rest for `REST_TIME`, as far as they are heard."""
        return self._odom_stamp - self._moved_at >= REST_TIME

    def _hear(self, name: str, value: Any) -> None:
        self._heard[name] = (self._shared.now(), value)

    def _on_odom(self, message: Odometry) -> None:
        position = message.pose.pose.position
        plausible.demand(np.array([position.x, position.y]), plausible.LENGTH, "position")
        heading = yaw_from_quaternion(message.pose.pose.orientation)
        vx, vy, wz = twist_array(message.twist.twist).tolist()
        self._odom_stamp = Time.from_msg(message.header.stamp).nanoseconds
        self._hear("odom", PlanarPose(position.x, position.y, heading))
        self._hear("twist", BodyTwist(vx, vy, wz))
        rests = math.hypot(vx, vy) < REST_SPEED and abs(wz) < REST_RATE
        if not rests or any(abs(rate) > REST_RATE for rate in self._rates):
            self._moved_at = self._odom_stamp

    def _on_arm(self, message: JointState) -> None:
        numbers = [*message.position, *message.velocity]
        plausible.demand(np.array(numbers), plausible.ANGLE, "positions and velocities")
        self._rates = list(message.velocity)
        self._hear("arm/joint_states", dict(zip(message.name, message.position, strict=False)))

    def _on_tool(self, message: PoseStamped) -> None:
        position = message.pose.position
        numbers = [position.x, position.y, position.z]
        plausible.demand(np.array(numbers), plausible.LENGTH, "position")
        self._hear("tool_pose", (position.x, position.y, position.z))

    def _on_source(self, message: String) -> None:
        self._hear("active_source", message.data)

    def _on_stop_state(self, message: DiagnosticStatus) -> None:
        is_stopped = message.level == DiagnosticStatus.ERROR
        self._stop_states[message.name] = message.message if is_stopped else ""
        stopped = [
            f"{name.rpartition('/')[2]} {reason}"
            for name, reason in sorted(self._stop_states.items())
            if reason
        ]
        self._hear(STOP_STATE, "; ".join(stopped))
