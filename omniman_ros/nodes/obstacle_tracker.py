"""Node `obstacle_tracker`: turns laser scans into tracked obstacles and a map."""

import sys
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from nav_msgs.msg import OccupancyGrid
from rclpy.qos import QoSProfile
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import MarkerArray

from omniman_ros.collision.body_outline import BodyOutline
from omniman_ros.collision.footprint import Footprint
from omniman_ros.conversions.tracks import track_cloud, track_markers
from omniman_ros.conversions.unseen import unseen_message
from omniman_ros.core.arrays import Array
from omniman_ros.extras import TRACKING
from omniman_ros.nodes.arm_states import ArmStatesReader
from omniman_ros.nodes.obstacle_tracker_map import MapPublisher
from omniman_ros.nodes.obstacle_tracker_parameters import ObstacleTrackerParameters
from omniman_ros.nodes.obstacle_tracker_scanners import Scanners
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.parameters import ParameterSet
from omniman_ros.nodes.runtime import run
from omniman_ros.nodes.trajectory_interfaces.odom_feed import OdomFeed
from omniman_ros.perception.scan import Scan
from omniman_ros.perception.unseen import RESOLUTION

if TYPE_CHECKING:
    from omniman_ros.perception.obstacle_tracker import ObstacleTracker

#: Time after which an obstacle is forgotten by readers that receive nothing more of it [s]
LIFETIME = 0.5
#: Vertical gap up to which a part of the robot may be in the way of a beam [m]
HEIGHT_MARGIN = 0.05
#: Period at which is looked whether scanners have become silent, which is logged [s]
REPORT_PERIOD = 1.0
POSTURE_TOLERANCE = 0.02  #: Rotation of a joint up to which the robot's outline stays [rad]


class ObstacleTrackerNode(OmnimanNode):
    """Connects an obstacle tracker to its topics."""

    core: "ObstacleTracker"

    def __init__(self, **options: Any) -> None:
        # Here, so that a machine without scipy can say what is missing.
        from omniman_ros.perception.obstacle_tracker import ObstacleTracker

        super().__init__("obstacle_tracker", **options)
        self.settings = ParameterSet(self, ObstacleTrackerParameters)
        p = self.settings.value
        self.core = ObstacleTracker(p.tracker, p.local_map, p.tracks, p.unseen)
        self.settings.on_change(self._configure)
        self._shape(p)
        self._arm: ArmStatesReader | None = None
        if self._outline.has_arm:
            self._arm = ArmStatesReader(self, p.description.arm.joints)
        self._odom_frame = p.frames.odom.odom_frame
        self._odom = OdomFeed(self, "odom", self._odom_frame, self._on_pose)
        self._markers = self.create_publisher(MarkerArray, "obstacles", QoSProfile(depth=50))
        self._tracks = self.create_publisher(PointCloud2, "obstacle_tracks", QoSProfile(depth=5))
        if p.map_rate > 0.0:  # else nobody is to wait for a map
            MapPublisher(self, self.core, self._odom_frame, p.map_rate)
        self._unseen = self.create_publisher(OccupancyGrid, "unseen", QoSProfile(depth=1))
        self._scanners = Scanners(self, self.settings, lambda: self.core.poses, self._on_scan)
        self._reported: set[int] = set()
        self._is_silent = False
        self.every(REPORT_PERIOD, self._report_scanners)

    def _configure(self, new: ObstacleTrackerParameters) -> None:
        self._shape(new)
        self.core.parameters, self.core.map_parameters = new.tracker, new.local_map
        self.core.motion, self.core.unseen.parameters = new.tracks, new.unseen

    def _shape(self, p: ObstacleTrackerParameters) -> None:
        """Take over the shape of the robot, whose posture is looked at anew."""
        self._outline = BodyOutline(p.description, p.tool, p.load)
        robot = p.description.robot
        platform = replace(p.description, robot=replace(robot, arm=replace(robot.arm, mass=0.0)))
        self._own = BodyOutline(platform).footprint(np.zeros((1, 6)), HEIGHT_MARGIN)
        self._posture: Array | None = None

    # ---- inputs ---------------------------------------------------------------------------------

    def _on_pose(self, pose: Array, at: float) -> None:
        reason = self.core.add_pose(at, pose, self._odom.velocity)
        if reason:
            self._scanners.forget()
            if self._arm is not None:
                self._arm.forget()
            self.get_logger().warning(f"{reason}: map and obstacles begin anew")

    def _on_scan(self, scan: Scan, number: int) -> None:
        is_mapped = self.core.add_scan(scan, self._footprint(), number)
        # Where a scanner does not see, the silence must be noticed.
        if self._scanners.faults():
            return
        self._publish_obstacles(scan.end)
        if is_mapped and self.settings.value.unseen.speed > 0.0:
            times, origin = self.core.unseen.arrivals(), self.core.unseen.origin
            stamp = self.stamp(scan.end)
            self._unseen.publish(
                unseen_message(times, RESOLUTION, origin, self._odom_frame, stamp)
            )

    def _footprint(self) -> Footprint:
        """Return what the robot covers: before the first joint states, its platform."""
        if self._arm is None:
            return self._own
        self._arm.poll()
        states, before = self._arm.last, self._posture
        if states is None:
            return self._own
        if before is None or np.abs(states.position - before).max() > POSTURE_TOLERANCE:
            self._posture = states.position
            self._own = self._outline.footprint(states.position[None], HEIGHT_MARGIN)
        return self._own

    # ---- outputs --------------------------------------------------------------------------------

    def _publish_obstacles(self, time: float) -> None:
        obstacles, stamp = self.core.obstacles(time), self.stamp(time)
        present = {obstacle.number for obstacle in obstacles}
        gone, self._reported = self._reported - present, present
        height = self.settings.value.height
        markers = track_markers(
            obstacles, sorted(gone), self._odom_frame, stamp, lifetime=LIFETIME, height=height
        )
        self._markers.publish(markers)
        self._tracks.publish(track_cloud(obstacles, self._odom_frame, stamp))

    def _report_scanners(self) -> None:
        """Log when scanners become silent or blind, and when all of them see again."""
        faults = self._scanners.faults()
        if faults and not self._is_silent:
            self.warn("silent", f"obstacles are silent: {'; '.join(faults)}")
        elif self._is_silent and not faults:
            self.get_logger().info("all scanners see again")
        self._is_silent = bool(faults)

    # ---- status ---------------------------------------------------------------------------------

    def status(self) -> tuple[bytes, str, list[tuple[str, object]]]:
        """Return level, message and values for the diagnostics."""
        moving = len(self._reported)
        values: list[tuple[str, object]] = [("moving", moving), ("tracks", self.core.count)]
        faults = self._scanners.faults()
        if faults:
            return DiagnosticStatus.WARN, f"obstacles are silent: {'; '.join(faults)}", values
        return DiagnosticStatus.OK, "tracking", values


def main(args: list[str] | None = None) -> int:
    """Run the node: entry point of `ros2 run omniman_ros obstacle_tracker`."""
    if not TRACKING.is_available:
        sys.stderr.write(f"cannot start: {TRACKING.hint}\n")
        return 1
    return run(ObstacleTrackerNode, args)
