"""`omniman teleop`: drives with the keyboard of a plain terminal."""

import argparse
import shutil
import sys
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Twist as TwistMsg
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import String
from std_srvs.srv import Trigger

from omniman_ros.cli.children import signals_to
from omniman_ros.cli.errors import CommandError
from omniman_ros.cli.keyboard import Keyboard
from omniman_ros.cli.session import Session
from omniman_ros.cli.show import pose_text, twist_message
from omniman_ros.cli.teleop_keys import STEP, KeyTeleop, split_keys
from omniman_ros.cli.terminal import say
from omniman_ros.conversions import yaw
from omniman_ros.core.framing import Framing, Twist
from omniman_ros.nodes.movers import has_service, nodes_that_move

PERIOD = 0.05
"""Of cmd_vel [s]."""
LATCHED = QoSProfile(depth=50, durability=DurabilityPolicy.TRANSIENT_LOCAL)
CONTROLLER = "platform_controller"

HELP = """\
Hold a key to drive, release it to stop.
      w         forward                    u  i  o
  a   s   d     left, back, right          j     l   all eight directions
  q       e     turn left, turn right      m  ,  .
  arrows        forward, back, turn
Two keys pressed at once add up (w and e: a curve); a key pressed later replaces them.
  + -  faster, slower      space  stop until reset      r  reset      x, Ctrl-C  quit"""


class Teleop:
    """The ROS half: publishes twists, calls services, and knows how the robot is.

    Args:
        session: The ROS node.
        stamped: Whether cmd_vel is a TwistStamped.

    Attributes:
        note: What happened last, for the status line.
    """

    def __init__(self, session: Session, stamped: bool) -> None:
        node = self._node = session.node
        self._session = session
        self._stamped = stamped
        self._publisher = node.create_publisher(
            TwistStamped if stamped else TwistMsg, "cmd_vel", 1
        )
        self._futures: dict[str, Any] = {}
        self._clients: dict[str, Any] = {}
        self._source = "no robot yet"
        self._pose = ""
        self._states: dict[str, str] = {}
        self.note = ""
        node.create_subscription(String, "active_source", self._on_source, LATCHED)
        node.create_subscription(Odometry, "odom", self._on_odom, 1)
        node.create_subscription(DiagnosticStatus, "stop_state", self._on_state, LATCHED)
        self._stop_service = f"{node.get_namespace().rstrip('/')}/{CONTROLLER}/stop"
        self._client(self._stop_service)  # found by the time that it is needed

    def publish(self, twist: Twist) -> None:
        """Publish a body twist."""
        message: Any = twist_message(twist)
        if self._stamped:
            message = TwistStamped(twist=message)
            message.header.stamp = self._node.get_clock().now().to_msg()
            message.header.frame_id = "base_link"
        self._publisher.publish(message)

    def finish(self) -> None:
        """Send zeros and wait until they have arrived."""
        for _ in range(3):
            self.publish((0.0, 0.0, 0.0))
        self._publisher.wait_for_all_acked(Duration(seconds=1))

    def stop(self) -> None:
        """Latch a stop of the platform; its other nodes hold with it."""
        if not self._client(self._stop_service).service_is_ready():
            self.note = f"NO STOP: {self._stop_service} is not there"
            return
        self._call(self._stop_service)

    def reset(self) -> None:
        """Release every node of the robot."""
        names = nodes_that_move(self._node, self._node.get_namespace())
        if not names:
            self.note = "no node to reset"
        for name in names:
            if has_service(self._node, f"{name}/reset"):
                self._call(f"{name}/reset")

    def _client(self, service: str) -> Any:
        if service not in self._clients:
            self._clients[service] = self._node.create_client(Trigger, service)
        return self._clients[service]

    def _call(self, service: str) -> None:
        self._futures[service] = self._client(service).call_async(Trigger.Request())
        self.note = f"{service} ..."

    def collect(self) -> None:
        """Take in the answers of services."""
        for service, future in list(self._futures.items()):
            if future.done():
                del self._futures[service]
                answer = future.result()
                verdict = "done" if answer.success else f"REFUSED: {answer.message}"
                self.note = f"{service} {verdict}"

    def _on_source(self, message: String) -> None:
        self._source = message.data

    def _on_odom(self, message: Odometry) -> None:
        pose = message.pose.pose
        self._pose = pose_text((pose.position.x, pose.position.y, yaw(pose.orientation)))

    def _on_state(self, message: DiagnosticStatus) -> None:
        self._states[message.name] = message.message

    def _held(self) -> str:
        """What holds the robot: the nodes that are stopped, not those that hold with them."""
        stopped = [
            f"{name.rpartition('/')[2]} {why}"
            for name, why in sorted(self._states.items())
            if why.startswith("stopped")
        ]
        if stopped:
            return "; ".join(stopped) + " (r: reset)"
        return "free" if self._states else "no stop_state"

    def status(self, twist: Twist | None, keys: KeyTeleop) -> str:
        """One line: who drives, what is asked for, where it is, what holds it."""
        x, y, turn = twist or (0.0, 0.0, 0.0)
        linear, angular = keys.speeds
        parts = [
            f"{self._source:<7}",
            f"{x:+.2f} {y:+.2f} m/s {turn:+.2f} rad/s",
            self._pose or "no odom",
            self._held(),
            f"keys {linear:.2f} m/s {angular:.2f} rad/s",
            self.note,
        ]
        return " | ".join(part for part in parts if part)


def handle(key: str, now: float, keys: KeyTeleop, teleop: Teleop) -> bool:
    """Act on a key; returns False to quit."""
    if key in ("x", "\x03"):
        return False
    if keys.press(key, now):
        return True
    if key == " ":
        keys.release()
        teleop.publish((0.0, 0.0, 0.0))
        teleop.stop()
    elif key == "r":
        keys.release()
        teleop.reset()
    elif key in ("+", "="):
        keys.faster(STEP)
    elif key in ("-", "_"):
        keys.faster(1.0 / STEP)
    return True


def drive(keyboard: Keyboard, keys: KeyTeleop, teleop: Teleop, session: Session,
          signals: list[int]) -> None:  # fmt: skip
    """Serve keys and ROS until the user quits, a signal comes or the terminal is gone."""
    framing = Framing()
    due = time.monotonic()
    while not signals:
        text = keyboard.read()
        if text is None:
            return
        now = time.monotonic()
        for key in split_keys(text):
            if not handle(key, now, keys, teleop):
                return
        twist = framing.next(keys.twist(now))
        if twist is not None:
            teleop.publish(twist)
        teleop.collect()
        line = teleop.status(twist, keys)[: shutil.get_terminal_size().columns - 1]
        try:
            sys.stdout.write(f"\r{line}\033[K")
            sys.stdout.flush()
        except OSError:
            return
        due = max(due + PERIOD, now)
        session.spin(due - time.monotonic())


def run(args: argparse.Namespace) -> int:
    """Run `omniman teleop`; returns the exit code."""
    for name in ("linear", "angular"):
        if not 0.0 < getattr(args, name) < 100.0:
            raise CommandError(f"--{name} must be above 0, got {getattr(args, name):g}", 2)
    keys = KeyTeleop(args.linear, args.angular)
    signals: list[int] = []
    with (
        Keyboard() as keyboard, signals_to(signals.append),
        Session("omniman_teleop", args.namespace) as session,
    ):  # fmt: skip
        teleop = Teleop(session, args.stamped)
        say(HELP)
        try:
            drive(keyboard, keys, teleop, session, signals)
        finally:
            teleop.finish()
            say("\nzero sent, quit")
    return 0
