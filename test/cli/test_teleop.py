"""`omniman teleop` in a pseudo-terminal, on real nodes."""

import os
import pty
import re
import select
import signal
import subprocess
import sys
import time
from contextlib import contextmanager

import pytest
from geometry_msgs.msg import Twist, TwistStamped
from nav_msgs.msg import Odometry

from omniman_ros.cli.session import Session

from .support import PATIENCE, PATIENT, Running, command, environment

pytestmark = pytest.mark.processes

REPEAT = 0.03


# Makes stdin the controlling terminal, so that Ctrl-C works, and goes on as the command.
IN_TERMINAL = (
    "import fcntl, os, sys, termios\n"
    "fcntl.ioctl(0, termios.TIOCSCTTY, 0)\n"
    "os.execv(sys.argv[1], sys.argv[1:])\n"
)


class Terminal:
    """A teleop with its keyboard and its screen."""

    def __init__(self, domain, *options):
        self.screen = ""
        self.file, inner = pty.openpty()
        self.process = subprocess.Popen(
            [sys.executable, "-c", IN_TERMINAL, *command("teleop", *options)],
            env=environment(domain) | {"COLUMNS": "200", "TERM": "xterm"},
            stdin=inner, stdout=inner, stderr=inner, start_new_session=True,
        )  # fmt: skip
        os.close(inner)

    def type(self, keys):
        os.write(self.file, keys.encode())

    def look(self, timeout=0.0):
        """Take in what is on the screen."""
        try:
            while select.select([self.file], [], [], timeout)[0]:
                self.screen += os.read(self.file, 65536).decode()
                timeout = 0.0
        except OSError:  # closed at the other end
            pass

    @property
    def line(self):
        """The status line, whole."""
        return self.screen.split("\x1b[K")[-2].strip("\r") if "\x1b[K" in self.screen else ""

    def wait(self, session, condition, what):
        def look():
            self.look()
            return condition()

        assert session.wait(look, PATIENCE), f"no {what}; screen:\n{self.screen[-2000:]}"

    def finish(self):
        """Exit code; what is left is taken from the screen."""
        end = time.monotonic() + PATIENCE
        while self.process.poll() is None:
            assert time.monotonic() < end, f"teleop did not end; screen:\n{self.screen[-2000:]}"
            self.look(0.05)
        self.look()
        return self.process.returncode

    def close(self):
        self.process.kill()
        self.process.wait()
        os.close(self.file)


@contextmanager
def terminal(domain, *options):
    teleop = Terminal(domain, *options)
    try:
        yield teleop
    finally:
        teleop.close()


def hold(teleop, session, key, condition, seconds=PATIENCE):
    """Type as a keyboard repeats, until a condition holds."""
    teleop.type(key)
    end = time.monotonic() + seconds
    delay = 0.3
    while not condition():
        assert time.monotonic() < end, f"'{key}' does not do it:\n{teleop.line}"
        session.spin(delay)
        delay = REPEAT
        teleop.type(key)
        teleop.look()


@pytest.mark.parametrize("stamped", [False, True])
def test_what_is_published_while_keys_are_held_and_after(own_domain, stamped):
    """No robot needed: twists at 20 Hz while held, a few zeros, then silence; zero at the end."""
    heard = []
    kind = TwistStamped if stamped else Twist
    options = ["--stamped"] if stamped else []
    with Session("probe") as session, terminal(own_domain, *options) as teleop:
        session.node.create_subscription(
            kind, "cmd_vel", lambda m: heard.append((time.monotonic(), m)), 100
        )
        teleop.wait(session, lambda: "no robot" in teleop.line, "status line")
        publishers = lambda: session.node.count_publishers("cmd_vel") == 1  # noqa: E731
        teleop.wait(session, publishers, "publisher of cmd_vel")

        def nudge():
            teleop.type(",")
            return bool(heard)

        assert session.wait(nudge, PATIENCE), "nothing published"

        def silent():
            return time.monotonic() - heard[-1][0] > 0.5

        teleop.wait(session, silent, "silence while nothing is held")
        heard.clear()
        began = time.monotonic()
        hold(teleop, session, "w", lambda: time.monotonic() - began > 1.5)
        speeds = [_twist(m).linear.x for _, m in heard]
        assert speeds.count(0.3) > 0.8 * len(speeds), "held; a busy machine may leave a gap"
        assert len(heard) == pytest.approx(1.5 / 0.05, rel=0.3)
        teleop.wait(session, silent, "silence after the motion")
        assert [_twist(m).linear.x for _, m in heard[-5:]] == [0.0] * 5
        assert _twist(heard[-6][1]).linear.x == 0.3
        if stamped:
            assert heard[0][1].header.frame_id == "base_link"
            assert heard[0][1].header.stamp.sec > 0

        teleop.type("w")
        teleop.wait(session, lambda: _twist(heard[-1][1]).linear.x == 0.3, "motion")
        teleop.process.send_signal(signal.SIGTERM)
        assert teleop.finish() == 0
        assert session.wait(lambda: _twist(heard[-1][1]).linear.x == 0.0, 5.0), "zero at the end"
        assert "zero sent" in teleop.screen


def _twist(message):
    return message.twist if isinstance(message, TwistStamped) else message


def test_drives_stops_and_resets_a_robot(own_domain):
    truth = []
    with (
        Running(command("up", *PATIENT), environment(own_domain)) as up,
        Session("probe") as session, terminal(own_domain) as teleop,
    ):  # fmt: skip
        up.wait_for("Ctrl-C stops")
        session.node.create_subscription(Odometry, "ground_truth/odom", truth.append, 10)

        def at_rest():
            speed = truth[-1].twist.twist
            return abs(speed.linear.x) < 1e-3 and abs(speed.angular.z) < 1e-3

        teleop.wait(session, lambda: truth and "free" in teleop.line, "robot")
        teleop.wait(session, lambda: "none" in teleop.line and "x +" in teleop.line, "status")

        hold(teleop, session, "w", lambda: truth[-1].twist.twist.linear.x > 0.29)
        teleop.wait(session, at_rest, "rest after the release")
        assert truth[-1].pose.pose.position.x > 0.1

        hold(teleop, session, "\x1b[D", lambda: truth[-1].twist.twist.angular.z > 0.55)
        teleop.type(" ")
        teleop.wait(session, lambda: "stopped: ~/stop" in teleop.line, "latched stop")
        teleop.wait(session, at_rest, "rest after the stop")
        count = len(truth)
        hold(teleop, session, "w", lambda: len(truth) > count + 60)
        assert at_rest(), "stopped until the reset"

        teleop.wait(session, lambda: "+0.00 +0.00 m/s" in teleop.line, "release")
        session.spin(0.3)
        teleop.type("r")
        teleop.wait(session, lambda: "free" in teleop.line, "reset")
        hold(teleop, session, "s", lambda: truth[-1].twist.twist.linear.x < -0.29)

        teleop.type("++-")
        teleop.wait(session, lambda: "keys 0.33 m/s" in teleop.line, "more speed")
        teleop.type("x")
        assert teleop.finish() == 0
        up.process.send_signal(signal.SIGINT)
        assert up.finish() == 0, up.output
    assert re.search(r"heading +\+?\d+ deg", teleop.screen)


def test_ctrl_c_quits_and_the_terminal_is_put_back(own_domain):
    with Session("probe") as session, terminal(own_domain) as teleop:
        teleop.wait(session, lambda: bool(teleop.line), "status line")
        teleop.type(" ")
        teleop.wait(session, lambda: "NO STOP" in teleop.line, "word that there is no robot")
        teleop.type("\x03")
        assert teleop.finish() == 0
