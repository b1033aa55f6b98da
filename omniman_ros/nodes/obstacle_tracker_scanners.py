"""The scanners of an obstacle tracker: their topics, their mounting, and whether they see."""

import math
from collections.abc import Callable
from functools import partial

from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import LaserScan, PointCloud2

from omniman_ros.conversions.scans import Slice, scan_from_cloud, scan_from_message
from omniman_ros.core.rigid import Transform
from omniman_ros.nodes.frame_transforms import FrameTransforms
from omniman_ros.nodes.obstacle_tracker_parameters import LASER, ObstacleTrackerParameters
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.parameters import ParameterSet
from omniman_ros.perception.pose_history import PoseHistory
from omniman_ros.perception.scan import Scan
from omniman_ros.perception.scan_check import ScanCheck


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
