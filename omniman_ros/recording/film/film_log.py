"""What a film shows of a recording beside the tables of `RobotLog`."""

from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

import numpy as np

from omniman_ros.control.wheel_health import IDLE
from omniman_ros.conversions.maps import map_from_message
from omniman_ros.conversions.scans import scan_from_message
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.core.parameters import build
from omniman_ros.nodes.obstacle_tracker_parameters import ScannerInput
from omniman_ros.recording.reader import BagReader
from omniman_ros.recording.robot_log import RobotLog, read_robot_log
from omniman_ros.recording.ros_time import ArrivalClock
from omniman_ros.surroundings.occupancy import OccupancyMap

TOPIC_TYPES = {
    "odom": "nav_msgs/msg/Odometry",
    "wheel_states": "sensor_msgs/msg/JointState",
    "path": "nav_msgs/msg/Path",
    "tool_path": "nav_msgs/msg/Path",
    "joint_trajectory": "trajectory_msgs/msg/JointTrajectory",
    "mpc/plan": "nav_msgs/msg/Path",
    "map": "nav_msgs/msg/OccupancyGrid",
    "scan": "sensor_msgs/msg/LaserScan",
    "obstacles": "visualization_msgs/msg/MarkerArray",
    "ground_truth/obstacles": "visualization_msgs/msg/MarkerArray",
    "stop_state": "diagnostic_msgs/msg/DiagnosticStatus",
    "wheel_health": "diagnostic_msgs/msg/DiagnosticStatus",
}  #: Types of the topics that are read
CUBE, SPHERE, CYLINDER = 1, 2, 3
"""Types of markers that are drawn."""
ADD, DELETE = 0, 2
"""Actions of markers; any other one deletes all markers of a namespace."""
WITHOUT_TORQUE = ("dead", IDLE)  #: States in `wheel_health` of a wheel whose motor gives no torque
STOPPED = 2  #: Level of `stop_state` from which a node is stopped


T = TypeVar("T")


@dataclass(frozen=True)
class Solid:
    """An upright body."""

    is_round: bool  #: Whether it is an elliptic cylinder; else it is a box
    place: tuple[float, float, float]  #: x, y [m] and direction [rad] of its middle
    size: tuple[float, float]  #: Lengths along its own x and y [m]
    heights: tuple[float, float]  #: Heights of its lower and upper end [m]


class Series(Generic[T]):
    """Values over ROS time, each of which holds until the next one."""

    def __init__(self) -> None:
        self.times: list[float] = []
        self.values: list[T] = []

    def add(self, time: float, value: T) -> None:
        """Add a value that holds from a time on [s]."""
        index = bisect_right(self.times, time)
        self.times.insert(index, time)
        self.values.insert(index, value)

    def index(self, time: float) -> int:
        """Return the index of the value that holds at a time [s]; -1 before the first one."""
        return bisect_right(self.times, time) - 1

    def at(self, time: float, max_age: float = np.inf) -> T | None:
        """Return the value that holds at a time [s]; None if there is none, or it is too old."""
        index = self.index(time)
        if index < 0 or time - self.times[index] > max_age:
            return None
        return self.values[index]


@dataclass
class FilmLog:
    """What a film shows; times are ROS time [s], coordinates in `odom` unless stated otherwise.

    Attributes:
        paths, plans: Positions (n, 2) of each path that was sent, and of each plan [m].
    """

    robot: RobotLog  #: Tables of the robot
    #: (k, 1 + n) time and angle of each wheel [rad], in the order of `robot.wheel_names`
    wheels: Array = field(default_factory=lambda: np.zeros((0, 1)))
    paths: Series[Array] = field(default_factory=Series)
    #: Positions (n, 3) of each path of the tool that was sent [m]
    tool_paths: Series[Array] = field(default_factory=Series)
    #: Each joint trajectory that was sent
    trajectories: Series[None] = field(default_factory=Series)
    plans: Series[Array] = field(default_factory=Series)
    maps: Series[OccupancyMap] = field(default_factory=Series)
    #: Points (n, 2) that the beams of each scan met, in base_link [m]; the scanner is taken to be
    #: where `simulated_world` mounts it by default.
    scans: Series[Array] = field(default_factory=Series)
    #: Obstacles that are known to the robot
    obstacles: Series[tuple[Solid, ...]] = field(default_factory=Series)
    #: Bodies where the simulation has them, in its own frame
    world: Series[tuple[Solid, ...]] = field(default_factory=Series)
    #: By the name of a node, why it is stopped; empty while it is not
    stops: dict[str, Series[str]] = field(default_factory=dict)
    #: Names of the wheels without torque
    dead_wheels: Series[tuple[str, ...]] = field(default_factory=Series)

    def stop_reason(self, time: float) -> str:
        """Return why a node is stopped at a time [s]; empty if none is.

        Of several nodes, the one counts that was stopped first.
        """
        stopped = [
            (series.times[series.index(time)], reason)
            for series in self.stops.values()
            if (reason := series.at(time))
        ]
        return min(stopped)[1] if stopped else ""


def read_film_log(bag: BagReader, namespace: str = "") -> FilmLog:
    """Read what a film shows of one robot; messages that cannot be shown are left out.

    Raises:
        InputError: The recording is damaged, or contains no data of a robot.
    """
    prefix = f"/{namespace}/" if namespace else "/"
    log = FilmLog(read_robot_log(bag, namespace))
    _ = log.robot.span  # raises if there is nothing
    collector = _Collector(log)
    topics = {
        prefix + name: handler
        for name, handler in collector.handlers.items()
        if bag.topic_types.get(prefix + name) == TOPIC_TYPES[name]
    }
    clock = ArrivalClock()
    for _, arrival, message in bag.messages([prefix + "odom"]):
        clock.add(arrival, _seconds(message.header.stamp))
    received = list(bag.messages(topics))
    times = clock.to_ros_time(np.array([arrival for _, arrival, _ in received]))
    for time, (topic, _, message) in zip(times.tolist(), received, strict=True):
        try:
            topics[topic](time, message)
        except InputError:
            continue
    if collector.wheel_rows:
        log.wheels = np.array(collector.wheel_rows)
    return log


class _Collector:
    """Collects messages into a log."""

    def __init__(self, log: FilmLog) -> None:
        self._log = log
        self._mount = build(ScannerInput, {}).mount
        self.wheel_rows: list[tuple[float, ...]] = []
        self._markers: dict[tuple[str, int], tuple[Solid, float]] = {}
        """Obstacles by namespace and number, each with the time at which it ends [s]."""
        self.handlers: dict[str, Callable[[float, Any], None]] = {
            "wheel_states": self._on_wheels,
            "path": lambda time, message: log.paths.add(time, _positions(message)[:, :2]),
            "tool_path": lambda time, message: log.tool_paths.add(time, _positions(message)),
            "joint_trajectory": lambda time, message: log.trajectories.add(time, None),
            "mpc/plan": lambda time, message: log.plans.add(time, _positions(message)[:, :2]),
            "map": lambda time, message: log.maps.add(time, map_from_message(message)),
            "scan": self._on_scan,
            "obstacles": self._on_obstacles,
            "ground_truth/obstacles": self._on_world,
            "stop_state": self._on_stop,
            "wheel_health": self._on_health,
        }

    def _on_wheels(self, time: float, message: Any) -> None:
        names = self._log.robot.wheel_names
        angles = dict(zip(message.name, message.position, strict=False))
        if names and angles.keys() == set(names):
            row = tuple(float(angles[name]) for name in names)
            self.wheel_rows.append((_seconds(message.header.stamp) or time, *row))

    def _on_scan(self, time: float, message: Any) -> None:
        scan = scan_from_message(message, self._mount, _seconds)
        self._log.scans.add(_seconds(message.header.stamp) or time, scan.local_points(scan.hits))

    def _on_obstacles(self, time: float, message: Any) -> None:
        for marker in message.markers:
            key = (marker.ns, marker.id)
            if marker.action == ADD:
                lifetime = _seconds(marker.lifetime)
                self._markers[key] = _solid(marker), time + lifetime if lifetime else np.inf
            elif marker.action == DELETE:
                self._markers.pop(key, None)
            else:
                kept = {k: v for k, v in self._markers.items() if marker.ns and k[0] != marker.ns}
                self._markers = kept
        alive = tuple(solid for solid, end in self._markers.values() if end > time)
        self._log.obstacles.add(time, alive)

    def _on_world(self, time: float, message: Any) -> None:
        markers = [m for m in message.markers if m.type in (CUBE, SPHERE, CYLINDER)]
        if markers:
            stamp = _seconds(markers[0].header.stamp) or time
            self._log.world.add(stamp, tuple(_solid(marker) for marker in markers))

    def _on_stop(self, time: float, message: Any) -> None:
        reason = ""
        if message.level >= STOPPED:
            values = {item.key: item.value for item in message.values}
            reason = values.get("reason") or message.message
        self._log.stops.setdefault(message.name, Series()).add(time, reason)

    def _on_health(self, time: float, message: Any) -> None:
        dead = tuple(item.key for item in message.values if item.value in WITHOUT_TORQUE)
        self._log.dead_wheels.add(time, dead)


def _solid(marker: Any) -> Solid:
    """Return the body that a marker shows; InputError if a number of it is not finite."""
    position, scale, q = marker.pose.position, marker.scale, marker.pose.orientation
    yaw = float(np.arctan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z)))
    low, high = position.z - 0.5 * scale.z, position.z + 0.5 * scale.z
    numbers = (position.x, position.y, yaw, scale.x, scale.y, low, high)
    if not np.isfinite(numbers).all():
        raise InputError(f"marker '{marker.ns}' {marker.id} is not finite")
    place = (float(position.x), float(position.y), yaw)
    return Solid(marker.type != CUBE, place, (scale.x, scale.y), (float(low), float(high)))


def _positions(message: Any) -> Array:
    """Return the positions (n, 3) of a path [m]; InputError if a number of it is not finite."""
    points = [stamped.pose.position for stamped in message.poses]
    rows = np.array([(p.x, p.y, p.z) for p in points], dtype=float).reshape(-1, 3)
    if not np.isfinite(rows).all():
        raise InputError("a position is not finite")
    return rows


def _seconds(stamp: Any) -> float:
    return float(stamp.sec) + 1e-9 * float(stamp.nanosec)
