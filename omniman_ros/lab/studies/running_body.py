"""A robot of processes in the physics world, led along a path of its tool, and what it reports."""

import contextlib
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from nav_msgs.msg import Path as PathMessage
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64
from trajectory_msgs.msg import JointTrajectory

from omniman_ros.console.errors import CommandError
from omniman_ros.console.session import Session
from omniman_ros.conversions import arm as arm_conversions
from omniman_ros.conversions.geometry import yaw_from_quaternion
from omniman_ros.conversions.headers import time_seconds
from omniman_ros.core.arrays import Array
from omniman_ros.lab.studies.avoidance_scenes import AvoidanceScene
from omniman_ros.nodes.clock_follower import ClockFollower
from omniman_ros.nodes.motion_log import TOPIC as EVENTS
from omniman_ros.nodes.stop_interface import ALL_LATCHED
from omniman_ros.processes.node_output import NodeOutputLog
from omniman_ros.processes.process_group import ProcessGroup, redirect_signals
from omniman_ros.processes.robot_setup import WHOLE_BODY_PLANNER, RobotSetup, robot_processes

NODES = (
    "platform_controller",
    "path_interpolator",
    "simulated_world",
    "arm_streamer",
    "simulated_ur",
)  #: Nodes besides the one that avoids obstacles
ALL = QoSProfile(depth=5000)  #: Quality of service of reports of which none may be lost
LOOKAHEAD = 0.02  #: How far simulated time may be ahead of this process [s]
ENDS = ("refused", "replaced", "given_up", "cancelled", "arrived")  #: Last events of a motion
START_TIMEOUT = 60.0  #: Time in which a robot must be ready, and a path start or be refused [s]


def process_time(pid: int) -> float:
    """Return the CPU time of all threads of a process, past ones included [s]; on Linux."""
    return time.clock_gettime((~pid << 3) | 2)


@dataclass
class BodyRecording:
    """What a robot reported; times are those of /clock [s]."""

    odom: list[Array] = field(default_factory=list)  #: time, pose (3,)
    joints: list[Array] = field(default_factory=list)  #: time, angles (6,)
    truth: list[Array] = field(default_factory=list)  #: time, true pose (3,), speed
    true_joints: list[Array] = field(default_factory=list)  #: time, angles (6,), fastest rate
    references: list[Array] = field(default_factory=list)  #: time, position (3,) of the tool
    accelerations: list[Array] = field(default_factory=list)  #: time, largest of each joint (6,)
    #: Time, name of the event, and its reason in words
    events: list[tuple[float, str, str]] = field(default_factory=list)
    statuses: list[tuple[float, dict[str, str]]] = field(default_factory=list)  #: `body/status`
    cycles: list[tuple[float, float]] = field(default_factory=list)  #: time, CPU time so far

    def event(self, *names: str) -> tuple[float, str, str] | None:
        """Return the first event of one of these names, if any."""
        return next((each for each in self.events if each[1] in names), None)


class RunningBody:
    """Processes of a robot, and what they report."""

    def __init__(
        self, session: Session, children: ProcessGroup, joints: Sequence[str], avoids: bool
    ) -> None:
        self.session, self.children, self.recording = session, children, BodyRecording()
        self.progress = 0.0
        self._joints, self._avoids = joints, avoids
        self._subscribe()
        self._paths = session.node.create_publisher(PathMessage, "tool_path", 10)
        self._follower = ClockFollower(session.node, LOOKAHEAD, lambda: None, session.now)

    def _subscribe(self) -> None:
        subscribe, rec = self.session.node.create_subscription, self.recording
        subscribe(Odometry, "odom", lambda m: rec.odom.append(_pose_row(m)), ALL)
        subscribe(Odometry, "ground_truth/odom", self._on_truth, ALL)
        subscribe(JointState, "arm/joint_states", self._on_joints, ALL)
        subscribe(JointState, "ground_truth/arm_joint_states", self._on_true_joints, ALL)
        subscribe(PoseStamped, "tool_reference", self._on_reference, ALL)
        subscribe(JointTrajectory, "arm/joint_reference", self._on_preview, ALL)
        subscribe(DiagnosticStatus, EVENTS, self._on_event, ALL_LATCHED)
        subscribe(DiagnosticStatus, "body/status", self._on_status, ALL)
        subscribe(Float64, "path_progress", self._on_progress, ALL)

    def _on_progress(self, message: Float64) -> None:
        self.progress = message.data

    def _on_truth(self, message: Odometry) -> None:
        twist = message.twist.twist
        speed = np.hypot(twist.linear.x, twist.linear.y) + 0.5 * abs(twist.angular.z)
        self.recording.truth.append(np.array([*_pose_row(message), speed]))

    def _on_joints(self, message: JointState) -> None:
        angles = dict(zip(message.name, message.position, strict=True))
        row = [time_seconds(message.header.stamp), *(angles[name] for name in self._joints)]
        self.recording.joints.append(np.array(row))

    def _on_true_joints(self, message: JointState) -> None:
        rate = max(map(abs, message.velocity))
        row = [time_seconds(message.header.stamp), *message.position, rate]
        self.recording.true_joints.append(np.array(row))

    def _on_reference(self, message: PoseStamped) -> None:
        p = message.pose.position
        self.recording.references.append(
            np.array([time_seconds(message.header.stamp), p.x, p.y, p.z])
        )

    def _on_preview(self, message: JointTrajectory) -> None:
        rows = np.abs([point.accelerations for point in message.points[:3]])
        at = time_seconds(message.header.stamp)
        self.recording.accelerations.append(np.array([at, *rows.max(axis=0)]))

    def _on_event(self, message: DiagnosticStatus) -> None:
        values = {pair.key: pair.value for pair in message.values}
        self.recording.events.append((self.session.now(), values["event"], message.message))

    def _on_status(self, message: DiagnosticStatus) -> None:
        values = {pair.key: pair.value for pair in message.values}
        self.recording.statuses.append((self.session.now(), values))
        with contextlib.suppress(OSError):  # it may have been killed
            used = process_time(self.children.pid(WHOLE_BODY_PLANNER))
            self.recording.cycles.append((self.session.now(), used))

    def wait(self, condition: Callable[[], bool], timeout: float) -> bool:
        """Serve callbacks until a condition holds, and return whether it does [s of /clock]."""

        def checked() -> bool:
            self.children.check()
            return condition()

        return self.session.wait(checked, timeout)

    def demand(self, condition: Callable[[], bool], timeout: float, missing: str) -> None:
        """Wait likewise, or raise a CommandError that something is missing."""
        if not self.wait(condition, timeout):
            raise CommandError(f"{missing} within {timeout:g} s")

    def is_ready(self) -> bool:
        """Whether the robot reports, and takes a path of the tool."""
        rec = self.recording
        reports = rec.odom and rec.joints and rec.truth and rec.true_joints
        knows = bool(rec.statuses) or not self._avoids
        return bool(reports) and knows and self._paths.get_subscription_count() > 0

    def lead(self, poses: Array) -> None:
        """Send a path of the tool: poses (k, 4, 4) in odom."""
        path = PathMessage()
        path.header.frame_id = "odom"
        for pose in poses:
            stamped = PoseStamped()
            arm_conversions.fill_pose(stamped.pose, pose)
            path.poses.append(stamped)
        self._paths.publish(path)

    def leave(self) -> None:
        """Let simulated time go on without this process."""
        self._follower.leave()


def _pose_row(message: Odometry) -> Array:
    pose = message.pose.pose
    at, yaw = time_seconds(message.header.stamp), yaw_from_quaternion(pose.orientation)
    return np.array([at, pose.position.x, pose.position.y, yaw])


@contextlib.contextmanager
def running_body(
    robot: str,
    joints: Sequence[str],
    folder: Path,
    posture: Sequence[float],
    avoids: bool = True,
) -> Iterator[RunningBody]:
    """Run a robot in a physics world with nothing around, as a context.

    Args:
        posture: (6,) angles at which the arm is at first [rad].
        avoids: Whether `whole_body_planner` takes the paths of the tool, or `path_interpolator`.
    """
    world = folder / "scene.yaml"
    world.write_text("{}")
    setup = RobotSetup(
        robot=robot,
        only=(*NODES, WHOLE_BODY_PLANNER) if avoids else NODES,
        sim_time=True,
        world=str(world),
        params=(f"world.posture:={[*posture]}", f"simulated_arm.initial:={[*posture]}"),
    )
    log = NodeOutputLog()
    specs = [
        replace(spec, essential=spec.name != WHOLE_BODY_PLANNER) for spec in robot_processes(setup)
    ]
    children = ProcessGroup(specs, on_line=log, report=lambda text: None)
    with redirect_signals(children.interrupt):
        try:
            with children, Session("omniman_bench", sim_time=True) as session:
                body = RunningBody(session, children, joints, avoids)
                try:
                    yield body
                finally:
                    body.leave()
        except CommandError:
            log.show()
            raise


def start(body: RunningBody, scene: AvoidanceScene) -> None:
    """Lead the tool along the path of a scene until the motion starts, or will not."""
    body.demand(body.is_ready, START_TIMEOUT, "the robot is not ready")
    body.lead(scene.poses)
    rec = body.recording
    body.demand(lambda: rec.event("started", *ENDS) is not None, START_TIMEOUT, "no start")
