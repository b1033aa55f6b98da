"""The load of `omniman bench arm`: goals among obstacles, and trajectories of the arm."""

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

from omniman_ros.console.errors import CommandError
from omniman_ros.console.session import DISCOVERY_TIMEOUT, Session
from omniman_ros.conversions.geometry import quaternion_from_yaw
from omniman_ros.core.arm_parameters import UR_JOINTS
from omniman_ros.demo.moving_obstacles import MovingObstacles
from omniman_ros.lab.bench.arm_figures import Block
from omniman_ros.nodes.stop_interface import ALL_LATCHED

CONTROLLER = "/simulated_ur"
"""Name of the simulated controller in the diagnostics."""
OBSERVATION_PERIOD = 0.05
"""Period of the observations of obstacles [s]."""
PLACES = ((1.3, 0.15), (1.3, -1.6), (3.5, 1.0), (-1.2, -0.3))
"""Positions of the obstacles in odom, of which one is in the way [m]."""
RADIUS = 0.25
"""Radius of the obstacles [m]."""
GOALS = ((2.6, 0.0, 0.5 * math.pi), (0.0, 0.0, 0.0))
"""Goals in odom between which the robot drives to and fro [m, m, rad]."""
POSES = (
    (0.3, -0.2, 0.3, -0.2, 0.2, 0.3),
    (-0.2, -0.1, 0.2, -0.3, -0.3, -0.2),
    (0.0,) * 6,
)
"""Offsets of the arm's joints from the first angles, which it passes in each round; small, so that
a short delay of the simulated controller does not look like a fault of the setpoints [rad]."""
ROUNDS = 30
"""Rounds of a trajectory of the arm."""
GOAL_PERIOD = 1.0
"""Least time between two goals, in which a node can report that it has one [s]."""
GOAL_TIMEOUT = 20.0
"""Time after which a goal that is not reached is replaced by the other one [s]."""
DIAGNOSTICS_PERIOD = 1.5
"""Longest time between two diagnostics [s]."""
PREVIEW_TIMEOUT = 0.3
"""Time without a preview after which the arm's trajectory has ended [s]."""


class Load:
    """Keeps platform, planner and arm moving, and collects the timing of the arm's setpoints.

    Args:
        session: ROS session.
        check: Called many times a second; raises to end early.

    Attributes:
        controller: Last diagnostics of the simulated controller.
        controller_reports: Number of these diagnostics.
        goals: Number of goals sent.
        previews: Number of previews of the arm received.
        driving: Number of the planner's reports that it drives.
        statuses: Number of all reports of the planner.
    """

    def __init__(self, session: Session, check: Callable[[], None]) -> None:
        self._session, self._check = session, check
        self.controller: dict[str, str] = {}
        self.controller_reports = self.goals = self.previews = 0
        self.driving = self.statuses = 0
        self._stopped: dict[str, str] = {}
        self._home: list[float] = []
        self._state = ""
        self._arm_commanded = self._goal_sent = -math.inf
        self._intervals: list[float] = []
        self._ages: list[float] = []
        self._around = MovingObstacles(
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
        # Raw: only the arrival of the messages counts.
        subscribe(JointTrajectory, "arm/joint_reference", self._on_preview, 10, raw=True)
        subscribe(JointState, "arm/joint_states", self._on_joints, 10, raw=True)

    # ---- subscriptions --------------------------------------------------------------------------

    def on_stop_state(self, message: DiagnosticStatus) -> None:
        """Update which nodes are stopped."""
        if message.level == DiagnosticStatus.ERROR:
            self._stopped[message.name] = message.message
        else:
            self._stopped.pop(message.name, None)

    def on_diagnostics(self, message: DiagnosticArray) -> None:
        """Update the diagnostics of the simulated controller."""
        for status in message.status:
            if status.name == CONTROLLER:
                self.controller = {item.key: item.value for item in status.values}
                self.controller_reports += 1

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
        self._arm_commanded = time.monotonic()
        self.previews += 1

    def _on_joints(self, data: bytes) -> None:
        if not self._home:
            message = deserialize_message(data, JointState)
            angles = dict(zip(message.name, message.position, strict=True))
            self._home = [angles[name] for name in UR_JOINTS]

    def check(self) -> None:
        """Check that nothing has stopped.

        Raises:
            CommandError: A node has latched a stop, or a process has ended.
        """
        self._check()
        if self._stopped:
            # The stop is reported at once, the controller's diagnostics once a second.
            self._session.wait(
                lambda: self.controller.get("program_state") != "PLAYING", DIAGNOSTICS_PERIOD
            )
            name, why = next(iter(self._stopped.items()))
            state = self.controller.get("program_state", "unknown")
            reason = self.controller.get("program_end_reason", "")
            raise CommandError(
                f"the robot stopped: {name} is {why}; the program on the controller: {state}"
                + (f" ({reason})" if reason else "")
            )

    # ---- load -----------------------------------------------------------------------------------

    def begin(self) -> None:
        """Wait until all nodes are ready, and then until all of them work.

        Raises:
            CommandError: They are not in time.
        """
        self._wait(self._missing)
        self._wait(self._idle)

    def _wait(self, missing: Callable[[], str]) -> None:
        end = time.monotonic() + DISCOVERY_TIMEOUT
        while names := missing():
            if time.monotonic() > end:
                raise CommandError(f"missing after {DISCOVERY_TIMEOUT:g} s: {names}")
            if not self._missing():
                self._feed()
            self._session.spin(OBSERVATION_PERIOD)
            self.check()

    def _missing(self) -> str:
        there = {
            "mpc/status": bool(self._state),
            "arm/joint_states": bool(self._home),
            "arm/timing": bool(self._intervals),
            f"a program in the diagnostics of {CONTROLLER}": self.controller.get("program_state")
            == "PLAYING",
        }
        for publisher in (self._goals, self._obstacles, self._joints):
            subscribers = publisher.get_subscription_count()
            there[f"a subscriber of {publisher.topic_name}"] = subscribers > 0
        return ", ".join(name for name, is_there in there.items() if not is_there)

    def _idle(self) -> str:
        works = {"a drive to a goal": self.driving, "previews of the arm": self.previews}
        return ", ".join(name for name, count in works.items() if not count)

    def run(self, seconds: float) -> None:
        """Keep everything moving for a time [s].

        Raises:
            CommandError: See :meth:`check`.
        """
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0.0:
            self._feed()
            self._session.spin(min(left, OBSERVATION_PERIOD))
            self.check()

    def measure(self, seconds: float) -> Block:
        """Keep everything moving for a time [s], and return the timing of the arm's setpoints."""
        self._intervals.clear()
        self._ages.clear()
        self.run(seconds)
        return Block(tuple(self._intervals), tuple(self._ages))

    def _feed(self) -> None:
        now = time.monotonic()
        stamp = self._session.node.get_clock().now().to_msg()
        self._obstacles.publish(self._around.message(0.0, stamp))
        since = now - self._goal_sent
        if since > GOAL_TIMEOUT or (since > GOAL_PERIOD and self._state != "driving"):
            self._goal_sent = now
            self._goals.publish(self._next_goal())
        if now - self._arm_commanded > PREVIEW_TIMEOUT:
            self._arm_commanded = now + GOAL_PERIOD
            self._joints.publish(self._trajectory())

    def _next_goal(self) -> PoseStamped:
        x, y, heading = GOALS[self.goals % len(GOALS)]
        self.goals += 1
        goal = PoseStamped()
        goal.header.frame_id = "odom"
        goal.pose.position.x, goal.pose.position.y = x, y
        goal.pose.orientation = quaternion_from_yaw(heading)
        return goal

    def _trajectory(self) -> JointTrajectory:
        places = [[h + d for h, d in zip(self._home, pose, strict=True)] for pose in POSES]
        points = [JointTrajectoryPoint(positions=place) for place in places]
        return JointTrajectory(joint_names=list(UR_JOINTS), points=points * ROUNDS)
