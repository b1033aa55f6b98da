"""Nodes as separate processes over DDS: signals, kills, simulated time."""

import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
import rclpy
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import JointState

from omniman_ros.nodes.registry import node_module
from test.nodes.harness import free_domain
from test.tiers import exhaustive

PATIENCE = 30.0
PATIENT = {
    "platform_controller": "timeouts.wheel_states:=2.0",
    "simulated_drive": "firmware.watchdog:=0.3",
}  #: Timeouts that other work on the machine does not exceed: only the test stops the robot


class NodeProcesses:
    """Node processes in a ROS domain of their own, and a probe that drives the robot."""

    def __init__(self) -> None:
        self.domain = free_domain()
        self.environment = os.environ | {
            "ROS_DOMAIN_ID": str(self.domain),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        }
        os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
        self.children: list[subprocess.Popen] = []
        self.context = rclpy.Context()
        self.context.init(domain_id=self.domain)
        self.probe = Node("probe", context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.probe)
        self.commands: list[JointState] = []
        self.truth: list[Odometry] = []
        self.probe.create_subscription(JointState, "wheel_commands", self.commands.append, 100)
        self.probe.create_subscription(Odometry, "ground_truth/odom", self.truth.append, 100)
        self.cmd_vel = self.probe.create_publisher(Twist, "cmd_vel", 1)

    def __enter__(self) -> "NodeProcesses":
        return self

    def __exit__(self, *_: object) -> None:
        for child in self.children:
            if child.poll() is None:
                child.kill()
                child.wait()
        self.probe.destroy_node()
        self.context.try_shutdown()

    def start(self, name: str, *parameters: str) -> subprocess.Popen:
        code = f"import sys; from {node_module(name)} import main; sys.exit(main())"
        given = [PATIENT[name], *parameters]
        arguments = [word for text in given for word in ("-p", text)]
        command = [sys.executable, "-c", code, "--ros-args", *arguments]
        child = subprocess.Popen(command, env=self.environment, stderr=subprocess.PIPE, text=True)
        self.children.append(child)
        return child

    def drive_until(self, until, what: str, x: float = 0.4) -> None:
        message = Twist()
        message.linear.x = x
        self.spin_until(until, what, lambda: self.cmd_vel.publish(message))

    def spin_until(self, until, what: str, each=lambda: None) -> None:
        deadline = time.monotonic() + PATIENCE
        while not until():
            assert time.monotonic() < deadline, f"waited {PATIENCE} s for: {what}"
            each()
            self.executor.spin_once(timeout_sec=0.02)

    def speed(self) -> float:
        return self.truth[-1].twist.twist.linear.x if self.truth else 0.0


@pytest.mark.parametrize("number", [signal.SIGINT, exhaustive(signal.SIGTERM)])
def test_on_a_signal_the_controller_ramps_the_wheels_down_before_it_ends(number):
    with NodeProcesses() as robot:
        drive = robot.start("simulated_drive")
        controller = robot.start("platform_controller")
        robot.drive_until(lambda: robot.speed() > 0.39, "the robot at speed")
        robot.commands.clear()
        controller.send_signal(number)
        robot.drive_until(lambda: controller.poll() is not None, "the controller's end")
        assert controller.returncode == 0
        speeds = np.array([c.velocity for c in robot.commands])
        assert speeds[0].min() > 2.0 and not speeds[-1].any()
        assert np.abs(np.diff(speeds, axis=0)).max() < 9.5 * 0.1, "a step rather than a ramp"
        robot.spin_until(lambda: robot.speed() < 0.01, "the robot at rest")
        drive.send_signal(number)
        assert drive.wait(PATIENCE) == 0


def test_the_drive_ramps_to_rest_when_the_controller_is_killed():
    with NodeProcesses() as robot:
        robot.start("simulated_drive")
        controller = robot.start("platform_controller")
        robot.drive_until(lambda: robot.speed() > 0.39, "the robot at speed")
        controller.kill()
        robot.drive_until(lambda: abs(robot.speed()) < 0.001, "the robot at rest")


def test_nodes_run_on_the_clock_that_the_drive_publishes():
    with NodeProcesses() as robot:
        robot.start("simulated_drive", "publish_clock:=true", "real_time_factor:=3.0")
        robot.start("platform_controller", "use_sim_time:=true")
        robot.drive_until(lambda: robot.speed() > 0.39, "the robot at speed")
        stamp = robot.commands[-1].header.stamp
        assert 1 <= stamp.sec < 1000, "commands are stamped with simulated time"
        robot.spin_until(lambda: abs(robot.speed()) < 0.001, "the robot at rest after silence")


@pytest.mark.parametrize(
    ("parameter", "word"),
    [
        ("robot:=nobody", "nobody"),
        ("limits.linear_velocity:=-1.0", "limits.linear_velocity"),
        exhaustive("coupling.k_epsilon:=2", "coupling.k_epsilon"),
        exhaustive("drive.mode:=magic", "drive.mode"),
    ],
)
def test_an_invalid_parameter_ends_the_node_with_a_message_that_names_it(parameter, word):
    with NodeProcesses() as robot:
        child = robot.start("platform_controller", parameter)
        _, error = child.communicate(timeout=PATIENCE)
        assert child.returncode == 1
        assert word in error and "Traceback" not in error, error


BLOCKED_NODE = """
import ctypes, os, signal
from omniman_ros.nodes import omniman_node, runtime

class Node(omniman_node.OmnimanNode):
    def destroy_node(self):
        ctypes.PyDLL(None).pause()  # blocks while holding Python's lock, as the middleware may

    finished = {finished}
    stop_timeout = 0.1

def make():
    signal.raise_signal(signal.SIGINT)
    return Node("blocked")

runtime.TAKE_DOWN_TIMEOUT = 1
runtime.run(make)
"""


ALARMED_NODE = """
import signal, sys
from omniman_ros.nodes import omniman_node, runtime

class Node(omniman_node.OmnimanNode):
    def destroy_node(self):
        if not self.finished:
            signal.raise_signal(signal.SIGALRM)
        super().destroy_node()

    finished = {finished}
    stop_timeout = 0.1

def make():
    signal.raise_signal(signal.SIGALRM)
    signal.raise_signal(signal.SIGINT)
    return Node("alarmed")

sys.exit(runtime.run(make))
"""


def run_to_its_end(code: str) -> subprocess.CompletedProcess:
    domain = {"ROS_DOMAIN_ID": str(free_domain()), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    return subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | domain,
        timeout=60,
        check=False,
        stderr=subprocess.PIPE,
        text=True,
    )


@pytest.mark.parametrize(("finished", "code"), [(True, 0), (False, 1)])
def test_no_alarm_ends_a_node_that_is_not_at_rest(finished, code):
    assert run_to_its_end(ALARMED_NODE.format(finished=finished)).returncode == code


@pytest.mark.parametrize(("finished", "code"), [(True, -signal.SIGALRM), (False, 1)])
def test_a_node_that_blocks_in_the_middleware_is_ended_nevertheless(finished, code):
    ended = run_to_its_end(BLOCKED_NODE.format(finished=finished))
    assert ended.returncode == code
    assert ("Timeout (" in ended.stderr and "in destroy_node" in ended.stderr) == (not finished)
