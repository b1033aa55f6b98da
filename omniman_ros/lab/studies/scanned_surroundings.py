"""What a robot makes of the scans of its simulated scanners."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from omniman_ros.collision.footprint import Footprint
from omniman_ros.core import se2
from omniman_ros.core.arrays import Array
from omniman_ros.simulation.world.scanner_parameters import ScannerParameters

if TYPE_CHECKING:  # the command line must do without scipy and the engine
    from omniman_ros.perception.obstacle_tracker import ObstacleTracker
    from omniman_ros.perception.scan import Scan
    from omniman_ros.perception.track import TrackedObstacle
    from omniman_ros.simulation.world.world import World

SCAN_PERIOD, MAP_PERIOD = 0.05, 0.2  #: Periods of the scans, and of the map made of them [s]


class ScannedSurroundings:
    """Obstacles and map of a robot in a physics world, by its laser scanners.

    Args:
        world: The world.
        mountings: The scanners, which measure one after the other in a scan's period.
        seed: Seed of their noise.
    """

    def __init__(self, world: "World", mountings: Sequence[ScannerParameters], seed: int) -> None:
        from omniman_ros.simulation.world.scanner import Scanner  # needs the engine

        self.tracker = new_tracker()
        self._scanners = [Scanner(world, each, seed + k) for k, each in enumerate(mountings)]
        self._next_scan = self._next_map = -math.inf

    def add_pose(self, time: float, pose: Array, twist: Array) -> None:
        """Use a measured pose (3,) in odom and a twist (3,) in the robot's frame at a time [s]."""
        self.tracker.add_pose(time, pose, se2.to_world(float(pose[2]), twist))

    def scan(self, time: float, own: Footprint) -> "list[TrackedObstacle] | None":
        """Return what moves at the time of the last pose [s]; None if no scan is due."""
        if time < self._next_scan - 1e-9:
            return None
        self._next_scan = time + SCAN_PERIOD
        for number, scanner in enumerate(self._scanners):
            self.tracker.add_scan(scan_of(scanner, time), own, number)
        return self.tracker.obstacles(time)

    def is_map_due(self, time: float) -> bool:
        """Return whether a map is to be made at a time [s]: then, the next one is later."""
        is_due = time >= self._next_map - 1e-9
        if is_due:
            self._next_map = time + MAP_PERIOD
        return is_due


def new_tracker() -> "ObstacleTracker":
    """Return a tracker with the default parameters."""
    from omniman_ros.perception.obstacle_tracker import ObstacleTracker
    from omniman_ros.perception.parameters import MapParameters, TrackerParameters
    from omniman_ros.surroundings.tracking import TrackingParameters

    return ObstacleTracker(TrackerParameters(), MapParameters(), TrackingParameters())


def scan_of(scanner: Any, time: float) -> "Scan":
    """Return a scan of a `Scanner` at a time [s]."""
    from omniman_ros.perception.scan import Scan

    p = scanner.parameters
    return Scan(
        time,
        scanner.scan(),
        -0.5 * p.field_of_view,
        p.field_of_view / (p.beams - 1),
        p.range_max,
        (p.x, p.y, p.yaw),
        heights=(p.z, p.z),
    )
