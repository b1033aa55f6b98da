"""A simulated robot whose processes are held up: time waits, and no timeout strikes."""

import os
import re
import signal
import subprocess
import sys
from contextlib import contextmanager

import numpy as np
import pytest
from geometry_msgs.msg import Twist
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState

from omniman_ros.console.session import Session
from test.nodes.harness import free_domain
from test.running import arm_on_free_ports
from test.tiers import representative

pytestmark = pytest.mark.processes

PATIENCE = 120.0  #: Real time for what a test waits for [s]
STOP = 2.0  #: Real time for which simulated time has to stand while a process is stopped [s]
SPEED = 0.2  #: Forward velocity of the platform [m/s]
SIMULATED_PARTS = (
    "simulated_drive",
    "platform_controller",
    "path_interpolator",
    "mpc_planner",
    "arm_streamer",
    "simulated_ur",
)
PARTS_ON_A_BUS = ("simulated_can_drives", "can_bridge", "platform_controller")


class Robot:
    """A robot on simulated time, driven forwards, and the times and speeds that it shows."""

    def __init__(self, session, up):
        self.session, self.up = session, up
        self.time, self.speeds, self.arm = 0.0, [], []
        self._passed_at = session.now()
        self.output = ""
        node = session.node
        node.create_subscription(Clock, "/clock", self._on_clock, 200)
        node.create_subscription(JointState, "wheel_states", self._on_states, 200)
        node.create_subscription(JointState, "arm/joint_states", self.arm.append, 10)
        self._twists = node.create_publisher(Twist, "cmd_vel", 1)
        node.create_timer(0.02, self._drive)
        self.is_driven = True

    def _on_clock(self, message):
        now = message.clock.sec + 1e-9 * message.clock.nanosec
        if now != self.time:
            self.time, self._passed_at = now, self.session.now()

    def has_stood(self):
        return self.session.now() - self._passed_at > STOP

    def _on_states(self, message):
        self.speeds.append(float(np.abs(message.velocity).min()))

    def _drive(self):
        if self.is_driven:
            twist = Twist()
            twist.linear.x = SPEED
            self._twists.publish(twist)

    def until(self, condition, what):
        assert self.session.wait(condition, PATIENCE), f"waited for {what}: {self.log()}"

    def advance(self, seconds):
        end = self.time + seconds
        self.until(lambda: self.time > end, f"{seconds} s of simulated time")

    def pid(self, name):
        found = re.search(rf"{name} \(pid (\d+)\)", self.log())
        return int(found[1])

    def log(self):
        self.up.stdout.flush()
        with open(self.up.stdout.name) as file:
            return file.read()


@contextmanager
def running(folder, parts, *options):
    """Run a robot whose wheels turn; each test leaves it so."""
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    os.environ["ROS_DOMAIN_ID"] = str(free_domain())
    with open(folder / "log", "w") as log:
        command = ["up", "--sim-time", *arm_on_free_ports(), *options, "--only", *parts]
        up = subprocess.Popen(
            [sys.executable, "-m", "omniman_ros.cli.main", *command],
            stdout=log,
            stderr=subprocess.STDOUT,
        )
        up.stdout = log
        try:
            with Session("probe") as session:
                it = Robot(session, up)
                has_arm = "simulated_ur" in parts
                it.until(
                    lambda: (it.arm or not has_arm) and it.speeds and it.speeds[-1] > 1.0,
                    "motion",
                )
                it.advance(1.0)
                yield it
        finally:
            up.send_signal(signal.SIGINT)
            code = up.wait(PATIENCE)
    assert code == 0


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    with running(tmp_path_factory.mktemp("up"), SIMULATED_PARTS) as robot:
        yield robot


@pytest.fixture(scope="module")
def robot_on_a_bus(tmp_path_factory):
    with running(tmp_path_factory.mktemp("up"), PARTS_ON_A_BUS, "--drive", "can") as robot:
        yield robot


@pytest.mark.parametrize("name", representative(SIMULATED_PARTS, 2))
def test_time_waits_for_a_process_that_is_stopped_and_the_robot_drives_on(robot, name):
    stop_for_a_while(robot, name)


@pytest.mark.exhaustive
@pytest.mark.parametrize("name", PARTS_ON_A_BUS)
def test_time_waits_for_a_process_that_is_stopped_on_a_bus(robot_on_a_bus, name):
    """The timeouts of the bus are those of real drives: three reports of 5 ms."""
    stop_for_a_while(robot_on_a_bus, name)


def stop_for_a_while(robot, name):
    """Stop a process until simulated time has stood for a while; nothing else must happen."""
    before = robot.log()
    robot.speeds.clear()
    os.kill(robot.pid(name), signal.SIGSTOP)
    try:
        robot.until(robot.has_stood, "simulated time to stand")
    finally:
        os.kill(robot.pid(name), signal.SIGCONT)
    robot.advance(1.0)
    assert min(robot.speeds) > 1.0, "the robot has slowed down"
    # DDS may deliver a report of the wheels twice, which is warned of and does no harm.
    news = robot.log().removeprefix(before)
    assert not re.search("stop|hold|silent|stale|lost|keep up", news), news


def test_time_goes_on_without_a_process_that_stays_stopped(robot):
    """Its death is then found by the others in simulated time: here, by the drives."""
    pid = robot.pid("platform_controller")
    os.kill(pid, signal.SIGSTOP)
    try:
        robot.until(lambda: "does not keep up with /clock" in robot.log(), "the warning")
        robot.until(lambda: robot.speeds[-1] < 0.01, "the drives' own ramp to rest")
    finally:
        os.kill(pid, signal.SIGCONT)
    robot.until(lambda: robot.speeds[-1] > 1.0, "motion by a new command")
