"""A robot of processes beside busy loops on every core."""

import contextlib
import os
import signal
import subprocess
import sys

import pytest

from omniman_ros.console.session import Session
from test.end_to_end.test_can_processes import NODES, SPEED, Probe
from test.running import Running, command, environment

pytestmark = pytest.mark.exhaustive

STARTS = 10  #: Number of starts with drives on a bus


@contextlib.contextmanager
def busy():
    """Keep every core busy."""
    with contextlib.ExitStack() as stack:
        for _ in range(os.cpu_count() or 1):
            loop = subprocess.Popen([sys.executable, "-c", "while True: pass"])
            stack.enter_context(loop)
            stack.callback(loop.kill)
        yield


def end(up):
    """Stop a robot by Ctrl-C."""
    up.process.send_signal(signal.SIGINT)
    assert up.finish() == 0, up.output


@pytest.mark.parametrize("number", range(STARTS))
def test_robot_with_drives_on_a_bus_starts_without_a_reset(own_domain, number):
    up = command("up", "--drive", "can", "--arm", "none", "--only", *NODES)
    env = environment(own_domain)
    with busy(), Running(up, env) as robot, Session("probe") as session:
        robot.wait_for("Ctrl-C stops")
        probe = Probe(session)
        probe.ask(x=SPEED)
        try:
            probe.until(probe.moves, f"motion after start {number}")
        except AssertionError as error:
            robot.process.terminate()
            robot.finish()
            pytest.fail(f"{error}\n{robot.output}")
        end(robot)
