"""What the demo hears while the robot drives."""

import time
from dataclasses import dataclass, field

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, Float64MultiArray, String
from trajectory_msgs.msg import JointTrajectory, MultiDOFJointTrajectory

from omniman_ros.conversions import time_seconds, yaw

LATCHED = QoSProfile(depth=50, durability=DurabilityPolicy.TRANSIENT_LOCAL)
Row = tuple[float, ...]
FRESH = 6
"""Points of a preview of `path/reference` until about the next one."""


@dataclass
class Recording:
    """Rows as they came; stamps are ROS time, arrivals are on the steady clock, all in seconds.

    Attributes:
        odom: Stamp, x, y, theta, x', y', theta'.
        truth: Stamp, x, y, theta of the ground truth.
        coupling: Stamp, epsilon of each constraint [rad].
        reference: Stamp, x, y, theta of the path's reference; parts may be there twice.
        energy: Energy of each wheel since the start of the drive [J].
        arm: Stamp and measured joint angles [rad].
        arm_reference: Stamp and joint angles of what they should be; parts may be there twice.
        tool_reference: Stamp, x, y, z of where the tool is to be.
        arm_intervals: Between two setpoints on their way to the arm's controller [s].
        odom_arrivals, command_arrivals: When odom, and wheel_commands or wheel_voltages, came.
        stall: Longest time that this process was held up [s]; the nodes mostly were, too.
    """

    odom: list[Row] = field(default_factory=list)
    truth: list[Row] = field(default_factory=list)
    coupling: list[Row] = field(default_factory=list)
    reference: list[Row] = field(default_factory=list)
    energy: list[Row] = field(default_factory=list)
    arm: list[Row] = field(default_factory=list)
    arm_reference: list[Row] = field(default_factory=list)
    tool_reference: list[Row] = field(default_factory=list)
    arm_intervals: list[float] = field(default_factory=list)
    odom_arrivals: list[float] = field(default_factory=list)
    command_arrivals: list[float] = field(default_factory=list)
    stall: float = 0.0


class Recorder:
    """Subscribes to all of it.

    Attributes:
        recording: The rows.
        active_source: What the controller said last, or empty.
        progress: What `path_progress` said last.
        planner: What `mpc/status` said last, by key.
        health: What `wheel_health` said last, by wheel and other keys.
        stopped: Names of stopped nodes, with the reason.
    """

    def __init__(self, node: Node) -> None:
        self.recording = Recording()
        self.active_source = ""
        self.progress = 0.0
        self._underway = False
        self.health: dict[str, str] = {}
        self.planner: dict[str, str] = {}
        self.stopped: dict[str, str] = {}
        for kind, topic, handler, qos in (
            (Odometry, "odom", self._on_odom, 10),
            (Odometry, "ground_truth/odom", self._on_truth, 10),
            (JointState, "wheel_commands", self._on_command, 10),
            (JointState, "wheel_voltages", self._on_command, 10),  # instead, in voltage mode
            (JointState, "coupling_error", self._on_coupling, 10),
            (Float64MultiArray, "wheel_electrical", self._on_electrical, 10),
            (MultiDOFJointTrajectory, "path/reference", self._on_reference, 10),
            (JointState, "arm/joint_states", self._on_arm, 10),
            (JointTrajectory, "arm/joint_reference", self._on_arm_reference, 10),
            (PoseStamped, "tool_reference", self._on_tool_reference, 10),
            (Float64MultiArray, "arm/timing", self._on_arm_timing, 10),
            (Float64, "path_progress", self._on_progress, 10),
            (DiagnosticStatus, "mpc/status", self._on_planner, 10),
            (String, "active_source", self._on_source, LATCHED),
            (DiagnosticStatus, "stop_state", self._on_stop_state, LATCHED),
            (DiagnosticStatus, "wheel_health", self._on_health, LATCHED),
        ):
            node.create_subscription(kind, topic, handler, qos)

    @property
    def has_arm(self) -> bool:
        """Whether an arm has said where it is."""
        return bool(self.recording.arm)

    @property
    def missing(self) -> list[str]:
        """Topics that have said nothing yet."""
        heard = {
            "odom": self.recording.odom,
            "ground_truth/odom": self.recording.truth,
            "wheel_commands": self.recording.command_arrivals,
            "wheel_electrical": self.recording.energy,
            "coupling_error": self.recording.coupling,
            "active_source": self.active_source,
        }
        return [topic for topic, rows in heard.items() if not rows]

    def _on_odom(self, message: Odometry) -> None:
        self.recording.odom_arrivals.append(time.monotonic())
        twist = message.twist.twist
        self.recording.odom.append(
            (*_stamped_pose(message), twist.linear.x, twist.linear.y, twist.angular.z)
        )

    def _on_truth(self, message: Odometry) -> None:
        self.recording.truth.append(_stamped_pose(message))

    def _on_command(self, message: JointState) -> None:
        self.recording.command_arrivals.append(time.monotonic())

    def _on_coupling(self, message: JointState) -> None:
        stamp = time_seconds(message.header.stamp)
        self.recording.coupling.append((stamp, *message.position))

    def _on_electrical(self, message: Float64MultiArray) -> None:
        self.recording.energy.append(tuple(message.data[2::3]))

    def _on_reference(self, message: MultiDOFJointTrajectory) -> None:
        """The ticks until about the next preview; the rest of this one may still be changed."""
        stamp = time_seconds(message.header.stamp)
        for point in message.points[:FRESH]:
            place = point.transforms[0].translation
            self.recording.reference.append(
                (
                    stamp + time_seconds(point.time_from_start), place.x, place.y,
                    yaw(point.transforms[0].rotation),
                )
            )  # fmt: skip

    def _on_arm(self, message: JointState) -> None:
        self.recording.arm.append((time_seconds(message.header.stamp), *message.position))

    def _on_arm_reference(self, message: JointTrajectory) -> None:
        stamp = time_seconds(message.header.stamp)
        for point in message.points[:FRESH]:
            at = stamp + time_seconds(point.time_from_start)
            self.recording.arm_reference.append((at, *point.positions))

    def _on_tool_reference(self, message: PoseStamped) -> None:
        place = message.pose.position
        stamp = time_seconds(message.header.stamp)
        self.recording.tool_reference.append((stamp, place.x, place.y, place.z))

    def _on_arm_timing(self, message: Float64MultiArray) -> None:
        count = message.layout.dim[0].size
        self.recording.arm_intervals.extend(message.data[:count])

    def begin(self) -> None:
        """Note that a motion begins."""
        self.progress, self._underway = 0.0, False

    @property
    def arrived(self) -> bool:
        """Whether what was begun last is at its end; the one before may still say so late."""
        return self._underway and self.progress >= 1.0

    def _on_progress(self, message: Float64) -> None:
        self._underway = self._underway or message.data < 1.0
        self.progress = message.data if self._underway else 0.0

    def _on_source(self, message: String) -> None:
        self.active_source = message.data

    def _on_health(self, message: DiagnosticStatus) -> None:
        self.health = {item.key: item.value for item in message.values}

    def _on_planner(self, message: DiagnosticStatus) -> None:
        self.planner = {item.key: item.value for item in message.values}

    def _on_stop_state(self, message: DiagnosticStatus) -> None:
        if message.level == DiagnosticStatus.ERROR:
            self.stopped[message.name] = message.message
        else:
            self.stopped.pop(message.name, None)


def _stamped_pose(message: Odometry) -> Row:
    pose = message.pose.pose
    return (
        time_seconds(message.header.stamp), pose.position.x, pose.position.y,
        yaw(pose.orientation),
    )  # fmt: skip
