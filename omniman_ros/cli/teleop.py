"""`omniman teleop`: drive with the keyboard of a plain terminal."""

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

from omniman_ros.cli.teleop_keys import SCALE_STEP, KeyTeleop, split_keys
from omniman_ros.console.errors import CommandError
from omniman_ros.console.formatting import pose_text
from omniman_ros.console.keyboard import Keyboard
from omniman_ros.console.preview_messages import twist_message
from omniman_ros.console.session import Session
from omniman_ros.console.terminal import say
from omniman_ros.conversions.geometry import yaw_from_quaternion
from omniman_ros.core.framing import CmdVelFraming, Twist
from omniman_ros.nodes.stoppable_nodes import find_stoppable_nodes, has_service
from omniman_ros.processes.process_group import redirect_signals

PERIOD = 0.05  #: Period of `cmd_vel` [s]
#: Quality of service of topics that repeat their last messages to late subscribers
LATCHED = QoSProfile(depth=50, durability=DurabilityPolicy.TRANSIENT_LOCAL)
CONTROLLER = "platform_controller"  #: Name of the node that stops the platform

#: Help that is shown at the start
HELP_TEXT = """\
Hold a key to drive, release it to stop.
      w         forward                    u  i  o
  a   s   d     left, back, right          j     l   all eight directions
  q       e     turn left, turn right      m  ,  .
  arrows        forward, back, turn
Two keys pressed at once add up (w and e: a curve); a key pressed later replaces them.
  + -  faster, slower      space  stop until reset      r  reset      x, Ctrl-C  quit"""


class Teleop:
    """The ROS interface of teleoperation: publishes twists, calls services, tracks the robot."""

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
        self._stop_states: dict[str, tuple[bool, str]] = {}
        self.note = ""
        node.create_subscription(String, "active_source", self._on_source, LATCHED)
        node.create_subscription(Odometry, "odom", self._on_odom, 1)
        node.create_subscription(DiagnosticStatus, "stop_state", self._on_state, LATCHED)
        self._stop_service = f"{node.get_namespace().rstrip('/')}/{CONTROLLER}/stop"
        self._client(self._stop_service)  # early, so that the service is discovered in time

    def publish(self, twist: Twist) -> None:
        """Publish a body twist [m/s, m/s, rad/s]."""
        message: Any = twist_message(twist)
        if self._stamped:
            message = TwistStamped(twist=message)
            message.header.stamp = self._node.get_clock().now().to_msg()
            message.header.frame_id = "base_link"
        self._publisher.publish(message)

    def finish(self) -> None:
        """Publish zero twists, and wait until they have arrived."""
        for _ in range(3):
            self.publish((0.0, 0.0, 0.0))
        self._publisher.wait_for_all_acked(Duration(seconds=1))

    def stop(self) -> None:
        """Stop the platform, which latches; the robot's other nodes hold with it."""
        if not self._client(self._stop_service).service_is_ready():
            self.note = f"NO STOP: {self._stop_service} is not available"
            return
        self._call(self._stop_service)

    def reset(self) -> None:
        """Reset every stopped node of the robot."""
        names = find_stoppable_nodes(self._node, self._node.get_namespace())
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

    def collect_answers(self) -> None:
        """Put the answers of services that have arrived into `note`."""
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
        self._pose = pose_text(
            (pose.position.x, pose.position.y, yaw_from_quaternion(pose.orientation))
        )

    def _on_state(self, message: DiagnosticStatus) -> None:
        is_stopped = message.level == DiagnosticStatus.ERROR
        self._stop_states[message.name] = (is_stopped, message.message)

    def _stop_text(self) -> str:
        stopped = [
            f"{name.rpartition('/')[2]} {reason}"
            for name, (is_stopped, reason) in sorted(self._stop_states.items())
            if is_stopped
        ]
        if stopped:
            return "; ".join(stopped) + " (r: reset)"
        return "free" if self._stop_states else "no stop_state"

    def status(self, twist: Twist | None, keys: KeyTeleop) -> str:
        """Return the status line.

        It has the active source of commands, the commanded twist [m/s, m/s, rad/s], if any, the
        pose, the stopped nodes, the speeds of the keys and the latest event.
        """
        x, y, yaw_rate = twist or (0.0, 0.0, 0.0)
        linear, angular = keys.speeds
        parts = [
            f"{self._source:<7}",
            f"{x:+.2f} {y:+.2f} m/s {yaw_rate:+.2f} rad/s",
            self._pose or "no odom",
            self._stop_text(),
            f"keys {linear:.2f} m/s {angular:.2f} rad/s",
            self.note,
        ]
        return " | ".join(part for part in parts if part)


def handle_key(key: str, now: float, keys: KeyTeleop, teleop: Teleop) -> bool:
    """Execute the action of a key that was sent at a time [s]; return False if the user quits."""
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
        keys.change_speed(SCALE_STEP)
    elif key in ("-", "_"):
        keys.change_speed(1.0 / SCALE_STEP)
    return True


def teleoperate(
    keyboard: Keyboard, keys: KeyTeleop, teleop: Teleop, session: Session, signals: list[int]
) -> None:
    """Serve keys and ROS until the user quits, a signal is received or the terminal is gone."""
    framing = CmdVelFraming()
    due = time.monotonic()
    while not signals:
        text = keyboard.read()
        if text is None:
            return
        now = time.monotonic()
        for key in split_keys(text):
            if not handle_key(key, now, keys, teleop):
                return
        twist = framing.next(keys.twist(now))
        if twist is not None:
            teleop.publish(twist)
        teleop.collect_answers()
        line = teleop.status(twist, keys)[: shutil.get_terminal_size().columns - 1]
        try:
            sys.stdout.write(f"\r{line}\033[K")
            sys.stdout.flush()
        except OSError:
            return
        due = max(due + PERIOD, now)
        session.spin(due - time.monotonic())


def run(args: argparse.Namespace) -> int:
    """Run `omniman teleop`; return 0 or raise CommandError."""
    for name in ("linear", "angular"):
        if not 0.0 < getattr(args, name) < 100.0:
            raise CommandError(f"--{name} must be above 0, got {getattr(args, name):g}", 2)
    keys = KeyTeleop(args.linear, args.angular)
    signals: list[int] = []
    with (
        Keyboard() as keyboard,
        redirect_signals(signals.append),
        Session("omniman_teleop", args.namespace) as session,
    ):
        teleop = Teleop(session, args.stamped)
        say(HELP_TEXT)
        try:
            teleoperate(keyboard, keys, teleop, session, signals)
        finally:
            teleop.finish()
            say("\nzero twist sent, quit")
    return 0
