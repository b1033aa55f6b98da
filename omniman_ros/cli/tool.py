"""`omniman tool`: move the tool along a straight line, with platform and arm in step."""

import argparse
import math
import time
from collections.abc import Callable

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry, Path
from std_msgs.msg import Float64
from std_srvs.srv import Trigger

from omniman_ros.cli.cancellable_motion import CANCELLED, NOT_SENT, UNCONFIRMED, run_motion
from omniman_ros.console.errors import CommandError
from omniman_ros.console.progress import Progress
from omniman_ros.console.session import DISCOVERY_TIMEOUT, Session
from omniman_ros.conversions.geometry import yaw_from_quaternion
from omniman_ros.nodes.motion_log import MotionEvent

ANSWER_TIMEOUT = 2.0  #: Time within which the node must answer a service [s]
#: Names of the nodes that may move the tool; one of them takes its paths
#: Events of a path of the tool that moves or has moved the robot
_AFTER_START = tuple(
    event.value
    for event in (
        MotionEvent.STARTED,
        MotionEvent.GIVEN_UP,
        MotionEvent.CANCELLED,
        MotionEvent.ARRIVED,
    )
)
NODES = ("path_interpolator", "whole_body_planner")
Position = tuple[float, float, float]  #: Position (x, y, z) of the tool [m]


class ToolPathClient:
    """Sends one path of the tool and follows it; `poll`, called often, may raise to end it."""

    def __init__(self, session: Session, progress: Progress, poll: Callable[[], None]) -> None:
        self._session, self._progress, self._poll = session, progress, poll
        self._status: dict[str, str] = {}
        self._status_count = 0
        self._fraction = 0.0
        self._tool: Position | None = None
        self._heading: float | None = None
        node = session.node
        self._paths = node.create_publisher(Path, "tool_path", 10)
        node.create_subscription(PoseStamped, "tool_pose", self._on_tool, 10)
        node.create_subscription(Odometry, "odom", self._on_odom, 10)
        node.create_subscription(Float64, "path_progress", self._on_progress, 10)
        node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 50)
        prefix = node.get_namespace().rstrip("/")
        self._names = {f"{prefix}/{name}": name for name in NODES}
        self._cancels = {name: node.create_client(Trigger, f"{name}/cancel") for name in NODES}
        self._mover = ""

    def _on_tool(self, message: PoseStamped) -> None:
        position = message.pose.position
        self._tool = (position.x, position.y, position.z)

    def _on_odom(self, message: Odometry) -> None:
        self._heading = yaw_from_quaternion(message.pose.pose.orientation)

    def _on_progress(self, message: Float64) -> None:
        self._fraction = message.data

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            values = {item.key: item.value for item in status.values}
            if status.name in self._names and "tool_path_event" in values:
                self._status, self._mover = values, self._names[status.name]
                self._status_count += 1

    def drive(self, position: Position, relative: bool, timeout: float) -> None:
        """Move the tool to a position, and wait until it has arrived.

        Args:
            position: Position (x, y, z) [m].
            relative: Whether the position is given relative to the tool, with x ahead of the robot
                and y to its left, rather than in odom.

        Raises:
            CommandError: No node takes paths of the tool, the path is refused or abandoned, or the
                tool does not arrive in time.
        """
        if not self._session.wait(self._is_ready, DISCOVERY_TIMEOUT):
            raise CommandError(
                f"no {' or '.join(NODES)} that knows the position of the tool was found within "
                f"{DISCOVERY_TIMEOUT:g} s: start `omniman up`, or set ROS_DOMAIN_ID to the robot's"
            )
        assert self._tool is not None and self._heading is not None
        goal = position
        if relative:
            c, s = math.cos(self._heading), math.sin(self._heading)
            x, y, z = position
            goal = (
                self._tool[0] + c * x - s * y,
                self._tool[1] + s * x + c * y,
                self._tool[2] + z,
            )
        self._progress.begin("tool")
        self._paths.publish(straight_path(self._tool, goal))
        self._follow(timeout)

    def _is_ready(self) -> bool:
        self._poll()
        known = self._status and self._tool is not None and self._heading is not None
        return bool(known and self._paths.get_subscription_count())

    def _follow(self, timeout: float) -> None:
        start, count, moved = time.monotonic(), self._status_count, False
        while time.monotonic() < start + timeout:
            self._session.spin(0.05)
            self._poll()
            if self._status_count < count + 2:  # the first status may be older than the path
                continue
            last, state = self._status.get("tool_path_last", ""), self._status.get("body", "")
            event = self._status.get("tool_path_event", "")
            moved = moved or state != "idle" or event in _AFTER_START
            if event == MotionEvent.REFUSED.value:
                raise CommandError(last)
            if moved and state == "idle":
                if self._status.get("body_event") != MotionEvent.ARRIVED.value:
                    raise CommandError(self._status.get("body_last", ""))
                self._progress.end(f"arrived after {time.monotonic() - start:.1f} s")
                return
            self._progress.update(self._fraction if moved else 0.0, last)
        self.cancel()
        raise CommandError(f"the tool has not arrived within {timeout:g} s; cancelled")

    def cancel(self) -> str:
        """Cancel the path, wait until the node confirms it, and return what the robot does."""
        if not self._mover:
            return NOT_SENT
        answer = self._cancels[self._mover].call_async(Trigger.Request())
        return CANCELLED if self._session.wait(answer.done, ANSWER_TIMEOUT) else UNCONFIRMED


def straight_path(start: Position, end: Position) -> Path:
    """Return a path of two poses; zero quaternions mean that the tool keeps its orientation.

    Args:
        start: First position, in odom [m].
        end: Last position, in odom [m].
    """
    path = Path()
    path.header.frame_id = "odom"
    for x, y, z in (start, end):
        pose = PoseStamped()
        position, orientation = pose.pose.position, pose.pose.orientation
        position.x, position.y, position.z = x, y, z
        orientation.x = orientation.y = orientation.z = orientation.w = 0.0
        path.poses.append(pose)
    return path


def run(args: argparse.Namespace) -> int:
    """Run `omniman tool`; return 0 or raise CommandError."""
    position = (args.x, args.y, args.z)
    return run_motion(
        "omniman_tool",
        args.namespace,
        ToolPathClient,
        lambda driver: driver.drive(position, args.relative, args.timeout),
    )
