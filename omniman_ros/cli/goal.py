"""`omniman goal`: send the planner a goal, say how far it is, cancel it on Ctrl-C."""

import argparse
import math
import time
from collections.abc import Callable

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from std_srvs.srv import Trigger

from omniman_ros import conversions
from omniman_ros.cli.driving import drive
from omniman_ros.cli.errors import CommandError
from omniman_ros.cli.progress import Progress
from omniman_ros.cli.session import DISCOVERY, Session
from omniman_ros.core import se2

ANSWER = 2.0
"""How long the planner may take to say what it does with a goal [s]."""
PATIENCE = 8.0
"""How long a goal may wait for the robot to be driven [s]."""


class GoalDriver:
    """Sends one goal and follows it.

    Args:
        session: The ROS node.
        progress: Where progress is shown.
        poll: Called many times a second; raises to end it early.
    """

    def __init__(self, session: Session, progress: Progress, poll: Callable[[], None]) -> None:
        self._session = session
        self._poll = poll
        self._progress = progress
        self._status: dict[str, str] = {}
        self._message = ""
        self._pose: tuple[float, float, float] | None = None
        node = session.node
        self._goals = node.create_publisher(PoseStamped, "goal_pose", 10)
        node.create_subscription(DiagnosticStatus, "mpc/status", self._on_status, 10)
        node.create_subscription(Odometry, "odom", self._on_odom, 10)
        self._cancel = node.create_client(Trigger, "mpc_planner/cancel")

    def _on_status(self, message: DiagnosticStatus) -> None:
        self._status = {item.key: item.value for item in message.values}
        self._message = message.message

    def _on_odom(self, message: Odometry) -> None:
        place = message.pose.pose.position
        self._pose = (place.x, place.y, conversions.yaw(message.pose.pose.orientation))

    def drive(self, pose: tuple[float, float, float], relative: bool, timeout: float) -> None:
        """Drive to a pose in odom, or seen from the robot [m, m, rad].

        Raises:
            CommandError: Nobody is there, the goal is refused or given up, or it takes too long.
        """
        if not self._session.wait(self._ready, DISCOVERY):
            raise CommandError(
                f"no mpc_planner with odom was found within {DISCOVERY:g} s: start `omniman up`, "
                "or is ROS_DOMAIN_ID another?"
            )
        assert self._pose is not None
        goal = pose
        if relative:
            x, y, turn = (se2.to_world(self._pose[2], np.array(pose))).tolist()
            goal = (self._pose[0] + x, self._pose[1] + y, self._pose[2] + turn)
        self._progress.begin("goal")
        message = PoseStamped()
        message.header.frame_id = "odom"
        message.pose.position.x, message.pose.position.y = goal[0], goal[1]
        message.pose.orientation = conversions.quaternion(goal[2])
        self._goals.publish(message)
        self._follow(math.hypot(goal[0] - self._pose[0], goal[1] - self._pose[1]), timeout)

    def _ready(self) -> bool:
        self._poll()
        return bool(self._status and self._pose and self._goals.get_subscription_count())

    def _follow(self, distance: float, timeout: float) -> None:
        taken, refused = self._status.get("goals", ""), self._status.get("refused", "")
        began, whole = time.monotonic(), max(distance, 0.1)
        while time.monotonic() < began + timeout:
            self._session.spin(0.05)
            self._poll()
            said = self._status.get("last", "")
            if self._status.get("refused", "") != refused:
                raise CommandError(said)
            if self._status.get("goals", "") == taken:
                if time.monotonic() > began + PATIENCE + ANSWER:
                    raise CommandError(f"mpc_planner does not take the goal: {said}")
                continue
            state = self._status.get("state", "")
            left = float(self._status.get("distance_m", "nan"))
            if state == "arrived":
                self._progress.end(f"reached after {time.monotonic() - began:.1f} s")
                return
            if state in ("idle", "paused"):
                raise CommandError(said or state)
            self._progress.update(1.0 - left / whole, f"{left:.2f} m left, {self._message}")
        self.cancel()
        raise CommandError(f"not reached within {timeout:g} s: {self._message}; cancelled")

    def cancel(self) -> None:
        """Cancel the goal, and wait until the planner says so."""
        answer = self._cancel.call_async(Trigger.Request())
        self._session.wait(answer.done, ANSWER)


def run(args: argparse.Namespace) -> int:
    """Run `omniman goal`; returns the exit code."""
    place = (args.x, args.y, math.radians(args.heading))
    return drive(
        "omniman_goal", args.namespace, GoalDriver,
        lambda driver: driver.drive(place, args.relative, args.timeout),
    )  # fmt: skip
