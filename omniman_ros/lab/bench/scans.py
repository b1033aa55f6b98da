"""What the tracker makes of the scans of a simulated scanner."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # the command line must do without scipy and the engine
    from omniman_ros.perception.obstacle_tracker import ObstacleTracker
    from omniman_ros.perception.scan import Scan


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
