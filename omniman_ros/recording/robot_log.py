"""Recorded data of one robot, as arrays over a common time."""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from omniman_ros.conversions.coupling import total_coupling_error
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.recording.reader import BagReader
from omniman_ros.recording.ros_time import ArrivalClock

GAP = 0.5  #: Time without a reference from which two movements count as separate [s]
#: Keys of `mpc/status` that are numbers
PLANNER_FIGURES = ("solve_ms", "slack_m", "distance_m", "energy_j")
PLANNING_STATES = ("driving", "blocked")  #: States of the planner in which it solves
TOPIC_TYPES = {
    "odom": ("nav_msgs/msg/Odometry",),
    "ground_truth/odom": ("nav_msgs/msg/Odometry",),
    "cmd_vel": ("geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"),
    "wheel_states": ("sensor_msgs/msg/JointState",),
    "wheel_commands": ("sensor_msgs/msg/JointState",),
    "wheel_electrical": ("std_msgs/msg/Float64MultiArray",),
    "coupling_error": ("sensor_msgs/msg/JointState",),
    "path": ("nav_msgs/msg/Path",),
    "path/reference": ("trajectory_msgs/msg/MultiDOFJointTrajectory",),
    "body/reference": ("trajectory_msgs/msg/MultiDOFJointTrajectory",),
    "mpc/reference": ("trajectory_msgs/msg/MultiDOFJointTrajectory",),
    "mpc/plan": ("nav_msgs/msg/Path",),
    "mpc/status": ("diagnostic_msgs/msg/DiagnosticStatus",),
    "goal_pose": ("geometry_msgs/msg/PoseStamped",),
    "arm/joint_states": ("sensor_msgs/msg/JointState",),
    "arm/joint_reference": ("trajectory_msgs/msg/JointTrajectory",),
    "arm/timing": ("std_msgs/msg/Float64MultiArray",),
    "active_source": ("std_msgs/msg/String",),
}  #: Types of the topics that are read; topics of other robots may have the same names
#: Ends of the topics by which a robot is recognised
ROBOT_TOPICS = ("/odom", "/wheel_states", "/arm/joint_states")

_Row = tuple[float, ...]  #: Row of a table: time [s], then values


@dataclass
class RobotLog:
    """Tables (k, ...) of a robot's topics, whose first column is ROS time [s].

    The table of a topic that was not recorded is empty.
    """

    #: Pose x, y, theta and twist x', y', theta' of odometry
    odom: Array = field(default_factory=lambda: np.zeros((0, 7)))
    #: Pose and twist of the ground truth, likewise
    truth: Array = field(default_factory=lambda: np.zeros((0, 7)))
    #: Twist x', y', theta' of `cmd_vel`
    twist: Array = field(default_factory=lambda: np.zeros((0, 4)))
    wheel_names: tuple[str, ...] = ()  #: Names of the wheels
    #: Commanded speed of each wheel [rad/s]; NaN where none was commanded
    commanded: Array = field(default_factory=lambda: np.zeros((0, 1)))
    #: Measured speed of each wheel [rad/s]
    measured: Array = field(default_factory=lambda: np.zeros((0, 1)))
    #: Measured angle of each wheel [rad], as it was sent: a counter may wrap
    angles: Array = field(default_factory=lambda: np.zeros((0, 1)))
    #: Voltage [V], current [A] and energy [J] of each wheel, wheel by wheel
    electrical: Array = field(default_factory=lambda: np.zeros((0, 1)))
    #: Coupling error of each constraint, without resets if it was recorded [rad]
    coupling: Array = field(default_factory=lambda: np.zeros((0, 1)))
    #: Reference x, y, theta of the platform, by its source `path`, `body` or `mpc`; rows of NaN
    #: separate movements.
    references: dict[str, Array] = field(default_factory=dict)
    paths: list[Array] = field(default_factory=list)  #: Poses (n, 3) of each path that was sent
    #: Position x, y of the last pose of each plan
    plan_ends: Array = field(default_factory=lambda: np.zeros((0, 3)))
    goals: Array = field(default_factory=lambda: np.zeros((0, 4)))  #: Goals x, y, theta
    #: One column for each of `PLANNER_FIGURES`; NaN while the planner does not solve
    planner: Array = field(default_factory=lambda: np.zeros((0, 1 + len(PLANNER_FIGURES))))
    joint_names: tuple[str, ...] = ()  #: Names of the arm's joints
    arm: Array = field(default_factory=lambda: np.zeros((0, 1)))  #: Measured joint angles [rad]
    #: Reference of the joint angles [rad]; rows of NaN separate movements
    arm_reference: Array = field(default_factory=lambda: np.zeros((0, 1)))
    #: Intervals between two setpoints sent to the arm's controller [s]
    arm_intervals: Array = field(default_factory=lambda: np.zeros((0, 2)))
    #: Times [s] from which a source drove the platform, and the sources
    sources: list[tuple[float, str]] = field(default_factory=list)

    @property
    def span(self) -> tuple[float, float]:
        """First and last time of all tables [s]; InputError if all tables are empty."""
        tables = [t for t in vars(self).values() if isinstance(t, np.ndarray) and len(t)]
        if not tables:
            raise InputError("the recording contains no data of a robot")
        return min(float(t[0, 0]) for t in tables), max(float(t[-1, 0]) for t in tables)


def robot_namespaces(topics: Iterable[str]) -> list[str]:
    """Return the namespaces of the robots to which topics belong, sorted."""
    found = {
        topic.removesuffix(end).strip("/")
        for topic in topics
        for end in ROBOT_TOPICS
        if topic.endswith(end) and not topic.endswith("/ground_truth/odom")
    }
    return sorted(found)


def read_robot_log(
    bag: BagReader, namespace: str = "", wheel_names: tuple[str, ...] = ()
) -> RobotLog:
    """Read the topics of one robot.

    A message counts if it has as many values as the first message of its topic, and if its wheels
    are those of the first one, or of `wheel_names`, whose order the tables then have.

    Raises:
        InputError: The recording is damaged.
    """
    prefix = f"/{namespace}/" if namespace else "/"
    collector = _Collector(wheel_names)
    handlers = {
        prefix + name: handler
        for name, handler in collector.handlers.items()
        if bag.topic_types.get(prefix + name) in TOPIC_TYPES[name]
    }
    for topic, arrival, message in bag.messages(handlers):
        handlers[topic](arrival, message)
    return collector.log()


def reference_errors(poses: Array, reference: Array) -> Array:
    """Return the errors of poses relative to a reference at the same time.

    Args:
        poses: Rows (k, 4 or more) that begin with time, x, y, theta.
        reference: Rows (n, 4): time, x, y, theta; rows of NaN separate movements.

    Returns:
        Time, distance [m] and angle [rad], (k, 3); NaN where there is no reference.
    """
    times = poses[:, 0]
    if len(reference) < 2:
        return np.column_stack([times, np.full((len(times), 2), math.nan)])
    x, y, sine, cosine = (
        np.interp(times, reference[:, 0], column, math.nan, math.nan)
        for column in (
            reference[:, 1],
            reference[:, 2],
            np.sin(reference[:, 3]),
            np.cos(reference[:, 3]),
        )
    )
    distance = np.hypot(poses[:, 1] - x, poses[:, 2] - y)
    angle = poses[:, 3] - np.arctan2(sine, cosine)
    return np.column_stack([times, distance, np.arctan2(np.sin(angle), np.cos(angle))])


class _Collector:
    """Collects the rows of a robot's tables from messages; the handlers are by topic."""

    def __init__(self, wheel_names: tuple[str, ...]) -> None:
        self._stamped: dict[str, list[_Row]] = {}
        """Rows by table, whose time is a stamp."""
        self._unstamped: dict[str, list[_Row]] = {}
        """Rows by table, whose time is the arrival."""
        self._clock = ArrivalClock()
        self._previews: dict[str, list[list[_Row]]] = {}
        self._names = {"wheels": wheel_names} if wheel_names else {}
        self._paths: list[Array] = []
        self._sources: list[tuple[float, str]] = []
        self.handlers: dict[str, Callable[[float, Any], None]] = {
            "odom": self._on_odom,
            "ground_truth/odom": self._on_truth,
            "cmd_vel": self._on_twist,
            "wheel_states": self._wheel_handler("measured", "angles"),
            "wheel_commands": self._wheel_handler("commanded"),
            "wheel_electrical": self._on_electrical,
            "coupling_error": self._on_coupling,
            "path": self._on_path,
            "path/reference": self._preview_handler("path"),
            "body/reference": self._preview_handler("body"),
            "mpc/reference": self._preview_handler("mpc"),
            "mpc/plan": self._on_plan,
            "mpc/status": self._on_planner,
            "goal_pose": self._on_goal,
            "arm/joint_states": self._on_arm,
            "arm/joint_reference": self._on_arm_reference,
            "arm/timing": self._on_arm_timing,
            "active_source": self._on_source,
        }

    def log(self) -> RobotLog:
        """Return the collected data, with all times as ROS time."""
        log = RobotLog(
            wheel_names=self._names.get("wheels", ()),
            joint_names=self._names.get("arm", ()),
            paths=self._paths,
            references={n: _joined(p) for n, p in self._previews.items() if n != "arm"},
        )
        for name, rows in self._stamped.items():
            setattr(log, name, np.array(rows))
        for name, rows in self._unstamped.items():
            table = np.array(rows)
            table[:, 0] = self._clock.to_ros_time(table[:, 0])
            setattr(log, name, table)
        if "arm" in self._previews:
            log.arm_reference = _joined(self._previews["arm"])
        times = self._clock.to_ros_time(np.array([time for time, _ in self._sources]))
        log.sources = [(float(t), s) for t, (_, s) in zip(times, self._sources, strict=True)]
        return log

    def _on_odom(self, arrival: float, message: Any) -> None:
        _append(self._stamped, "odom", *_motion(message))
        self._clock.add(arrival, _seconds(message.header.stamp))

    def _on_truth(self, arrival: float, message: Any) -> None:
        _append(self._stamped, "truth", *_motion(message))

    def _on_twist(self, arrival: float, message: Any) -> None:
        twist = getattr(message, "twist", message)  # of a TwistStamped, or the Twist itself
        row = (arrival, twist.linear.x, twist.linear.y, twist.angular.z)
        _append(self._unstamped, "twist", *row)

    def _wheel_handler(
        self, speeds: str, angles: str | None = None
    ) -> Callable[[float, Any], None]:
        def on_wheels(arrival: float, message: Any) -> None:
            names = self._names.setdefault("wheels", tuple(message.name))
            if set(message.name) != set(names):
                return
            stamp = _seconds(message.header.stamp)
            # A zero stamp means now.
            rows = self._stamped if stamp else self._unstamped
            values = message.velocity if len(message.velocity) else [math.nan] * len(names)
            for table, row in ((speeds, values), (angles, message.position)):
                if table and len(row) == len(names):
                    by_name = dict(zip(message.name, row, strict=False))
                    _append(rows, table, stamp or arrival, *(by_name[wheel] for wheel in names))

        return on_wheels

    def _on_electrical(self, arrival: float, message: Any) -> None:
        if len(message.data) and len(message.data) % 3 == 0:
            _append(self._unstamped, "electrical", arrival, *message.data)

    def _on_coupling(self, arrival: float, message: Any) -> None:
        errors = total_coupling_error(message)
        if errors:
            _append(self._stamped, "coupling", _seconds(message.header.stamp), *errors)

    def _on_path(self, arrival: float, message: Any) -> None:
        if message.poses:
            self._paths.append(np.array([_pose(stamped.pose) for stamped in message.poses]))

    def _preview_handler(self, source: str) -> Callable[[float, Any], None]:
        def on_preview(arrival: float, message: Any) -> None:
            start = _seconds(message.header.stamp)
            rows: list[_Row] = []
            for point in message.points:
                for pose in point.transforms[:1]:
                    time = start + _seconds(point.time_from_start)
                    position = pose.translation
                    rows.append((time, position.x, position.y, _yaw(pose.rotation)))
            self._previews.setdefault(source, []).append(rows)

        return on_preview

    def _on_plan(self, arrival: float, message: Any) -> None:
        if message.poses:
            last = message.poses[-1].pose.position
            _append(self._unstamped, "plan_ends", arrival, last.x, last.y)

    def _on_planner(self, arrival: float, message: Any) -> None:
        status = {item.key: item.value for item in message.values}
        is_planning = status.get("state") in PLANNING_STATES
        figures = (_number(status, key) if is_planning else math.nan for key in PLANNER_FIGURES)
        _append(self._unstamped, "planner", arrival, *figures)

    def _on_goal(self, arrival: float, message: Any) -> None:
        _append(self._unstamped, "goals", arrival, *_pose(message.pose))

    def _on_arm(self, arrival: float, message: Any) -> None:
        names = self._names.setdefault("arm", tuple(message.name))
        if tuple(message.name) == names and len(message.position) == len(names):
            _append(self._stamped, "arm", _seconds(message.header.stamp), *message.position)

    def _on_arm_reference(self, arrival: float, message: Any) -> None:
        start = _seconds(message.header.stamp)
        rows = [
            (start + _seconds(point.time_from_start), *point.positions) for point in message.points
        ]
        self._previews.setdefault("arm", []).append(rows)

    def _on_arm_timing(self, arrival: float, message: Any) -> None:
        count = message.layout.dim[0].size if message.layout.dim else 0
        for interval in message.data[:count]:
            _append(self._unstamped, "arm_intervals", arrival, interval)

    def _on_source(self, arrival: float, message: Any) -> None:
        self._sources.append((arrival, message.data))


def _append(tables: dict[str, list[_Row]], name: str, *row: float) -> None:
    rows = tables.setdefault(name, [])
    if not rows or len(row) == len(rows[0]):
        rows.append(row)


def _joined(previews: list[list[_Row]]) -> Array:
    """Return the reference that consists of previews.

    Only the rows of each preview that are due before the next preview begins are used. Rows of NaN
    separate movements. Rows begin with the time [s].
    """
    previews = [rows for rows in previews if rows]
    width = len(previews[0][0]) if previews else 0
    previews = [rows for rows in previews if all(len(row) == width for row in rows)]
    kept: list[_Row] = []
    for rows, following in zip(previews, [*previews[1:], None][: len(previews)], strict=True):
        end = math.inf if following is None else following[0][0]
        new = [row for row in rows if row[0] < end and (not kept or row[0] > kept[-1][0])]
        if kept and new and new[0][0] - kept[-1][0] > GAP:
            kept.append((0.5 * (kept[-1][0] + new[0][0]), *[math.nan] * (len(new[0]) - 1)))
        kept += new
    return np.array(kept) if kept else np.zeros((0, 4))


def _number(values: Mapping[str, str], key: str) -> float:
    try:
        return float(values[key])
    except (KeyError, ValueError):
        return math.nan


def _seconds(stamp: Any) -> float:
    return float(stamp.sec) + 1e-9 * float(stamp.nanosec)


def _yaw(q: Any) -> float:
    return math.atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z))


def _pose(pose: Any) -> tuple[float, float, float]:
    return pose.position.x, pose.position.y, _yaw(pose.orientation)


def _motion(message: Any) -> _Row:
    twist = message.twist.twist
    return (
        _seconds(message.header.stamp),
        *_pose(message.pose.pose),
        twist.linear.x,
        twist.linear.y,
        twist.angular.z,
    )
