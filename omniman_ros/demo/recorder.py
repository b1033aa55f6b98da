"""Recording of the topics that the robot publishes during the demo."""

from dataclasses import dataclass, field

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, Float64MultiArray, String
from trajectory_msgs.msg import JointTrajectory, MultiDOFJointTrajectory

from omniman_ros.conversions.coupling import total_coupling_error
from omniman_ros.conversions.geometry import yaw_from_quaternion
from omniman_ros.conversions.headers import time_seconds

LATCHED = QoSProfile(depth=50, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""Quality of service of topics whose last messages reach late subscribers."""
DEPTH = 1000
"""Number of messages of a topic that are kept until this process, held up by a busy machine, reads
them: those of 5 s at 200 Hz."""
Row = tuple[float, ...]
"""Values of one message, mostly a stamp [s] and the values at that time; see `Recording`."""
FRESH_POINTS = 6
"""Number of points of a preview that are due until about the arrival of the next preview."""
STALL_LIMIT = 0.15
"""Time without the processor from which on a failure may be the machine's fault [s]."""


@dataclass
class Recording:
    """Values that the robot published, in the order of arrival.

    Stamps are ROS time [s], as the nodes have set them: how late a message reaches this process
    does not count.

    Attributes:
        odom: Stamp, pose x, y, theta in odom [m, m, rad] and twist x', y', theta' in base_link
            [m/s, m/s, rad/s].
        truth: Stamp and pose x, y, theta of the ground truth [m, m, rad].
        coupling: Stamp and coupling error of each constraint, without resets [rad].
        reference: Time and pose x, y, theta of the path's reference [m, m, rad]; times may repeat.
        energy: Energy drawn by the motor of each wheel since the start of its drive [J].
        arm: Stamp and measured joint angles [rad].
        arm_reference: Time and reference of the joint angles [rad]; times may repeat.
        tool_reference: Stamp and reference of the tool's position x, y, z in odom [m].
        arm_intervals: Intervals between two setpoints sent to the arm's controller [s].
        commands: Stamps of `wheel_commands`, or `wheel_voltages` in voltage mode.
        contacts: What the robot touched, each as "part, thing"; None without a physics world.
        stall: Longest time for which this process did not run [s]. On the same machine, the nodes
            mostly did not run either.
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
    commands: list[float] = field(default_factory=list)
    contacts: list[str] | None = None
    stall: float = 0.0

    @property
    def stall_note(self) -> str:
        """Remark on a stalled machine, for the text of a failure; empty without a stall."""
        if self.stall <= STALL_LIMIT:
            return ""
        return f" (this machine stalled for {self.stall:.2f} s meanwhile: try again)"


class Recorder:
    """Subscriptions that record the robot's topics and keep its latest state.

    Args:
        node: Node that owns the subscriptions.
        contacts: Whether the robot is in a physics world, which tells contacts.

    Attributes:
        recording: Values that have been recorded.
        active_source: Last `active_source`, which drives the platform; empty before the first.
        progress: Last `path_progress` of the motion that `begin_motion` announced, from 0 to 1.
        planner: Values of the last `mpc/status`, by key.
        health: Values of the last `wheel_health`, by wheel and other keys.
        stopped: Reason why a node is stopped, by the name of the node.
    """

    def __init__(self, node: Node, *, contacts: bool = False) -> None:
        self.recording = Recording(contacts=[] if contacts else None)
        self.active_source = ""
        self.progress = 0.0
        self._has_started = False
        self.health: dict[str, str] = {}
        self.planner: dict[str, str] = {}
        self.stopped: dict[str, str] = {}
        for message_type, topic, callback, qos in (
            (Odometry, "odom", self._on_odom, DEPTH),
            (Odometry, "ground_truth/odom", self._on_truth, DEPTH),
            (JointState, "wheel_commands", self._on_command, DEPTH),
            (JointState, "wheel_voltages", self._on_command, DEPTH),  # instead, in voltage mode
            (JointState, "coupling_error", self._on_coupling, DEPTH),
            (Float64MultiArray, "wheel_electrical", self._on_electrical, DEPTH),
            (MultiDOFJointTrajectory, "path/reference", self._on_reference, DEPTH),
            (JointState, "arm/joint_states", self._on_arm, DEPTH),
            (JointTrajectory, "arm/joint_reference", self._on_arm_reference, DEPTH),
            (PoseStamped, "tool_reference", self._on_tool_reference, DEPTH),
            (Float64MultiArray, "arm/timing", self._on_arm_timing, DEPTH),
            (Float64, "path_progress", self.on_progress, DEPTH),
            (DiagnosticStatus, "mpc/status", self._on_planner, DEPTH),
            (String, "active_source", self._on_source, LATCHED),
            (DiagnosticStatus, "stop_state", self._on_stop_state, LATCHED),
            (DiagnosticStatus, "wheel_health", self._on_health, LATCHED),
        ):
            node.create_subscription(message_type, topic, callback, qos)
        # Contacts are published only while there are some: no message must mean no contact.
        self._contacts = (
            node.create_subscription(DiagnosticArray, "contacts", self._on_contacts, 50)
            if contacts
            else None
        )

    @property
    def has_arm_states(self) -> bool:
        """Whether an arm has reported its joint angles."""
        return bool(self.recording.arm)

    @property
    def missing_topics(self) -> list[str]:
        """Topics of every robot that have not been received yet."""
        received = {
            "odom": self.recording.odom,
            "ground_truth/odom": self.recording.truth,
            "wheel_commands": self.recording.commands,
            "wheel_electrical": self.recording.energy,
            "coupling_error": self.recording.coupling,
            "active_source": self.active_source,
        }
        missing = [topic for topic, rows in received.items() if not rows]
        if self._contacts is not None and not self._contacts.get_publisher_count():
            missing.append("contacts")
        return missing

    def begin_motion(self) -> None:
        """Prepare for the progress of a new motion."""
        self.progress, self._has_started = 0.0, False

    @property
    def has_arrived(self) -> bool:
        """Whether the motion that `begin_motion` announced has reached its end.

        A late report about the end of the previous motion is ignored.
        """
        return self._has_started and self.progress >= 1.0

    def on_progress(self, message: Float64) -> None:
        """Update the progress of the motion under way."""
        self._has_started = self._has_started or message.data < 1.0
        self.progress = message.data if self._has_started else 0.0

    def _on_odom(self, message: Odometry) -> None:
        twist = message.twist.twist
        self.recording.odom.append(
            (*_stamped_pose(message), twist.linear.x, twist.linear.y, twist.angular.z)
        )

    def _on_truth(self, message: Odometry) -> None:
        self.recording.truth.append(_stamped_pose(message))

    def _on_command(self, message: JointState) -> None:
        self.recording.commands.append(time_seconds(message.header.stamp))

    def _on_coupling(self, message: JointState) -> None:
        stamp = time_seconds(message.header.stamp)
        self.recording.coupling.append((stamp, *total_coupling_error(message)))

    def _on_electrical(self, message: Float64MultiArray) -> None:
        self.recording.energy.append(tuple(message.data[2::3]))

    def _on_reference(self, message: MultiDOFJointTrajectory) -> None:
        """Record the points that are due before the next preview, which may change the others."""
        stamp = time_seconds(message.header.stamp)
        for point in message.points[:FRESH_POINTS]:
            position = point.transforms[0].translation
            self.recording.reference.append(
                (
                    stamp + time_seconds(point.time_from_start),
                    position.x,
                    position.y,
                    yaw_from_quaternion(point.transforms[0].rotation),
                )
            )

    def _on_arm(self, message: JointState) -> None:
        self.recording.arm.append((time_seconds(message.header.stamp), *message.position))

    def _on_arm_reference(self, message: JointTrajectory) -> None:
        stamp = time_seconds(message.header.stamp)
        for point in message.points[:FRESH_POINTS]:
            due = stamp + time_seconds(point.time_from_start)
            self.recording.arm_reference.append((due, *point.positions))

    def _on_tool_reference(self, message: PoseStamped) -> None:
        position = message.pose.position
        stamp = time_seconds(message.header.stamp)
        self.recording.tool_reference.append((stamp, position.x, position.y, position.z))

    def _on_arm_timing(self, message: Float64MultiArray) -> None:
        count = message.layout.dim[0].size
        self.recording.arm_intervals.extend(message.data[:count])

    def _on_source(self, message: String) -> None:
        self.active_source = message.data

    def _on_health(self, message: DiagnosticStatus) -> None:
        self.health = {item.key: item.value for item in message.values}

    def _on_planner(self, message: DiagnosticStatus) -> None:
        self.planner = {item.key: item.value for item in message.values}

    def _on_contacts(self, message: DiagnosticArray) -> None:
        known = self.recording.contacts
        if known is not None:
            known += [status.name for status in message.status if status.name not in known]

    def _on_stop_state(self, message: DiagnosticStatus) -> None:
        if message.level == DiagnosticStatus.ERROR:
            self.stopped[message.name] = message.message
        else:
            self.stopped.pop(message.name, None)


def _stamped_pose(message: Odometry) -> Row:
    pose = message.pose.pose
    return (
        time_seconds(message.header.stamp),
        pose.position.x,
        pose.position.y,
        yaw_from_quaternion(pose.orientation),
    )
