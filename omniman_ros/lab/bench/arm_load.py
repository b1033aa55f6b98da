"""The load of `omniman bench arm`: it keeps the platform, the planner and the arm moving.

The robot drives to goals among obstacles while its arm follows trajectories.
"""

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
"""Name of the simulated UR controller in the diagnostics."""
OBSERVATION_PERIOD = 0.05
"""Period at which observations of the obstacles are published [s]."""
OBSTACLE_POSITIONS = ((1.3, 0.15), (1.3, -1.6), (3.5, 1.0), (-1.2, -0.3))
"""Positions (x, y) of the obstacles in odom; one of them is between the goals [m]."""
OBSTACLE_RADIUS = 0.25
"""Radius of each obstacle [m]."""
GOALS = ((2.6, 0.0, 0.5 * math.pi), (0.0, 0.0, 0.0))
"""Goals in odom between which the robot drives back and forth [m, m, rad]."""
JOINT_OFFSETS = (
    (0.3, -0.2, 0.3, -0.2, 0.2, 0.3),
    (-0.2, -0.1, 0.2, -0.3, -0.3, -0.2),
    (0.0,) * 6,
)
"""Points of a round of the arm, as offsets from the initial joint angles [rad].

They are small, so that a short delay of the simulated controller does not look like a fault of the
setpoints.
"""
ROUNDS = 30
"""Number of rounds in a trajectory of the arm."""
GOAL_PERIOD = 1.0
"""Shortest time between two commands, in which the receiving node starts to carry them out [s]."""
GOAL_TIMEOUT = 20.0
"""Time after which a goal that is not reached is replaced by the other one [s]."""
DIAGNOSTICS_PERIOD = 1.5
"""Longest expected time between two diagnostics of a node [s]."""
PREVIEW_TIMEOUT = 0.3
"""Time without a preview after which the arm's trajectory counts as ended [s]."""


class Load:
    """Keeps platform, planner and arm moving, and collects the timing of the arm's setpoints.

    Args:
        session: ROS session.
        check: Called at least every `OBSERVATION_PERIOD`; raises CommandError if a process has
            ended.

    Attributes:
        controller: Values of the simulated controller's last diagnostics, by key.
        controller_reports: Number of diagnostics of the simulated controller received.
        goals: Number of goals sent.
        previews: Number of previews of the arm received.
        driving: Number of status messages in which the planner reports that it is driving.
        statuses: Number of all status messages of the planner received.
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
        count = len(OBSTACLE_POSITIONS)
        self._surroundings = MovingObstacles(
            0.0,
            np.array(OBSTACLE_POSITIONS),
            np.zeros((count, 2)),
            np.full(count, OBSTACLE_RADIUS),
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
        # Raw messages are not deserialised: mostly, only their arrival matters.
        subscribe(JointTrajectory, "arm/joint_reference", self._on_preview, 10, raw=True)
        subscribe(JointState, "arm/joint_states", self._on_joints, 10, raw=True)

    # ---- subscriptions --------------------------------------------------------------------------

    def on_stop_state(self, message: DiagnosticStatus) -> None:
        """Record whether the node that sent a stop state is stopped."""
        if message.level == DiagnosticStatus.ERROR:
            self._stopped[message.name] = message.message
        else:
            self._stopped.pop(message.name, None)

    def on_diagnostics(self, message: DiagnosticArray) -> None:
        """Record the diagnostics of the simulated controller; ignore those of other nodes."""
        for status in message.status:
            if status.name == CONTROLLER:
                self.controller = {item.key: item.value for item in status.values}
                self.controller_reports += 1

    def on_timing(self, message: Float64MultiArray) -> None:
        """Collect the send intervals and setpoint ages, distinguished by their labels."""
        first, parts = 0, {"intervals": self._intervals, "ages": self._ages}
        for dimension in message.layout.dim:
            values = message.data[first : first + dimension.size]
            parts[dimension.label].extend(values)
            first += dimension.size

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
        """Check that no node is stopped and all processes run.

        Raises:
            CommandError: A node has latched a stop, or a process has ended.
        """
        self._check()
        if self._stopped:
            # A stop is published at once, the controller's diagnostics only once a second.
            self._session.wait(
                lambda: self.controller.get("program_state") != "PLAYING", DIAGNOSTICS_PERIOD
            )
            name, reason = next(iter(self._stopped.items()))
            state = self.controller.get("program_state", "unknown")
            end_reason = self.controller.get("program_end_reason", "")
            raise CommandError(
                f"the robot stopped: {name} is {reason}; the program on the controller: {state}"
                + (f" ({end_reason})" if end_reason else "")
            )

    # ---- load -----------------------------------------------------------------------------------

    def begin(self) -> None:
        """Wait until all nodes are ready, and then until the platform and the arm move.

        Raises:
            CommandError: A node is not ready or does not start to move in time, or see
                :meth:`check`.
        """
        self._wait(self._missing_nodes)
        self._wait(self._missing_motions)

    def _wait(self, missing: Callable[[], str]) -> None:
        end = time.monotonic() + DISCOVERY_TIMEOUT
        while names := missing():
            if time.monotonic() > end:
                raise CommandError(f"missing after {DISCOVERY_TIMEOUT:g} s: {names}")
            if not self._missing_nodes():
                self._feed()
            self._session.spin(OBSERVATION_PERIOD)
            self.check()

    def _missing_nodes(self) -> str:
        found = {
            "mpc/status": bool(self._state),
            "arm/joint_states": bool(self._home),
            "arm/timing": bool(self._intervals),
            f"a program in the diagnostics of {CONTROLLER}": self.controller.get("program_state")
            == "PLAYING",
        }
        for publisher in (self._goals, self._obstacles, self._joints):
            subscribers = publisher.get_subscription_count()
            found[f"a subscriber of {publisher.topic_name}"] = subscribers > 0
        return ", ".join(name for name, is_found in found.items() if not is_found)

    def _missing_motions(self) -> str:
        counts = {"a drive to a goal": self.driving, "previews of the arm": self.previews}
        return ", ".join(name for name, count in counts.items() if not count)

    def run(self, seconds: float) -> None:
        """Keep the platform, the planner and the arm moving for a given time [s].

        Raises:
            CommandError: See :meth:`check`.
        """
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0.0:
            self._feed()
            self._session.spin(min(left, OBSERVATION_PERIOD))
            self.check()

    def measure(self, seconds: float) -> Block:
        """Keep everything moving, and return the timing of the arm's setpoints.

        Args:
            seconds: Duration of the measurement [s].

        Raises:
            CommandError: See :meth:`check`.
        """
        self._intervals.clear()
        self._ages.clear()
        self.run(seconds)
        return Block(tuple(self._intervals), tuple(self._ages))

    def _feed(self) -> None:
        """Publish observations of the obstacles, and a new command for what is at rest."""
        now = time.monotonic()
        stamp = self._session.node.get_clock().now().to_msg()
        self._obstacles.publish(self._surroundings.message(0.0, stamp))
        since = now - self._goal_sent
        if since > GOAL_TIMEOUT or (since > GOAL_PERIOD and self._state != "driving"):
            self._goal_sent = now
            self._goals.publish(self._next_goal())
        if now - self._arm_commanded > PREVIEW_TIMEOUT:
            self._arm_commanded = now + GOAL_PERIOD  # wait longer for the first preview
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
        angles = [
            [home + offset for home, offset in zip(self._home, offsets, strict=True)]
            for offsets in JOINT_OFFSETS
        ]
        points = [JointTrajectoryPoint(positions=positions) for positions in angles]
        return JointTrajectory(joint_names=list(UR_JOINTS), points=points * ROUNDS)
