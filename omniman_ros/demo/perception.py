"""What a robot's scanner, tracker and world tell while it drives to a goal among people."""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Self

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
from omniman_ros.core.parameters import build
from omniman_ros.nodes.obstacle_tracker_parameters import ScannerInput
from omniman_ros.surroundings.occupancy import OccupancyMap

Stamped = tuple[float, Array]  #: ROS time [s], and values at that time


@dataclass
class Perception:
    """What was perceived on the way to a goal."""

    scans: list[Stamped] = field(default_factory=list)  #: Points (k, 2) met, in base_link [m]
    tracks: list[Array] = field(default_factory=list)  #: (m, 4) x, y [m], x', y' [m/s] in odom
    map: OccupancyMap | None = None  #: The last map; None before the first
    people: list[Stamped] = field(default_factory=list)  #: (m, 3) true x, y and radius [m]


@contextmanager
def record_perception(node: Node) -> Iterator[Perception]:
    """Record what is perceived within the `with` block.

    The scanner is taken to be mounted as a `simulated_world` has it by default.
    """
    perception, mount = Perception(), build(ScannerInput, {}).mount

    def on_scan(message: LaserScan) -> None:
        scan = scan_from_message(message, mount, time_seconds)
        perception.scans.append((scan.end, scan.local_points(scan.hits)))

    def on_map(message: OccupancyGrid) -> None:
        perception.map = map_from_message(message)

    def on_tracks(message: PointCloud2) -> None:
        perception.tracks.append(tracked_obstacles(message)[:, :4])

    def on_people(message: MarkerArray) -> None:
        people = [marker for marker in message.markers if marker.type == Marker.CYLINDER]
        if people:
            rows = [(m.pose.position.x, m.pose.position.y, 0.5 * m.scale.x) for m in people]
            perception.people.append((time_seconds(people[0].header.stamp), np.array(rows)))

    subscriptions = [
        node.create_subscription(LaserScan, "scan", on_scan, qos_profile_sensor_data),
        node.create_subscription(OccupancyGrid, "map", on_map, 1),
        node.create_subscription(PointCloud2, "obstacle_tracks", on_tracks, 5),
        node.create_subscription(MarkerArray, "ground_truth/obstacles", on_people, 10),
    ]
    try:
        yield perception
    finally:
        for subscription in subscriptions:
            node.destroy_subscription(subscription)


class People:
    """Persons where the simulation had them; between two of its reports they went straight on.

    Args:
        reports: Stamp [s], and x, y, radius (M, 3) of each person [m], of at least one report.
    """

    def __init__(self, reports: list[Stamped]) -> None:
        self._times = np.array([time for time, _ in reports])
        self._positions = np.array([rows[:, :2] for _, rows in reports])
        self.radii: Array = reports[0][1][:, 2]

    @classmethod
    def of(cls, perception: Perception, start: float) -> Self:
        """Return the persons that were reported; nobody, from a ROS time [s] on, if none were."""
        return cls(perception.people or [(start, np.zeros((0, 3)))])

    def at(self, time: float) -> Array:
        """Return the positions (M, 2) at a ROS time [s]."""
        last = len(self._times) - 1
        along = float(np.interp(time, self._times, np.arange(last + 1.0)))
        before = min(math.floor(along), max(last - 1, 0))
        after = min(before + 1, last)
        ratio = along - before
        result: Array = (1.0 - ratio) * self._positions[before] + ratio * self._positions[after]
        return result
