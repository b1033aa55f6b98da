"""Node `obstacle_tracker`: turns laser scans into tracked obstacles and a map."""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from nav_msgs.msg import OccupancyGrid
from numpy.typing import NDArray
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile, qos_profile_sensor_data
from sensor_msgs.msg import LaserScan, PointCloud2
from visualization_msgs.msg import MarkerArray

from omniman_ros.collision.body_outline import BodyOutline
from omniman_ros.collision.footprint import Footprint
from omniman_ros.conversions.maps import map_message, map_update_message
from omniman_ros.conversions.scans import Slice, scan_from_cloud, scan_from_message
from omniman_ros.conversions.tracks import track_cloud, track_markers
from omniman_ros.conversions.unseen import unseen_message
from omniman_ros.core.arrays import Array
from omniman_ros.core.rigid import Transform
from omniman_ros.extras import TRACKING
from omniman_ros.nodes import map_messages
from omniman_ros.nodes.arm_states import ArmStatesReader
from omniman_ros.nodes.frame_transforms import FrameTransforms
from omniman_ros.nodes.obstacle_tracker_parameters import LASER, ObstacleTrackerParameters
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.parameters import ParameterSet
from omniman_ros.nodes.robot_streams import OdomFeed
from omniman_ros.nodes.runtime import run
from omniman_ros.nodes.stop_interface import LATCHED
from omniman_ros.perception.pose_history import PoseHistory
from omniman_ros.perception.scan import Scan
from omniman_ros.perception.scan_check import ScanCheck
from omniman_ros.perception.unseen import RESOLUTION
from omniman_ros.surroundings.occupancy import changed_cells

if TYPE_CHECKING:  # needs scipy, which is optional
    from omniman_ros.perception.obstacle_tracker import ObstacleTracker

#: Longest time between two whole maps, after which a reader that has missed an update is right
#: again [s].
WHOLE_PERIOD = 5.0
#: Time after which an obstacle is forgotten by readers that receive nothing more of it [s]
LIFETIME = 0.5
#: Vertical gap up to which a part of the robot may be in the way of a beam [m]
HEIGHT_MARGIN = 0.05
#: Period at which is looked whether scanners have become silent, which is logged [s]
REPORT_PERIOD = 1.0
JOINT_TOLERANCE = 0.02  #: Rotation of a joint up to which the robot's outline stays [rad]


class Scanners:
    """Subscribes to scans, and hands on those that can be used."""

    def __init__(
        self,
        node: OmnimanNode,
        settings: ParameterSet[ObstacleTrackerParameters],
        poses: Callable[[], PoseHistory],
        use: Callable[[Scan, int], None],
    ) -> None:
        self._node, self._settings, self._poses, self._use = node, settings, poses, use
        p = settings.value
        self._frames: FrameTransforms | None = None
        if p.scanners_by_tf:
            self._frames = FrameTransforms(node, lambda: settings.value.frames)
        self._checks = [ScanCheck() for _ in p.scanners]
        self._used = [-math.inf] * len(p.scanners)
        self._reasons = [""] * len(p.scanners)
        for number, scanner in enumerate(p.scanners):
            kind = LaserScan if scanner.kind == LASER else PointCloud2
            node.foreign_types.selectors[scanner.topic] = "scanners.kind"
            handler = node.guarded(scanner.topic, partial(self._receive, number))
            node.create_subscription(kind, scanner.topic, handler, qos_profile_sensor_data)

    def forget(self) -> None:
        """Treat the last scans as too old, because time went back."""
        self._used = [-math.inf] * len(self._used)

    def faults(self) -> list[str]:
        """Return which scanners are silent or see nothing, and why."""
        p, now = self._settings.value, self._node.now()
        found = []
        for scanner, used, reason in zip(p.scanners, self._used, self._reasons, strict=True):
            age = now - used
            if reason:
                found.append(f"{scanner.topic} is {reason}")
            elif math.isinf(age):
                is_sent = self._node.count_publishers(scanner.topic)
                found.append(f"no {scanner.topic}{'' if is_sent else ': nobody publishes it'}")
            elif age > p.scan_check.timeout:
                found.append(f"{scanner.topic} is {age:.2f} s old")
        return found

    def _receive(self, number: int, message: LaserScan | PointCloud2) -> str:
        """Use a message of a scanner; return why not, otherwise."""
        p = self._settings.value
        mount = self._mount(number, message.header.frame_id)
        if isinstance(message, LaserScan):
            no_return = p.scanners[number].no_return
            scan = scan_from_message(message, mount, self._node.instant, no_return)
        else:
            part = Slice(p.cloud.low, p.cloud.high, p.cloud.range_max)
            scan = scan_from_cloud(message, mount, self._node.instant, part)
        age = self._node.now() - scan.end
        if age > p.scan_check.timeout:
            return f"stale, {age:.3f} s old"
        pose = self._poses().at(scan.times)[-1]
        # A cloud tells nothing of beams that met nothing: it cannot be blind in this sense.
        if isinstance(message, LaserScan):
            self._reasons[number] = self._checks[number].fault(scan, pose, p.scan_check)
        if self._reasons[number]:
            return self._reasons[number]
        self._used[number] = scan.end
        self._use(scan, number)
        return ""

    def _mount(self, number: int, frame: str) -> Transform:
        p = self._settings.value
        if self._frames is None:
            return p.scanners[number].mount
        return self._frames.mount(frame, p.base_frame)


class MapPublisher:
    """Publishes `map` and `map_updates`.

    A whole map is sent where the map has moved, for a new reader, and every `WHOLE_PERIOD`; in
    between, if all readers of `map` read `map_updates` too, the rectangle of what has changed.

    Args:
        rate: Rate [Hz].
    """

    def __init__(
        self, node: OmnimanNode, core: "ObstacleTracker", frame: str, rate: float
    ) -> None:
        self._node, self._core, self._frame = node, core, frame
        self._maps = node.create_publisher(OccupancyGrid, map_messages.TOPIC, LATCHED)
        self._updates: Publisher | None = None
        if map_messages.OccupancyGridUpdate is None:
            node.get_logger().info("map_msgs is not installed: map is always sent whole")
        else:
            self._updates = node.create_publisher(
                map_messages.OccupancyGridUpdate, map_messages.UPDATES_TOPIC, map_messages.UPDATES
            )
        self._sent: tuple[NDArray[np.int8], Array] | None = None
        self._time = self._whole = -math.inf
        self._readers = 0
        node.every(1.0 / rate, self._publish)

    def _publish(self) -> None:
        """Publish the map if a scan has come since the last time."""
        core = self._core
        if core.time == self._time or not np.isfinite(core.time):
            return
        cells, origin = core.occupancy(), core.map.origin
        stamp = self._node.stamp(core.time)
        if self._is_whole(core.time, origin):
            self._whole = core.time
            self._maps.publish(map_message(cells, core.map.resolution, origin, self._frame, stamp))
        else:
            assert self._sent is not None and self._updates is not None
            changed = changed_cells(self._sent[0], cells)
            if changed is not None:
                kind: Any = map_messages.OccupancyGridUpdate
                self._updates.publish(map_update_message(kind, cells, changed, self._frame, stamp))
        self._time, self._sent = core.time, (cells, origin)

    def _is_whole(self, time: float, origin: Array) -> bool:
        before, self._readers = self._readers, self._maps.get_subscription_count()
        if self._updates is None or self._sent is None:
            return True
        return (
            self._readers > min(before, self._updates.get_subscription_count())
            or not self._whole <= time < self._whole + WHOLE_PERIOD
            or not np.array_equal(origin, self._sent[1])
        )


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
        if before is None or np.abs(states.position - before).max() > JOINT_TOLERANCE:
            self._posture = states.position
            self._own = self._outline.footprint(states.position[None], HEIGHT_MARGIN)
        return self._own

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
    return run(ObstacleTrackerNode, args, TRACKING)
