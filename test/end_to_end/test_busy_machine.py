"""A robot of processes beside busy loops on every core."""

import contextlib
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from omniman_ros.console.session import Session
from test.end_to_end.test_can_processes import NODES, SPEED, Probe
from test.running import Running, command, environment

pytestmark = pytest.mark.exhaustive

GUESTS = 200
"""Number of participants that come and go."""
MOST = 0.9
"""Share of the guests that must have heard the robot for the test to mean something."""
STARTS = 10
"""Number of starts with drives on a bus."""


@pytest.fixture
def busy():
    """Keep every core busy."""
    with contextlib.ExitStack() as stack:
        for _ in range(os.cpu_count() or 1):
            loop = stack.enter_context(
                subprocess.Popen([sys.executable, "-c", "while True: pass"])
            )
            stack.callback(loop.kill)
        yield


def end(up):
    """Stop a robot by Ctrl-C."""
    up.process.send_signal(signal.SIGINT)
    assert up.finish() == 0, up.output


@pytest.mark.usefixtures("busy")
def test_participants_that_come_and_go_stop_nothing(own_domain):
    env = environment(own_domain)
    nodes = ("platform_controller", "simulated_drive")
    up = command("up", "--no-sim-time", "--arm", "none", "--only", *nodes)
    guests = [sys.executable, str(Path(__file__).with_name("guests.py")), str(GUESTS)]
    with Running(up, env) as robot, Session("probe") as session:
        probe = Probe(session)
        probe.ask(x=SPEED, turn=0.5)
        probe.until(probe.moves, "motion")
        with subprocess.Popen(guests, env=env, stdout=subprocess.PIPE, text=True) as visits:
            while visits.poll() is None:
                session.spin(0.2)
                states = {state.split(":")[0] for state in probe.reasons.values()}
                assert states == {"running"}, f"{probe.reasons}\n{robot.output}"
            assert int(visits.stdout.read()) > MOST * GUESTS
        probe.until(probe.moves, "motion after all guests")
        probe.ask()
        probe.come_to_rest()
        end(robot)


@pytest.mark.usefixtures("busy")
@pytest.mark.parametrize("number", range(STARTS))
def test_robot_with_drives_on_a_bus_starts_without_a_reset(own_domain, number):
    up = command("up", "--drive", "can", "--arm", "none", "--only", *NODES)
    with Running(up, environment(own_domain)) as robot, Session("probe") as session:
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
