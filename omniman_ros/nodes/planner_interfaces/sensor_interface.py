"""Topics with the state of the robot and its surroundings, which the planner uses."""

from typing import TYPE_CHECKING

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from nav_msgs.msg import Odometry

from omniman_ros.conversions.geometry import twist_array, yaw_from_quaternion
from omniman_ros.conversions.headers import check_frame
from omniman_ros.conversions.wheels import LimitScales, reported_limit_scales
from omniman_ros.core.stream_monitor import StreamMonitor
from omniman_ros.nodes.frame_transforms import FrameTransforms
from omniman_ros.nodes.map_interface import MapInterface
from omniman_ros.nodes.obstacle_interface import ObstacleInterface
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.parameters import ParameterSet
from omniman_ros.nodes.planner_interfaces.parameters import MpcPlannerParameters
from omniman_ros.nodes.source_watch import SourceWatch
from omniman_ros.nodes.stop_interface import LATCHED
from omniman_ros.planning.cycle import MeasuredState

if TYPE_CHECKING:
    from omniman_ros.planning.planner import Planner


class SensorInterface:
    """Subscribes to `odom`, `obstacles`, `map` and `wheel_health`."""

    def __init__(
        self,
        node: OmnimanNode,
        settings: ParameterSet[MpcPlannerParameters],
        frames: FrameTransforms,
        planner: "Planner",
        monitor: StreamMonitor,
    ) -> None:
        self._node, self._settings = node, settings
        self._planner, self._monitor = planner, monitor
        self.measured: MeasuredState | None = None
        self._limit_scales = LimitScales()
        self._watch = SourceWatch(node, frames)
        p = settings.value
        self.obstacles = ObstacleInterface(node, frames, p.core.obstacles, self._watch)
        self._map = MapInterface(node, frames, p.map_reading.rule, planner.set_map, self._watch)
        for kind, topic, handler, qos in (
            (Odometry, "odom", self._on_odom, 1),
            (DiagnosticStatus, "wheel_health", self._on_health, LATCHED),
        ):
            node.create_subscription(kind, topic, node.guarded(topic, handler), qos)

    def configure(self, new: MpcPlannerParameters) -> None:
        """Use other parameters."""
        self.obstacles.configure(new.core.obstacles)
        self._map.configure(new.map_reading.rule)

    def odom_fault(self, now: float) -> str:
        """Return why the odometry cannot be used at the time `now` [s], or an empty string."""
        if self.measured is None:
            return "no odom"
        age = now - self.measured.time
        return f"odom is {age:.2f} s old" if age > self._settings.value.odom_timeout else ""

    def update_map(self) -> None:
        """Move the map if its frame has moved against odom."""
        if self.measured is not None:
            x, y, theta = self.measured.pose.tolist()
            self._map.update((x, y, theta))

    def blind_reason(self) -> str:
        """Return why it is not known what is around the robot, or an empty string."""
        return self._watch.blind_reason()

    def _on_odom(self, message: Odometry) -> None:
        check_frame(message.header.frame_id, self._settings.value.frames.odom.odom_frame)
        pose = message.pose.pose
        self.measured = MeasuredState(
            min(self._node.instant(message.header.stamp), self._node.now()),
            np.array([pose.position.x, pose.position.y, yaw_from_quaternion(pose.orientation)]),
            twist_array(message.twist.twist),
        )

    def _on_health(self, message: DiagnosticStatus) -> None:
        scales, before = reported_limit_scales(message), self._limit_scales
        self._limit_scales = scales
        # A scale that grows shows that the controller was reset and expects a pause of the stream.
        if scales.wheels > before.wheels:
            self._monitor.restart(self._node.now())
        self._planner.set_limit_scale(scales.total, scales.posture)
