"""`omniman up` with real nodes: a moving robot, then a signal or the end of a node."""

import os
import signal
from contextlib import contextmanager
from itertools import pairwise

import pytest
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from sensor_msgs.msg import JointState

from omniman_ros.console.session import Session
from omniman_ros.conversions.headers import time_seconds
from test.running import (
    PATIENCE,
    PATIENT,
    Running,
    children_of,
    command,
    environment,
    is_alive,
    wait_until,
)
from test.tiers import exhaustive

pytestmark = pytest.mark.processes

SPEED = 0.3
LATE = 0.02  #: Time by which stamps of the controller may be late: some of its ticks [s]
DECELERATION = 1.2  #: limits.linear_deceleration of the default robot [m/s^2]
NODES = ("platform_controller", "simulated_drive")
ONLY_NODES = ("--only", *NODES)


class Probe:
    """Drives the robot, and receives the commands of its wheels and its true motion."""

    def __init__(self, session):
        self.session = session
        self.commands, self.stamps = [], []
        self.truth = None
        self.publisher = session.node.create_publisher(Twist, "cmd_vel", 1)
        session.node.create_subscription(JointState, "wheel_commands", self._on_command, 100)
        session.node.create_subscription(Odometry, "ground_truth/odom", self._on_truth, 10)

    def _on_command(self, message):
        self.commands.append(list(message.velocity))
        self.stamps.append(time_seconds(message.header.stamp))

    def _on_truth(self, message):
        self.truth = message

    def is_fast(self):
        forward = Twist()
        forward.linear.x = SPEED
        self.publisher.publish(forward)
        is_commanded = bool(self.commands) and any(self.commands[-1])  # topics are found apart
        return (
            is_commanded
            and self.truth is not None
            and self.truth.twist.twist.linear.x > 0.9 * SPEED
        )

    def await_end(self, process):
        """Receive commands and motion until a process has ended."""
        assert self.session.wait(lambda: process.poll() is not None, PATIENCE)

    def await_zero_command(self):
        """Receive what is still queued until the last command is zero, or time is up."""
        self.session.wait(lambda: not any(self.commands[-1]), PATIENCE)

    def await_rest(self):
        """Receive what is still queued until the truth is at rest, or time is up."""
        self.session.wait(lambda: self.speed < 0.02, PATIENCE)

    @property
    def speed(self):
        return abs(self.truth.twist.twist.linear.x)

    def drive(self, up):
        if not self.session.wait(self.is_fast, PATIENCE):
            up.process.terminate()
            up.finish()
            pytest.fail(f"the robot does not move:\n{up.output}")


@pytest.fixture(autouse=True)
def no_shared_memory(monkeypatch):
    """Exchange messages by UDP only.

    A process that is killed while it writes to the middleware's shared memory may leave it locked:
    the probe would then receive nothing more from the others.
    """
    monkeypatch.setenv("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4")


@contextmanager
def moving_robot(*options):
    """Start a robot and drive it: the running command, the probe, the nodes' process ids."""
    with Running(
        command("up", *PATIENT, *options), environment(int(os.environ["ROS_DOMAIN_ID"]))
    ) as up:
        up.wait_for("Ctrl-C stops")
        with Session("probe") as session:
            probe = Probe(session)
            probe.drive(up)
            pids = {
                name: pid
                for pid, line in children_of(up.process.pid).items()
                for name in NODES
                if name in line
            }
            yield up, probe, pids
        wait_until(lambda: not any(map(is_alive, pids.values())), "the end of the nodes")


@pytest.mark.parametrize(
    "number", [signal.SIGINT, exhaustive(signal.SIGTERM)], ids=["INT", "TERM"]
)
def test_a_signal_brings_the_moving_robot_to_rest_and_ends_up_with_code_0(own_domain, number):
    with moving_robot("--robot", "ig42", *ONLY_NODES) as (up, probe, pids):
        assert len(pids) == 2
        up.process.send_signal(number)
        probe.await_end(up.process)
        assert up.finish() == 0, up.output
        probe.await_zero_command()
        probe.await_rest()
    assert not any(probe.commands[-1])
    speeds = [max(map(abs, command)) for command in probe.commands]
    assert max(speeds) > 1.0
    # The truth was published until the controller had ended: the drive outlived it.
    assert probe.speed < 0.02


def test_a_killed_drive_is_reported_and_the_robot_is_stopped(own_domain):
    with moving_robot(*ONLY_NODES, "--no-sim-time") as (up, probe, pids):
        os.kill(pids["simulated_drive"], signal.SIGKILL)
        probe.await_end(up.process)
        assert up.finish() == 1
        probe.await_zero_command()
    assert "simulated_drive was killed by SIGKILL: stopping the robot" in up.output
    assert not any(probe.commands[-1]), up.output
    rows = [max(map(abs, command)) for command in probe.commands]
    largest = DECELERATION * max(rows) / SPEED  # of a wheel [rad/s^2]
    drops = [before - after for before, after in pairwise(rows)]
    times = [after - before for before, after in pairwise(probe.stamps)]
    cut_off = [
        drop for drop, time in zip(drops, times, strict=True) if drop > largest * (time + LATE)
    ]
    assert not cut_off, "the wheels were cut off rather than ramped down"


def test_a_killed_controller_is_reported_and_the_drive_stops_by_itself(own_domain):
    with moving_robot(*ONLY_NODES) as (up, probe, pids):
        os.kill(pids["platform_controller"], signal.SIGKILL)
        probe.await_end(up.process)
        assert up.finish() == 1
        probe.await_rest()
    assert "platform_controller was killed by SIGKILL: stopping the robot" in up.output
    assert probe.speed < 0.02


def test_nodes_do_not_outlive_a_killed_up(own_domain):
    with moving_robot(*ONLY_NODES) as (up, _, pids):
        up.process.kill()
        wait_until(lambda: not any(map(is_alive, pids.values())), "the end of the nodes")


def test_a_value_that_a_node_would_refuse_is_reported_before_any_starts(own_domain):
    env = environment(own_domain)
    with Running(command("up", "-p", "position.k_xy:=-1.0", *ONLY_NODES), env) as up:
        assert up.finish() == 2
    assert "error: parameter 'position.k_xy' = -1.0 is refused: below the minimum 0" in up.output
    assert "stopping the robot" not in up.output


def test_a_robot_in_a_namespace_runs_on_simulated_time(own_domain):
    env = environment(own_domain)
    with Running(command("up", *PATIENT, "--sim-time", "--namespace", "robot1"), env) as up:
        up.wait_for("Ctrl-C stops")
        with Session("probe", "robot1") as session:
            Probe(session).drive(up)
        up.process.send_signal(signal.SIGINT)
        assert up.finish() == 0, up.output
