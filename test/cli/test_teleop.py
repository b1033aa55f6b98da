"""`omniman teleop` in a pseudo-terminal, without a robot."""

import signal
import time

import pytest
from geometry_msgs.msg import Twist, TwistStamped

from omniman_ros.console.session import Session
from test.cli.teleop_terminal import hold, terminal
from test.running import PATIENCE

pytestmark = pytest.mark.processes


def twist_of(message):
    return message.twist if isinstance(message, TwistStamped) else message


@pytest.mark.parametrize("stamped", [False, True])
def test_twists_are_published_while_a_key_is_held_then_zeros_then_nothing(own_domain, stamped):
    """At 20 Hz while it is held, a few zeros after it, then silence; a zero at the end."""
    received = []
    message_type = TwistStamped if stamped else Twist
    with Session("probe") as session, terminal(own_domain) as teleop:
        session.node.create_subscription(
            message_type, "cmd_vel", lambda m: received.append((time.monotonic(), m)), 100
        )
        teleop.wait(session, lambda: "no robot" in teleop.line, "status line")
        teleop.wait(
            session,
            lambda: session.node.count_publishers("cmd_vel") == 1,
            "publisher of cmd_vel",
        )

        def has_moved():
            teleop.type(",")
            return bool(received)

        assert session.wait(has_moved, PATIENCE), "nothing published"

        def is_silent():
            return time.monotonic() - received[-1][0] > 0.5

        teleop.wait(session, is_silent, "silence while no key is held")
        received.clear()
        start = time.monotonic()
        hold(teleop, session, "w", lambda: time.monotonic() - start > 1.5)
        speeds = [twist_of(m).linear.x for _, m in received]
        assert speeds.count(0.3) > 0.8 * len(speeds), "a busy machine may leave a gap"
        assert len(received) == pytest.approx(1.5 / 0.05, rel=0.3)
        teleop.wait(session, is_silent, "silence after the motion")
        assert [twist_of(m).linear.x for _, m in received[-5:]] == [0.0] * 5
        assert twist_of(received[-6][1]).linear.x == 0.3
        if stamped:
            assert received[0][1].header.frame_id == "base_link"
            assert received[0][1].header.stamp.sec > 0

        teleop.type("w")
        teleop.wait(session, lambda: twist_of(received[-1][1]).linear.x == 0.3, "motion")
        teleop.process.send_signal(signal.SIGTERM)
        assert teleop.finish() == 0
        assert session.wait(lambda: twist_of(received[-1][1]).linear.x == 0.0, 5.0), "no zero"
        assert "zero twist sent" in teleop.screen


def test_ctrl_c_quits(own_domain):
    with Session("probe") as session, terminal(own_domain) as teleop:
        teleop.wait(session, lambda: bool(teleop.line), "status line")
        teleop.type(" ")
        teleop.wait(session, lambda: "NO STOP" in teleop.line, "report that there is no robot")
        teleop.type("\x03")
        assert teleop.finish() == 0
