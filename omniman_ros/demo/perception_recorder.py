"""What a robot's scanner, tracker and world tell while it drives to a goal among people."""

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from nav_msgs.msg import OccupancyGrid
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import LaserScan, PointCloud2
from visualization_msgs.msg import Marker, MarkerArray

from omniman_ros.conversions.headers import time_seconds
from omniman_ros.conversions.maps import map_from_message
from omniman_ros.conversions.perceived import tracked_obstacles
from omniman_ros.conversions.scans import scan_from_message
from omniman_ros.core.arrays import Array
from omniman_ros.core.occupancy import OccupancyMap
from omniman_ros.core.parameters import build
from omniman_ros.demo.moving_obstacles import ObstaclesOverTime
from omniman_ros.nodes.obstacle_tracker_parameters import ScannerInput


@dataclass
class Perception:
    """What was perceived on the way to a goal, stamps in ROS time [s].

    Attributes:
        scans: Stamp of each scan, and the points (k, 2) that its beams met, in base_link [m].
        tracks: Rows (m,) of each message of tracked obstacles: x, y [m] and x', y' [m/s] in odom.
        map: The last map; None before the first.
        people: Stamp, and x, y [m] and radius [m] of each person, by the ground truth.
    """

    scans: list[tuple[float, Array]] = field(default_factory=list)
    tracks: list[Array] = field(default_factory=list)
    map: OccupancyMap | None = None
    people: list[tuple[float, Array]] = field(default_factory=list)


class PerceptionRecorder:
    """Subscriptions that record a perception until they are closed.

    The scanner is taken to be mounted as a `simulated_world` has it by default.

    Args:
        node: Node that owns the subscriptions.

    Attributes:
        perception: What has been perceived.
    """

    def __init__(self, node: Node) -> None:
        self.perception = Perception()
        self._node, self._mount = node, build(ScannerInput, {}).mount
        self._subscriptions: list[Any] = [
            node.create_subscription(kind, topic, handler, qos)
            for kind, topic, handler, qos in (
                (LaserScan, "scan", self._on_scan, qos_profile_sensor_data),
                (OccupancyGrid, "map", self._on_map, 1),
                (PointCloud2, "obstacle_tracks", self._on_tracks, 5),
                (MarkerArray, "ground_truth/obstacles", self._on_people, 10),
            )
        ]

    def close(self) -> None:
        """End the recording."""
        while self._subscriptions:
            self._node.destroy_subscription(self._subscriptions.pop())

    def _on_scan(self, message: LaserScan) -> None:
        scan = scan_from_message(message, self._mount, time_seconds)
        self.perception.scans.append((scan.end, scan.local_points(scan.hits)))

    def _on_map(self, message: OccupancyGrid) -> None:
        self.perception.map = map_from_message(message)

    def _on_tracks(self, message: PointCloud2) -> None:
        self.perception.tracks.append(tracked_obstacles(message)[:, :4])

    def _on_people(self, message: MarkerArray) -> None:
        people = [marker for marker in message.markers if marker.type == Marker.CYLINDER]
        if people:
            rows = [
                (each.pose.position.x, each.pose.position.y, 0.5 * each.scale.x) for each in people
            ]
            self.perception.people.append((time_seconds(people[0].header.stamp), np.array(rows)))


class People(ObstaclesOverTime):
    """Persons where the simulation had them; between two of its reports they went straight on.

    Args:
        reports: Stamp [s], and x, y, radius (M, 3) of each person [m], of at least one report.
    """

    def __init__(self, reports: list[tuple[float, Array]]) -> None:
        self._times = np.array([time for time, _ in reports])
        self._positions = np.array([rows[:, :2] for _, rows in reports])
        super().__init__(reports[0][1][:, 2])

    def at(self, time: float) -> Array:
        """Return the positions (M, 2) at a ROS time [s]."""
        last = len(self._times) - 1
        along = float(np.interp(time, self._times, np.arange(last + 1.0)))
        before = min(math.floor(along), max(last - 1, 0))
        after = min(before + 1, last)
        share = along - before
        result: Array = (1.0 - share) * self._positions[before] + share * self._positions[after]
        return result
