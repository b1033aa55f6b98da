"""`omniman up` with real nodes: in motion, then a signal or a death."""

import os
import signal
from contextlib import contextmanager

import pytest
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from sensor_msgs.msg import JointState

from omniman_ros.cli.session import Session

from .support import (
    PATIENCE,
    PATIENT,
    Running,
    children_of,
    command,
    environment,
    is_alive,
    wait_until,
)

pytestmark = pytest.mark.processes

SPEED = 0.3


class Probe:
    """Drives the robot and hears what its wheels are told."""

    def __init__(self, session):
        self.session = session
        self.commands = []
        self.truth = None
        self.publisher = session.node.create_publisher(Twist, "cmd_vel", 1)
        session.node.create_subscription(JointState, "wheel_commands", self._on_command, 100)
        session.node.create_subscription(Odometry, "ground_truth/odom", self._on_truth, 10)

    def _on_command(self, message):
        self.commands.append(list(message.velocity))

    def _on_truth(self, message):
        self.truth = message

    def fast(self):
        self.publisher.publish(Twist(linear=self._forward))
        heard = bool(self.commands) and any(self.commands[-1])  # each topic is found by itself
        return heard and self.truth is not None and self.truth.twist.twist.linear.x > 0.9 * SPEED

    @property
    def _forward(self):
        forward = Twist().linear
        forward.x = SPEED
        return forward

    def hear_rest(self):
        """Serve what is still queued until the command in hand is zero, or time is up."""
        self.session.wait(lambda: not any(self.commands[-1]), PATIENCE)

    def drive(self, up):
        if not self.session.wait(self.fast, PATIENCE):
            up.process.terminate()
            up.finish()
            pytest.fail(f"the robot does not move:\n{up.output}")


@contextmanager
def robot(*options):
    """A robot that drives: the running command, the probe, and the nodes' process ids."""
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
                for name in ("platform_controller", "simulated_drive")
                if name in line
            }
            yield up, probe, pids
        wait_until(lambda: not any(map(is_alive, pids.values())), "the end of the nodes")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_brings_the_moving_robot_to_rest_and_ends_all_with_code_0(own_domain, number):
    with robot("--robot", "ig42") as (up, probe, pids):
        assert len(pids) == 2
        up.process.send_signal(number)
        wait_until(lambda: not is_alive(pids["platform_controller"]), "the controller's end")
        assert up.finish() == 0, up.output
        probe.hear_rest()
    assert not any(probe.commands[-1])
    speeds = [max(map(abs, command)) for command in probe.commands]
    assert max(speeds) > 1.0
    # The truth was published until the controller had ended: the drive outlived it.
    assert abs(probe.truth.twist.twist.linear.x) < 0.02


def test_a_killed_drive_is_reported_and_stops_the_robot(own_domain):
    with robot() as (up, probe, pids):
        os.kill(pids["simulated_drive"], signal.SIGKILL)
        assert up.finish() == 1
        probe.hear_rest()
    assert "simulated_drive was killed by SIGKILL: stopping the robot" in up.output
    assert not any(probe.commands[-1])
    rows = [max(map(abs, command)) for command in probe.commands]
    last_motion = max(i for i, speed in enumerate(rows) if speed > 0.0)
    before = rows[last_motion - 5]
    assert before < 0.5 * max(rows), "the wheels were ramped down, not cut off"


def test_a_killed_controller_is_reported_and_the_drive_stops_by_itself(own_domain):
    with robot() as (up, probe, pids):
        os.kill(pids["platform_controller"], signal.SIGKILL)
        assert up.finish() == 1
        probe.session.spin(0.5)
    assert "platform_controller was killed by SIGKILL: stopping the robot" in up.output
    assert abs(probe.truth.twist.twist.linear.x) < 0.02


def test_nodes_do_not_outlive_a_killed_up(own_domain):
    with robot() as (up, _, pids):
        up.process.kill()
        wait_until(lambda: not any(map(is_alive, pids.values())), "the end of the nodes")


def test_a_node_that_cannot_start_is_reported(own_domain):
    env = environment(own_domain)
    with Running(command("up", "-p", "position.k_xy:=-1.0"), env) as up:
        assert up.finish() == 1
    assert "cannot start" in up.output
    assert "position.k_xy" in up.output
    assert "platform_controller ended with exit code 1: stopping the robot" in up.output


def test_all_runs_on_simulated_time_in_a_namespace(own_domain):
    env = environment(own_domain)
    with Running(command("up", *PATIENT, "--sim-time", "--namespace", "robot1"), env) as up:
        up.wait_for("Ctrl-C stops")
        with Session("probe", "robot1") as session:
            Probe(session).drive(up)
        up.process.send_signal(signal.SIGINT)
        assert up.finish() == 0, up.output
