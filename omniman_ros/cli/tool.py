"""`omniman tool`: lead the tool straight to a place, platform and arm in step."""

import argparse
import math
import time
from collections.abc import Callable

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry, Path
from std_msgs.msg import Float64
from std_srvs.srv import Trigger

from omniman_ros import conversions
from omniman_ros.cli.driving import drive
from omniman_ros.cli.errors import CommandError
from omniman_ros.cli.progress import Progress
from omniman_ros.cli.session import DISCOVERY, Session

ANSWER = 2.0
"""How long the node may take to answer a service [s]."""
NODE = "path_interpolator"
Place = tuple[float, float, float]


class ToolDriver:
    """Sends one path of the tool and follows it.

    Args:
        session: The ROS node.
        progress: Where progress is shown.
        poll: Called many times a second; raises to end it early.
    """

    def __init__(self, session: Session, progress: Progress, poll: Callable[[], None]) -> None:
        self._session, self._progress, self._poll = session, progress, poll
        self._said: dict[str, str] = {}
        self._reports = 0
        self._done = 0.0
        self._tool: Place | None = None
        self._heading: float | None = None
        node = session.node
        self._paths = node.create_publisher(Path, "tool_path", 10)
        node.create_subscription(PoseStamped, "tool_pose", self._on_tool, 10)
        node.create_subscription(Odometry, "odom", self._on_odom, 10)
        node.create_subscription(Float64, "path_progress", self._on_progress, 10)
        node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 50)
        self._cancel = node.create_client(Trigger, f"{NODE}/cancel")
        self._name = f"{node.get_namespace().rstrip('/')}/{NODE}"

    def _on_tool(self, message: PoseStamped) -> None:
        place = message.pose.position
        self._tool = (place.x, place.y, place.z)

    def _on_odom(self, message: Odometry) -> None:
        self._heading = conversions.yaw(message.pose.pose.orientation)

    def _on_progress(self, message: Float64) -> None:
        self._done = message.data

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == self._name:
                self._said = {item.key: item.value for item in status.values}
                self._reports += 1

    def drive(self, way: Place, relative: bool, timeout: float) -> None:
        """Lead the tool to a place in odom, or by a way seen from the robot [m].

        Raises:
            CommandError: Nobody is there, the path is refused or given up, or it takes too long.
        """
        if not self._session.wait(self._ready, DISCOVERY):
            raise CommandError(
                f"no {NODE} that knows where the tool is was found within {DISCOVERY:g} s: start "
                "`omniman up`, or is ROS_DOMAIN_ID another?"
            )
        assert self._tool is not None and self._heading is not None
        goal = way
        if relative:
            c, s = math.cos(self._heading), math.sin(self._heading)
            x, y, z = way
            goal = (
                self._tool[0] + c * x - s * y, self._tool[1] + s * x + c * y, self._tool[2] + z,
            )  # fmt: skip
        self._progress.begin("tool")
        self._paths.publish(straight(self._tool, goal))
        self._follow(timeout)

    def _ready(self) -> bool:
        self._poll()
        known = self._said and self._tool is not None and self._heading is not None
        return bool(known and self._paths.get_subscription_count())

    def _follow(self, timeout: float) -> None:
        began, reports, moved = time.monotonic(), self._reports, False
        while time.monotonic() < began + timeout:
            self._session.spin(0.05)
            self._poll()
            if self._reports < reports + 2:  # the first may be from before it was taken
                continue
            said, state = self._said.get("tool_path_last", ""), self._said.get("body", "")
            moved = moved or state != "idle" or " m of the tool in " in said
            if "refused" in said:
                raise CommandError(said)
            if moved and state == "idle":
                end = self._said.get("body_last", "")
                if end != "arrived":
                    raise CommandError(end)
                self._progress.end(f"there after {time.monotonic() - began:.1f} s")
                return
            self._progress.update(self._done if moved else 0.0, said)
        self.cancel()
        raise CommandError(f"not there within {timeout:g} s; cancelled")

    def cancel(self) -> None:
        """Cancel the path, and wait until the node says so."""
        answer = self._cancel.call_async(Trigger.Request())
        self._session.wait(answer.done, ANSWER)


def straight(start: Place, end: Place) -> Path:
    """A straight path of the tool in odom [m], turned all the way as it is."""
    path = Path()
    path.header.frame_id = "odom"
    for place in (start, end):
        pose = PoseStamped()
        position, turn = pose.pose.position, pose.pose.orientation
        position.x, position.y, position.z = place
        turn.x = turn.y = turn.z = turn.w = 0.0
        path.poses.append(pose)
    return path


def run(args: argparse.Namespace) -> int:
    """Run `omniman tool`; returns the exit code."""
    place = (args.x, args.y, args.z)
    return drive(
        "omniman_tool", args.namespace, ToolDriver,
        lambda driver: driver.drive(place, args.relative, args.timeout),
    )  # fmt: skip
