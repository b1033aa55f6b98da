"""A robot whose nodes all work, for `omniman bench arm`: goals among obstacles, the arm led."""

import math
import time
from collections.abc import Callable

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint
from visualization_msgs.msg import MarkerArray

from omniman_ros import conversions
from omniman_ros.cli.bench_arm_figures import Block
from omniman_ros.cli.crossing import Crossing
from omniman_ros.cli.errors import CommandError
from omniman_ros.cli.session import DISCOVERY, Session
from omniman_ros.core.arm_parameters import UR_JOINTS
from omniman_ros.nodes.stopping import ALL_LATCHED

CONTROLLER = "/simulated_ur"
"""Name of the simulated controller in the diagnostics."""
OBSERVED = 0.05
"""Period of the obstacles' observations [s]."""
PLACES = ((1.3, 0.15), (1.3, -1.6), (3.5, 1.0), (-1.2, -0.3))
RADIUS = 0.25
"""Where obstacles stand, one of them in the way, and of what radius [m]."""
GOALS = ((2.6, 0.0, 0.5 * math.pi), (0.0, 0.0, 0.0))
"""The robot goes to and fro between these in odom [m, m, rad]."""
POSES = (
    (0.3, -0.2, 0.3, -0.2, 0.2, 0.3), (-0.2, -0.1, 0.2, -0.3, -0.3, -0.2), (0.0,) * 6,
)  # fmt: skip
ROUNDS = 30
"""The arm goes round by these [rad], from where it was, so often in each trajectory; not fast: a
simulated controller that is held up for a moment is to be no fault of the setpoints."""
NEXT = 1.0
"""Least time between two goals [s]; a node needs a moment to say that it has one."""
LONGEST = 20.0
"""A goal that is not reached is left for the other one [s]."""
TOLD = 1.5
"""Diagnostics come more often than this [s]."""
SILENT = 0.3
"""No preview for so long: the arm's trajectory has ended [s]."""


class Load:
    """Keeps platform, planner and arm going, and hears how the arm's setpoints are sent.

    Args:
        session: The ROS node.
        check: Called many times a second; raises to end early.

    Attributes:
        controller: What the diagnostics of the simulated controller said last.
        told: How often they have.
        goals: How many were sent.
        previews: Of the arm, heard.
        driving, statuses: Reports of the planner that it drives, and all.
    """

    def __init__(self, session: Session, check: Callable[[], None]) -> None:
        self._session, self._check = session, check
        self.controller: dict[str, str] = {}
        self.told = self.goals = self.previews = self.driving = self.statuses = 0
        self._stopped: dict[str, str] = {}
        self._home: list[float] = []
        self._state = ""
        self._led = self._aimed = -math.inf
        self._intervals: list[float] = []
        self._ages: list[float] = []
        self._around = Crossing(
            0.0, np.array(PLACES), np.zeros((len(PLACES), 2)), np.full(len(PLACES), RADIUS)
        )
        node = session.node
        self._goals = node.create_publisher(PoseStamped, "goal_pose", 10)
        self._obstacles = node.create_publisher(MarkerArray, "obstacles", 50)
        self._joints = node.create_publisher(JointTrajectory, "joint_trajectory", 10)
        subscribe = node.create_subscription
        subscribe(DiagnosticStatus, "stop_state", self.on_stop_state, ALL_LATCHED)
        subscribe(DiagnosticStatus, "mpc/status", self._on_planner, 10)
        subscribe(DiagnosticArray, "/diagnostics", self.on_diagnostics, 50)
        subscribe(Float64MultiArray, "arm/timing", self.on_timing, 50)
        # Bytes: their arrival counts, not what is in them.
        subscribe(JointTrajectory, "arm/joint_reference", self._on_preview, 10, raw=True)
        subscribe(JointState, "arm/joint_states", self._on_joints, 10, raw=True)

    # ---- what is heard --------------------------------------------------------------------------

    def on_stop_state(self, message: DiagnosticStatus) -> None:
        """Remember who is stopped."""
        if message.level == DiagnosticStatus.ERROR:
            self._stopped[message.name] = message.message
        else:
            self._stopped.pop(message.name, None)

    def on_diagnostics(self, message: DiagnosticArray) -> None:
        """Remember what the simulated controller says."""
        for status in message.status:
            if status.name == CONTROLLER:
                self.controller = {item.key: item.value for item in status.values}
                self.told += 1

    def on_timing(self, message: Float64MultiArray) -> None:
        """Collect send intervals and setpoint ages, by the labels of the dimensions."""
        begin, parts = 0, {"intervals": self._intervals, "ages": self._ages}
        for dimension in message.layout.dim:
            values = message.data[begin : begin + dimension.size]
            parts[dimension.label].extend(values)
            begin += dimension.size

    def _on_planner(self, message: DiagnosticStatus) -> None:
        self._state = {item.key: item.value for item in message.values}.get("state", "")
        self.statuses += 1
        self.driving += self._state == "driving"

    def _on_preview(self, data: bytes) -> None:
        self._led = time.monotonic()
        self.previews += 1

    def _on_joints(self, data: bytes) -> None:
        if not self._home:
            message = deserialize_message(data, JointState)
            angles = dict(zip(message.name, message.position, strict=True))
            self._home = [angles[name] for name in UR_JOINTS]

    def check(self) -> None:
        """Look whether all is well.

        Raises:
            CommandError: A node latched a stop, or something ended.
        """
        self._check()
        if self._stopped:
            # The stop is told at once, what the controller says of it once a second.
            self._session.wait(lambda: self.controller.get("program_state") != "PLAYING", TOLD)
            name, why = next(iter(self._stopped.items()))
            state = self.controller.get("program_state", "unknown")
            reason = self.controller.get("program_end_reason", "")
            raise CommandError(
                f"the robot stopped: {name} is {why}; the program on the controller: {state}"
                + (f" ({reason})" if reason else "")
            )

    # ---- what goes on ---------------------------------------------------------------------------

    def begin(self) -> None:
        """Wait until all are there, and then until all work.

        Raises:
            CommandError: They are not in time.
        """
        self._wait(lambda: not self._absent(), "heard of", self._absent)
        self._wait(lambda: not self._idle(), "seen of", self._idle)

    def _wait(self, done: Callable[[], bool], what: str, lacking: Callable[[], str]) -> None:
        end = time.monotonic() + DISCOVERY
        while not done():
            if time.monotonic() > end:
                raise CommandError(f"nothing {what} within {DISCOVERY:g} s: {lacking()}")
            if not self._absent():
                self._feed()
            self._session.spin(OBSERVED)
            self.check()

    def _absent(self) -> str:
        there = {
            "mpc/status": bool(self._state), "arm/joint_states": bool(self._home),
            "arm/timing": bool(self._intervals),
            f"a program in the diagnostics of {CONTROLLER}":
                self.controller.get("program_state") == "PLAYING",
        }  # fmt: skip
        for publisher in (self._goals, self._obstacles, self._joints):
            there[f"a listener to {publisher.topic_name}"] = publisher.get_subscription_count() > 0
        return ", ".join(name for name, is_there in there.items() if not is_there)

    def _idle(self) -> str:
        works = {"a goal that is driven to": self.driving, "previews of the arm": self.previews}
        return ", ".join(name for name, count in works.items() if not count)

    def run(self, seconds: float) -> None:
        """Keep all going for a while.

        Raises:
            CommandError: See :meth:`check`.
        """
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0.0:
            self._feed()
            self._session.spin(min(left, OBSERVED))
            self.check()

    def measure(self, seconds: float) -> Block:
        """Keep all going, and return what was said of the setpoints meanwhile."""
        self._intervals.clear()
        self._ages.clear()
        self.run(seconds)
        return Block(tuple(self._intervals), tuple(self._ages))

    def _feed(self) -> None:
        now = time.monotonic()
        stamp = self._session.node.get_clock().now().to_msg()
        self._obstacles.publish(self._around.message(0.0, stamp))
        since = now - self._aimed
        if since > LONGEST or (since > NEXT and self._state != "driving"):
            self._aimed = now
            self._goals.publish(self._next_goal())
        if now - self._led > SILENT:
            self._led = now + NEXT
            self._joints.publish(self._trajectory())

    def _next_goal(self) -> PoseStamped:
        x, y, heading = GOALS[self.goals % len(GOALS)]
        self.goals += 1
        goal = PoseStamped()
        goal.header.frame_id = "odom"
        goal.pose.position.x, goal.pose.position.y = x, y
        goal.pose.orientation = conversions.quaternion(heading)
        return goal

    def _trajectory(self) -> JointTrajectory:
        places = [[h + d for h, d in zip(self._home, pose, strict=True)] for pose in POSES]
        points = [JointTrajectoryPoint(positions=place) for place in places]
        return JointTrajectory(joint_names=list(UR_JOINTS), points=points * ROUNDS)
