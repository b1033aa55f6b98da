"""`omniman goal`: send a goal to the planner, show the progress, cancel on Ctrl-C."""

import argparse
import math
import time
from collections.abc import Callable

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from std_srvs.srv import Trigger

from omniman_ros.cli.cancellable_motion import CANCELLED, NOT_SENT, UNCONFIRMED, run_motion
from omniman_ros.console.errors import CommandError
from omniman_ros.console.progress import Progress
from omniman_ros.console.session import DISCOVERY_TIMEOUT, Session
from omniman_ros.console.terminal import say
from omniman_ros.conversions.geometry import quaternion_from_yaw, yaw_from_quaternion
from omniman_ros.core import se2
from omniman_ros.core.planar import Triple

#: Time within which the planner has to answer a service or report on a goal [s]
ANSWER_TIMEOUT = 2.0
ACCEPTANCE_TIMEOUT = 8.0  #: Time that a goal may wait until the robot is ready to be driven [s]

FAR = 50.0  #: Distance of a goal above which the command says how far it is [m]


class GoalDriver:
    """Sends one goal to the planner and follows it; `poll`, called often, may raise to end it."""

    def __init__(self, session: Session, progress: Progress, poll: Callable[[], None]) -> None:
        self._session = session
        self._poll = poll
        self._progress = progress
        self._status: dict[str, str] = {}
        self._message = ""
        self._is_sent = False
        self._pose: Triple | None = None
        node = session.node
        self._goals = node.create_publisher(PoseStamped, "goal_pose", 10)
        node.create_subscription(DiagnosticStatus, "mpc/status", self._on_status, 10)
        node.create_subscription(Odometry, "odom", self._on_odom, 10)
        self._cancel = node.create_client(Trigger, "mpc_planner/cancel")

    def _on_status(self, message: DiagnosticStatus) -> None:
        self._status = {item.key: item.value for item in message.values}
        self._message = message.message

    def _on_odom(self, message: Odometry) -> None:
        position = message.pose.pose.position
        self._pose = (position.x, position.y, yaw_from_quaternion(message.pose.pose.orientation))

    def drive(self, pose: Triple, relative: bool, timeout: float) -> None:
        """Send a goal, and wait until the robot has reached it.

        Args:
            pose: Goal pose (x, y, heading) [m, m, rad].
            relative: Whether the goal is given relative to the present pose of base_link, rather
                than in odom.

        Raises:
            CommandError: There is no planner, the goal is refused or abandoned, or the robot does
                not reach it in time.
        """
        if not self._session.wait(self._is_ready, DISCOVERY_TIMEOUT):
            raise CommandError(
                f"no mpc_planner with odom was found within {DISCOVERY_TIMEOUT:g} s: start "
                "`omniman up`, or set ROS_DOMAIN_ID to the robot's"
            )
        assert self._pose is not None
        goal = pose
        if relative:
            x, y, rotation = (se2.to_world(self._pose[2], np.array(pose))).tolist()
            goal = (self._pose[0] + x, self._pose[1] + y, self._pose[2] + rotation)
        self._progress.begin("goal")
        message = PoseStamped()
        message.header.frame_id = "odom"
        message.pose.position.x, message.pose.position.y = goal[0], goal[1]
        message.pose.orientation = quaternion_from_yaw(goal[2])
        distance = math.hypot(goal[0] - self._pose[0], goal[1] - self._pose[1])
        if distance > FAR:
            say(f"note: the goal is {distance:.0f} m away; it is cancelled after {timeout:g} s")
        self._goals.publish(message)
        self._is_sent = True
        self._follow(distance, timeout)

    def _is_ready(self) -> bool:
        self._poll()
        return bool(self._status and self._pose and self._goals.get_subscription_count())

    def _follow(self, distance: float, timeout: float) -> None:
        goals, refused = self._status.get("goals", ""), self._status.get("refused", "")
        start, initial_distance = time.monotonic(), max(distance, 0.1)
        while time.monotonic() < start + timeout:
            self._session.spin(0.05)
            self._poll()
            last = self._status.get("last", "")
            if self._status.get("refused", "") != refused:
                raise CommandError(last)
            if self._status.get("goals", "") == goals:
                if time.monotonic() > start + ACCEPTANCE_TIMEOUT + ANSWER_TIMEOUT:
                    raise CommandError(f"mpc_planner does not accept the goal: {last}")
                continue
            state = self._status.get("state", "")
            remaining = float(self._status.get("distance_m", "nan"))
            if state == "arrived":
                self._progress.end(f"reached after {time.monotonic() - start:.1f} s")
                return
            if state in ("idle", "paused"):
                raise CommandError(last or state)
            fraction = 1.0 - remaining / initial_distance
            self._progress.update(fraction, f"{self._message}, {remaining:.2f} m left")
        self.cancel()
        raise CommandError(
            f"the goal was not reached within {timeout:g} s: {self._message}; cancelled"
        )

    def cancel(self) -> str:
        """Cancel the goal, wait until the planner confirms it, and return what the robot does."""
        if not self._is_sent:
            return NOT_SENT
        answer = self._cancel.call_async(Trigger.Request())
        return CANCELLED if self._session.wait(answer.done, ANSWER_TIMEOUT) else UNCONFIRMED


def run(args: argparse.Namespace) -> int:
    """Run `omniman goal`; return 0 or raise CommandError."""
    pose = (args.x, args.y, math.radians(args.heading))
    return run_motion(
        "omniman_goal",
        args.namespace,
        GoalDriver,
        lambda driver: driver.drive(pose, args.relative, args.timeout),
    )
