"""What a recording has of one robot, as arrays over one time."""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniman_ros.bag.reader import BagReader
from omniman_ros.core.errors import InputError

Array = NDArray[np.float64]

HOLE = 0.5
"""Time without a reference from which two movements are told apart [s]."""
PLANNER = ("solve_ms", "slack_m", "distance_m", "energy_j")
"""Keys of `mpc/status`."""
AT_WORK = ("driving", "blocked")
"""States of the planner in which it solves."""
KINDS = {
    "odom": ("nav_msgs/msg/Odometry",),
    "ground_truth/odom": ("nav_msgs/msg/Odometry",),
    "cmd_vel": ("geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"),
    "wheel_states": ("sensor_msgs/msg/JointState",),
    "wheel_commands": ("sensor_msgs/msg/JointState",),
    "wheel_electrical": ("std_msgs/msg/Float64MultiArray",),
    "coupling_error": ("sensor_msgs/msg/JointState",),
    "path": ("nav_msgs/msg/Path",),
    "path/reference": ("trajectory_msgs/msg/MultiDOFJointTrajectory",),
    "mpc/reference": ("trajectory_msgs/msg/MultiDOFJointTrajectory",),
    "mpc/plan": ("nav_msgs/msg/Path",),
    "mpc/status": ("diagnostic_msgs/msg/DiagnosticStatus",),
    "goal_pose": ("geometry_msgs/msg/PoseStamped",),
    "arm/joint_states": ("sensor_msgs/msg/JointState",),
    "arm/joint_reference": ("trajectory_msgs/msg/JointTrajectory",),
    "arm/timing": ("std_msgs/msg/Float64MultiArray",),
    "active_source": ("std_msgs/msg/String",),
}
"""Types of the topics; those of other robots may have the same names."""


@dataclass
class RobotLog:
    """Tables (k, ...) whose first column is the time: stamps in ROS time [s]; empty without topic.

    Attributes:
        odom: x, y, theta, x', y', theta'.
        truth: Pose and twist of the ground truth likewise.
        twist: x', y', theta' of `cmd_vel`.
        wheels: Names of the wheels.
        commanded, measured: Speed of each wheel [rad/s]; NaN where none was commanded.
        electrical: Voltage [V], current [A] and energy [J] of each wheel, wheel by wheel.
        coupling: Error of each constraint [rad].
        references: x, y, theta of what was to be followed, by `path` and `mpc`; rows of NaN
            between movements.
        paths: Poses (n, 3) of each path that was sent.
        plan_ends: x, y of the last pose of each plan.
        goals: x, y, theta.
        planner: One column for each key of PLANNER; NaN while it has nothing to do.
        joints: Names of the arm's joints.
        arm: Measured angles [rad].
        arm_reference: The angles that were asked for; rows of NaN between movements.
        intervals: Between setpoints on their way to the arm's controller [s].
        sources: Who drove from when on.
    """

    odom: Array = field(default_factory=lambda: np.zeros((0, 7)))
    truth: Array = field(default_factory=lambda: np.zeros((0, 7)))
    twist: Array = field(default_factory=lambda: np.zeros((0, 4)))
    wheels: tuple[str, ...] = ()
    commanded: Array = field(default_factory=lambda: np.zeros((0, 1)))
    measured: Array = field(default_factory=lambda: np.zeros((0, 1)))
    electrical: Array = field(default_factory=lambda: np.zeros((0, 1)))
    coupling: Array = field(default_factory=lambda: np.zeros((0, 1)))
    references: dict[str, Array] = field(default_factory=dict)
    paths: list[Array] = field(default_factory=list)
    plan_ends: Array = field(default_factory=lambda: np.zeros((0, 3)))
    goals: Array = field(default_factory=lambda: np.zeros((0, 4)))
    planner: Array = field(default_factory=lambda: np.zeros((0, 1 + len(PLANNER))))
    joints: tuple[str, ...] = ()
    arm: Array = field(default_factory=lambda: np.zeros((0, 1)))
    arm_reference: Array = field(default_factory=lambda: np.zeros((0, 1)))
    intervals: Array = field(default_factory=lambda: np.zeros((0, 2)))
    sources: list[tuple[float, str]] = field(default_factory=list)

    @property
    def span(self) -> tuple[float, float]:
        """First and last time of all tables [s]."""
        tables = [t for t in vars(self).values() if isinstance(t, np.ndarray) and len(t)]
        if not tables:
            raise InputError("nothing of a robot is in it")
        return min(float(t[0, 0]) for t in tables), max(float(t[-1, 0]) for t in tables)


def namespaces(topics: Iterable[str]) -> list[str]:
    """Namespaces of the robots whose topics these are; empty: none."""
    marks = ("/odom", "/wheel_states", "/arm/joint_states")
    found = {
        topic.removesuffix(mark).strip("/")
        for topic in topics
        for mark in marks
        if topic.endswith(mark) and not topic.endswith("/ground_truth/odom")
    }
    return sorted(found)


def read(bag: BagReader, namespace: str = "") -> RobotLog:
    """Read one robot's topics; of each topic the messages that are like its first.

    Args:
        bag: The open recording.
        namespace: Of the robot.
    """
    prefix = f"/{namespace}/" if namespace else "/"
    reader = _Reader()
    handlers = {
        prefix + name: handler
        for name, handler in reader.handlers.items()
        if bag.kinds.get(prefix + name) in KINDS[name]
    }
    for topic, arrival, message in bag.messages(handlers):
        handlers[topic](arrival, message)
    return reader.log()


class _Reader:
    """Collects rows; each handler takes the time of arrival and a message of any library."""

    def __init__(self) -> None:
        self._rows: dict[str, list[tuple[float, ...]]] = {}
        self._arrivals: list[tuple[float, float]] = []
        self._previews: dict[str, list[list[tuple[float, ...]]]] = {}
        self._names: dict[str, tuple[str, ...]] = {}
        self._paths: list[Array] = []
        self._sources: list[tuple[float, str]] = []
        self.handlers: dict[str, Callable[[float, Any], None]] = {
            "odom": self._on_odom,
            "ground_truth/odom": self._on_truth,
            "cmd_vel": self._on_twist,
            "wheel_states": self._on_wheels("measured"),
            "wheel_commands": self._on_wheels("commanded"),
            "wheel_electrical": self._on_electrical,
            "coupling_error": self._on_coupling,
            "path": self._on_path,
            "path/reference": self._on_preview("path"),
            "mpc/reference": self._on_preview("mpc"),
            "mpc/plan": self._on_plan,
            "mpc/status": self._on_planner,
            "goal_pose": self._on_goal,
            "arm/joint_states": self._on_arm,
            "arm/joint_reference": self._on_arm_reference,
            "arm/timing": self._on_timing,
            "active_source": self._on_source,
        }

    def log(self) -> RobotLog:
        """All that was collected, with arrivals as stamps."""
        clock = np.array(self._arrivals).reshape(-1, 2)

        def stamped(arrivals: Array) -> Array:
            """Stamps of arrivals: they differ much in simulated time."""
            if not len(clock):
                return arrivals
            ahead = np.interp(arrivals, clock[:, 0], clock[:, 1] - clock[:, 0])
            return np.asarray(arrivals + ahead)

        log = RobotLog(
            wheels=self._names.get("wheels", ()),
            joints=self._names.get("arm", ()),
            paths=self._paths,
            references={n: _joined(p) for n, p in self._previews.items() if n != "arm"},
        )
        for name, rows in self._rows.items():
            table = np.array(rows)
            if name.startswith("heard "):
                table[:, 0] = stamped(table[:, 0])
            setattr(log, name.removeprefix("heard "), table)
        if "arm" in self._previews:
            log.arm_reference = _joined(self._previews["arm"])
        times = stamped(np.array([time for time, _ in self._sources]))
        log.sources = [(float(t), s) for t, (_, s) in zip(times, self._sources, strict=True)]
        return log

    def _add(self, name: str, *row: float) -> None:
        rows = self._rows.setdefault(name, [])
        if not rows or len(row) == len(rows[0]):
            rows.append(row)

    # ---- one for each topic -----------------------------------------------------------------

    def _on_odom(self, arrival: float, message: Any) -> None:
        self._add("odom", *_motion(message))
        self._arrivals.append((arrival, _seconds(message.header.stamp)))

    def _on_truth(self, arrival: float, message: Any) -> None:
        self._add("truth", *_motion(message))

    def _on_twist(self, arrival: float, message: Any) -> None:
        twist = getattr(message, "twist", message)  # stamped or not
        self._add("heard twist", arrival, twist.linear.x, twist.linear.y, twist.angular.z)

    def _on_wheels(self, name: str) -> Callable[[float, Any], None]:
        def take(arrival: float, message: Any) -> None:
            names = self._names.setdefault("wheels", tuple(message.name))
            speeds = message.velocity if len(message.velocity) else np.full(len(names), math.nan)
            by_name = dict(zip(message.name, speeds, strict=False))
            if len(speeds) == len(names) and by_name.keys() == set(names):
                stamp = _seconds(message.header.stamp)
                ordered = [by_name[wheel] for wheel in names]
                # A zero stamp means now.
                self._add(name if stamp else f"heard {name}", stamp or arrival, *ordered)

        return take

    def _on_electrical(self, arrival: float, message: Any) -> None:
        if len(message.data) and len(message.data) % 3 == 0:
            self._add("heard electrical", arrival, *message.data)

    def _on_coupling(self, arrival: float, message: Any) -> None:
        if len(message.position):
            self._add("coupling", _seconds(message.header.stamp), *message.position)

    def _on_path(self, arrival: float, message: Any) -> None:
        if message.poses:
            self._paths.append(np.array([_pose(stamped.pose) for stamped in message.poses]))

    def _on_preview(self, name: str) -> Callable[[float, Any], None]:
        def take(arrival: float, message: Any) -> None:
            start = _seconds(message.header.stamp)
            rows: list[tuple[float, ...]] = []
            for point in message.points:
                for pose in point.transforms[:1]:
                    place = pose.translation
                    rows.append((start + _seconds(point.time_from_start), place.x, place.y,
                                 _yaw(pose.rotation)))  # fmt: skip
            self._previews.setdefault(name, []).append(rows)

        return take

    def _on_plan(self, arrival: float, message: Any) -> None:
        if message.poses:
            last = message.poses[-1].pose.position
            self._add("heard plan_ends", arrival, last.x, last.y)

    def _on_planner(self, arrival: float, message: Any) -> None:
        said = {item.key: item.value for item in message.values}
        at_work = said.get("state") in AT_WORK
        values = (_number(said, key) if at_work else math.nan for key in PLANNER)
        self._add("heard planner", arrival, *values)

    def _on_goal(self, arrival: float, message: Any) -> None:
        self._add("heard goals", arrival, *_pose(message.pose))

    def _on_arm(self, arrival: float, message: Any) -> None:
        names = self._names.setdefault("arm", tuple(message.name))
        if tuple(message.name) == names and len(message.position) == len(names):
            self._add("arm", _seconds(message.header.stamp), *message.position)

    def _on_arm_reference(self, arrival: float, message: Any) -> None:
        start = _seconds(message.header.stamp)
        rows = [
            (start + _seconds(point.time_from_start), *point.positions) for point in message.points
        ]
        self._previews.setdefault("arm", []).append(rows)

    def _on_timing(self, arrival: float, message: Any) -> None:
        count = message.layout.dim[0].size if message.layout.dim else 0
        for interval in message.data[:count]:
            self._add("heard intervals", arrival, interval)

    def _on_source(self, arrival: float, message: Any) -> None:
        self._sources.append((arrival, message.data))


def _joined(previews: list[list[tuple[float, ...]]]) -> Array:
    """What was followed: of each preview what came before the next; NaN between movements."""
    previews = [rows for rows in previews if rows]
    width = len(previews[0][0]) if previews else 0
    previews = [rows for rows in previews if all(len(row) == width for row in rows)]
    kept: list[tuple[float, ...]] = []
    for rows, after in zip(previews, [*previews[1:], None][: len(previews)], strict=True):
        until = math.inf if after is None else after[0][0]
        fresh = [row for row in rows if row[0] < until and (not kept or row[0] > kept[-1][0])]
        if kept and fresh and fresh[0][0] - kept[-1][0] > HOLE:
            kept.append((0.5 * (kept[-1][0] + fresh[0][0]), *[math.nan] * (len(fresh[0]) - 1)))
        kept += fresh
    return np.array(kept) if kept else np.zeros((0, 4))


def off_reference(poses: Array, reference: Array) -> Array:
    """Distance [m] and angle [rad] of poses from a reference at their times.

    Args:
        poses: Time, x, y, theta, (k, 4 or more).
        reference: Time, x, y, theta, (n, 4); rows of NaN between movements.

    Returns:
        Time, distance and angle, (k, 3); NaN where there is no reference.
    """
    times = poses[:, 0]
    if len(reference) < 2:
        return np.column_stack([times, np.full((len(times), 2), math.nan)])
    at = [np.interp(times, reference[:, 0], column, math.nan, math.nan)
          for column in (reference[:, 1], reference[:, 2], np.sin(reference[:, 3]),
                         np.cos(reference[:, 3]))]  # fmt: skip
    distance = np.hypot(poses[:, 1] - at[0], poses[:, 2] - at[1])
    off = poses[:, 3] - np.arctan2(at[2], at[3])
    return np.column_stack([times, distance, np.arctan2(np.sin(off), np.cos(off))])


def _number(said: Mapping[str, str], key: str) -> float:
    try:
        return float(said[key])
    except (KeyError, ValueError):
        return math.nan


def _seconds(stamp: Any) -> float:
    return float(stamp.sec) + 1e-9 * float(stamp.nanosec)


def _yaw(q: Any) -> float:
    return math.atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z))


def _pose(pose: Any) -> tuple[float, float, float]:
    return pose.position.x, pose.position.y, _yaw(pose.orientation)


def _motion(message: Any) -> tuple[float, ...]:
    twist = message.twist.twist
    return (
        _seconds(message.header.stamp), *_pose(message.pose.pose),
        twist.linear.x, twist.linear.y, twist.angular.z,
    )  # fmt: skip
