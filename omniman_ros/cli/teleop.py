"""`omniman teleop`: drive with the keyboard of a plain terminal."""

import argparse
import shutil
import sys
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor

from omniman_ros.cli.teleop_keys import SCALE_STEP, KeyTeleop, split_keys
from omniman_ros.client.robot import Robot
from omniman_ros.client.state import NodeAnswer, RobotError
from omniman_ros.console.errors import CommandError
from omniman_ros.console.formatting import pose_text
from omniman_ros.console.keyboard import Keyboard
from omniman_ros.console.terminal import say
from omniman_ros.core.framing import Twist
from omniman_ros.processes.process_group import redirect_signals

PERIOD = 0.05  #: Time between two looks at the keyboard [s]
SEARCH_TIMEOUT = 1.0  #: Time within which nodes must be found that can be stopped [s]

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
    """Drives a robot, and tells its state in one line.

    Attributes:
        note: The latest event.
    """

    def __init__(self, robot: Robot, pool: ThreadPoolExecutor) -> None:
        self._robot, self._pool = robot, pool
        self._call: Future[tuple[NodeAnswer, ...]] | None = None
        self.note = ""

    def drive(self, twist: Twist | None) -> None:
        """Drive with a twist [m/s, m/s, rad/s], or brake if there is none."""
        if twist is None:
            self._robot.halt()
            return
        try:
            self._robot.drive(*twist)
        except RobotError as error:
            self.note = str(error)

    def stop(self) -> None:
        """Stop the robot until it is reset."""
        self._robot.halt()
        self._begin("stop", self._robot.stop)

    def reset(self) -> None:
        """Reset every stopped node of the robot."""
        self._begin("reset", self._robot.reset)

    def _begin(self, action: str, call: Callable[[float], tuple[NodeAnswer, ...]]) -> None:
        # Another thread waits for the answers, while this one serves the keyboard.
        self._call, self.note = self._pool.submit(call, SEARCH_TIMEOUT), f"{action} ..."

    def collect_answers(self) -> None:
        """Put the answers to a stop or a reset into `note` when they have arrived."""
        if self._call is None or not self._call.done():
            return
        call, self._call = self._call, None
        try:
            self.note = self.note.replace("...", f"of {len(call.result())} nodes done")
        except RobotError as error:
            self.note = f"NO {self.note.replace(' ...', '').upper()}: {error}"

    def _stop_text(self) -> str:
        stopped = self._robot.stop_reason
        if not stopped.is_known:
            return "no stop_state"
        return f"{stopped.value} (r: reset)" if stopped.value else "free"

    def status(self, twist: Twist | None, keys: KeyTeleop) -> str:
        """Return the status line.

        It has the active source of commands, the commanded twist [m/s, m/s, rad/s], if any, the
        pose, the stopped nodes, the speeds of the keys and the latest event.
        """
        x, y, yaw_rate = twist or (0.0, 0.0, 0.0)
        linear, angular = keys.speeds
        source, pose = self._robot.active_source, self._robot.pose
        parts = [
            f"{source.value if source.is_known else 'no robot yet':<7}",
            f"{x:+.2f} {y:+.2f} m/s {yaw_rate:+.2f} rad/s",
            pose_text(pose.value) if pose.is_known else "no odom",
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
        teleop.stop()
    elif key == "r":
        keys.release()
        teleop.reset()
    elif key in ("+", "="):
        keys.change_speed(SCALE_STEP)
    elif key in ("-", "_"):
        keys.change_speed(1.0 / SCALE_STEP)
    return True


def teleoperate(keyboard: Keyboard, keys: KeyTeleop, teleop: Teleop, signals: list[int]) -> None:
    """Serve the keys until the user quits, a signal is received or the terminal is gone."""
    due = time.monotonic()
    while not signals:
        text = keyboard.read()
        if text is None:
            return
        now = time.monotonic()
        for key in split_keys(text):
            if not handle_key(key, now, keys, teleop):
                return
        twist = keys.twist(now)
        teleop.drive(twist)
        teleop.collect_answers()
        line = teleop.status(twist, keys)[: shutil.get_terminal_size().columns - 1]
        try:
            sys.stdout.write(f"\r{line}\033[K")
            sys.stdout.flush()
        except OSError:
            return
        due = max(due + PERIOD, now)
        time.sleep(max(due - time.monotonic(), 0.0))


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
        Robot(args.namespace) as robot,
        ThreadPoolExecutor() as pool,
    ):
        say(HELP_TEXT)
        try:
            teleoperate(keyboard, keys, Teleop(robot, pool), signals)
        finally:
            robot.close()
            say("\nzero twist sent, quit")
    return 0
