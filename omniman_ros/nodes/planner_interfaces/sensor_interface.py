"""Topics with the state of the robot and its surroundings, which the planner uses."""

from typing import TYPE_CHECKING

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from nav_msgs.msg import Odometry
from visualization_msgs.msg import MarkerArray

from omniman_ros.conversions.geometry import twist_array, yaw_from_quaternion
from omniman_ros.conversions.headers import check_frame
from omniman_ros.conversions.wheels import LimitScales, reported_limit_scales
from omniman_ros.core.stream_monitor import StreamMonitor
from omniman_ros.nodes import obstacle_interface
from omniman_ros.nodes.frame_transforms import FrameTransforms
from omniman_ros.nodes.map_interface import MapInterface
from omniman_ros.nodes.obstacle_interface import marker_headers
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.parameters import ParameterSet
from omniman_ros.nodes.planner_interfaces.parameters import MpcPlannerParameters
from omniman_ros.nodes.stop_interface import LATCHED
from omniman_ros.planning.cycle import MeasuredState
from omniman_ros.planning.obstacles.ellipses import Ellipses
from omniman_ros.planning.obstacles.framed_obstacles import FramedObstacles

if TYPE_CHECKING:
    from omniman_ros.planning.planner import Planner


class SensorInterface:
    """Subscribes to `odom`, `obstacles`, `map` and `wheel_health`.

    Args:
        node: Node that receives the messages.
        settings: Parameters of the node.
        frames: Transforms of the node.
        planner: Planner that gets the map and the scale of the limits.
        monitor: Monitor of the planner's stream.

    Attributes:
        measured: Latest state of the robot, or None before the first.
        obstacles: Obstacles that are known.
    """

    def __init__(
        self,
        node: OmnimanNode,
        settings: ParameterSet[MpcPlannerParameters],
        frames: FrameTransforms,
        planner: "Planner",
        monitor: StreamMonitor,
    ) -> None:
        self._node, self._settings, self._frames = node, settings, frames
        self._planner, self._monitor = planner, monitor
        self.measured: MeasuredState | None = None
        self._limit_scales = LimitScales()
        self.obstacles = FramedObstacles(settings.value.core.obstacles)
        self._map = MapInterface(node, frames, settings.value.map_reading.rule, planner.set_map)
        on_obstacles = frames.deferred("obstacles", marker_headers, self._on_obstacles)
        for kind, topic, handler, qos in (
            (MarkerArray, "obstacles", on_obstacles, 50),
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

    def ellipses(self, now: float) -> Ellipses:
        """Return the obstacles in odom at the time `now` [s]."""
        return self.obstacles.ellipses(now, lambda frame: self._frames.anchor(frame).planar())

    def dismiss_silent_source(self) -> None:
        """Stop waiting for a silent source of obstacles that no longer exists.

        Only a new goal justifies this: somebody has sent it without the source. A motion that was
        under way when the source fell silent stays stopped.
        """
        now, node = self._node.now(), self._node
        if self.obstacles.silence_reason(now) and not node.count_publishers("obstacles"):
            self.obstacles.dismiss_source()
            if not self.obstacles.silence_reason(now):
                node.warn(
                    "source gone",
                    "the source of obstacles is gone: the last known obstacles are used",
                )

    def _on_odom(self, message: Odometry) -> None:
        check_frame(message.header.frame_id, self._settings.value.frames.odom.odom_frame)
        pose = message.pose.pose
        self.measured = MeasuredState(
            min(self._node.instant(message.header.stamp), self._node.now()),
            np.array([pose.position.x, pose.position.y, yaw_from_quaternion(pose.orientation)]),
            twist_array(message.twist.twist),
        )

    def _on_obstacles(self, message: MarkerArray) -> str:
        faults = obstacle_interface.update_obstacles(
            self._node, message, self.obstacles, self._frames.placement
        )
        more = f" (and {len(faults) - 1} more)" if len(faults) > 1 else ""
        return faults[0] + more if faults else ""

    def _on_health(self, message: DiagnosticStatus) -> None:
        """Apply the fraction of the limits that dead wheels and the arm's posture leave."""
        scales, before = reported_limit_scales(message), self._limit_scales
        self._limit_scales = scales
        # A scale that grows shows that the controller was reset and expects a pause of the stream.
        if scales.wheels > before.wheels:
            self._monitor.restart(self._node.now())
        self._planner.set_limit_scale(scales.total, scales.posture)
