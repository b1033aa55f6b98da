"""Recording of the topics that the robot publishes during the demo."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory, MultiDOFJointTrajectory

from omniman_ros.conversions.coupling import total_coupling_error
from omniman_ros.conversions.geometry import yaw_from_quaternion
from omniman_ros.conversions.headers import time_seconds
from omniman_ros.nodes.stop_interface import ALL_LATCHED

#: Number of messages of a topic that are kept until this process, held up by a busy machine, reads
#: them: those of 5 s at 200 Hz.
DEPTH = 1000
#: Values of one message, mostly a stamp [s] and the values at that time; see `DemoRecording`
Row = tuple[float, ...]
FRESH_POINTS = 6  #: Number of points of a preview that are due until the next one may change it
#: Time without the processor from which on a failure may be the machine's fault [s]
STALL_LIMIT = 0.15


@dataclass
class DemoRecording:
    """Values that the robot published, in the order of arrival.

    Stamps are ROS time [s], as the nodes have set them: how late a message reaches this process
    does not count. Poses are x, y, theta [m, m, rad].
    """

    #: Stamp, pose in odom, and twist x', y', theta' in base_link [m/s, m/s, rad/s]
    odom: list[Row] = field(default_factory=list)
    truth: list[Row] = field(default_factory=list)  #: Stamp and pose of the ground truth
    #: Stamp, and coupling error of each constraint, without resets [rad]
    coupling: list[Row] = field(default_factory=list)
    #: Time and pose on the path; times may repeat
    reference: list[Row] = field(default_factory=list)
    energy: list[Row] = field(default_factory=list)  #: Drawn by each motor since its start [J]
    arm: list[Row] = field(default_factory=list)  #: Stamp and measured joint angles [rad]
    #: Time and reference of the joint angles [rad]; times may repeat
    arm_reference: list[Row] = field(default_factory=list)
    #: Stamp and reference of the tool's position x, y, z in odom [m]
    tool_reference: list[Row] = field(default_factory=list)
    #: Intervals between two setpoints sent to the arm's controller [s]
    arm_intervals: list[float] = field(default_factory=list)
    #: Stamps of `wheel_commands`, or `wheel_voltages` in voltage mode [s]
    commands: list[float] = field(default_factory=list)
    contacts: list[str] | None = None  #: Each as "part, thing"; None without a physics world
    #: Longest time for which this process, and mostly the nodes beside it, did not run [s]
    stall: float = 0.0

    @property
    def stall_note(self) -> str:
        """Remark on a stalled machine, for the text of a failure; empty without a stall."""
        if self.stall <= STALL_LIMIT:
            return ""
        return f" (this machine stalled for {self.stall:.2f} s meanwhile: try again)"


class Recorder:
    """Subscriptions that record what the robot publishes, besides what its client tells.

    Args:
        contacts: Whether the robot is in a physics world, which tells contacts.
    """

    def __init__(self, node: Node, *, contacts: bool = False) -> None:
        self.recording = rows = DemoRecording(contacts=[] if contacts else None)
        self.health: dict[str, str] = {}  #: Last `wheel_health`, by wheel and other keys

        def record(
            kind: Any, topic: str, target: list[Any], convert: Callable[[Any], Iterable[Any]]
        ) -> None:
            node.create_subscription(kind, topic, lambda m: target.extend(convert(m)), DEPTH)

        record(Odometry, "odom", rows.odom, lambda m: [(*_pose(m), *_twist(m))])
        record(Odometry, "ground_truth/odom", rows.truth, lambda m: [_pose(m)])
        # Voltages are published instead of commands in voltage mode.
        for topic in ("wheel_commands", "wheel_voltages"):
            record(JointState, topic, rows.commands, lambda m: [_stamp(m)])
        record(JointState, "coupling_error", rows.coupling, _coupling_rows)
        record(Float64MultiArray, "wheel_electrical", rows.energy, lambda m: [tuple(m.data[2::3])])
        record(MultiDOFJointTrajectory, "path/reference", rows.reference, _reference_rows)
        record(JointState, "arm/joint_states", rows.arm, lambda m: [(_stamp(m), *m.position)])
        record(JointTrajectory, "arm/joint_reference", rows.arm_reference, _arm_reference_rows)
        record(PoseStamped, "tool_reference", rows.tool_reference, _tool_rows)
        record(Float64MultiArray, "arm/timing", rows.arm_intervals, _arm_intervals)
        node.create_subscription(DiagnosticStatus, "wheel_health", self._on_health, ALL_LATCHED)
        # Contacts are published only while there are some: no message must mean no contact.
        self._contacts = (
            node.create_subscription(DiagnosticArray, "contacts", self._on_contacts, 50)
            if contacts
            else None
        )

    @property
    def missing_topics(self) -> list[str]:
        """Topics of every robot that have not been received yet."""
        received = {
            "odom": self.recording.odom,
            "ground_truth/odom": self.recording.truth,
            "wheel_commands": self.recording.commands,
            "wheel_electrical": self.recording.energy,
            "coupling_error": self.recording.coupling,
        }
        missing = [topic for topic, rows in received.items() if not rows]
        if self._contacts is not None and not self._contacts.get_publisher_count():
            missing.append("contacts")
        return missing

    def _on_health(self, message: DiagnosticStatus) -> None:
        self.health = {item.key: item.value for item in message.values}

    def _on_contacts(self, message: DiagnosticArray) -> None:
        known = self.recording.contacts
        if known is not None:
            known += [status.name for status in message.status if status.name not in known]


def _stamp(message: Any) -> float:
    return time_seconds(message.header.stamp)


def _pose(message: Odometry) -> Row:
    pose = message.pose.pose
    yaw = yaw_from_quaternion(pose.orientation)
    return _stamp(message), pose.position.x, pose.position.y, yaw


def _twist(message: Odometry) -> Row:
    twist = message.twist.twist
    return twist.linear.x, twist.linear.y, twist.angular.z


def _coupling_rows(message: JointState) -> list[Row]:
    return [(_stamp(message), *total_coupling_error(message))]


def _reference_rows(message: MultiDOFJointTrajectory) -> list[Row]:
    rows: list[Row] = []
    for point in message.points[:FRESH_POINTS]:
        due = _stamp(message) + time_seconds(point.time_from_start)
        pose = point.transforms[0]
        yaw = yaw_from_quaternion(pose.rotation)
        rows.append((due, pose.translation.x, pose.translation.y, yaw))
    return rows


def _arm_reference_rows(message: JointTrajectory) -> list[Row]:
    return [
        (_stamp(message) + time_seconds(point.time_from_start), *point.positions)
        for point in message.points[:FRESH_POINTS]
    ]


def _tool_rows(message: PoseStamped) -> list[Row]:
    position = message.pose.position
    return [(_stamp(message), position.x, position.y, position.z)]


def _arm_intervals(message: Float64MultiArray) -> list[float]:
    return list(message.data[: message.layout.dim[0].size])
