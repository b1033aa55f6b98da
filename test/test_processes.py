"""Nodes as processes of their own, over DDS: signals, kills, simulated time."""

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

from .nodes.harness import free_domain

PATIENCE = 30.0
PATIENT = {
    "platform_controller": "timeouts.wheel_states:=2.0",
    "simulated_drive": "firmware.watchdog:=0.3",
}
"""Other work on the machine must not stop the robot before the test does."""


class Processes:
    """Processes in a domain of their own, and a probe that drives."""

    def __init__(self) -> None:
        self.domain = free_domain()
        self.environment = os.environ | {
            "ROS_DOMAIN_ID": str(self.domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        }  # fmt: skip
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

    def __enter__(self) -> "Processes":
        return self

    def __exit__(self, *_: object) -> None:
        for child in self.children:
            if child.poll() is None:
                child.kill()
                child.wait()
        self.probe.destroy_node()
        self.context.try_shutdown()

    def start(self, name: str, *parameters: str) -> subprocess.Popen:
        code = f"import sys; from omniman_ros.nodes.{name} import main; sys.exit(main())"
        given = [PATIENT[name], *parameters]
        arguments = [word for text in given for word in ("-p", text)]
        command = [sys.executable, "-c", code, "--ros-args", *arguments]
        child = subprocess.Popen(command, env=self.environment, stderr=subprocess.PIPE, text=True)
        self.children.append(child)
        return child

    def drive(self, until, what: str, x: float = 0.4) -> None:
        message = Twist()
        message.linear.x = x
        self.spin(until, what, lambda: self.cmd_vel.publish(message))

    def spin(self, until, what: str, each=lambda: None) -> None:
        deadline = time.monotonic() + PATIENCE
        while not until():
            assert time.monotonic() < deadline, f"waited {PATIENCE} s for: {what}"
            each()
            self.executor.spin_once(timeout_sec=0.02)

    def speed(self) -> float:
        return self.truth[-1].twist.twist.linear.x if self.truth else 0.0


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_in_motion_ramps_the_wheels_down_before_the_end(number):
    with Processes() as world:
        drive = world.start("simulated_drive")
        controller = world.start("platform_controller")
        world.drive(lambda: world.speed() > 0.39, "the robot at speed")
        world.commands.clear()
        controller.send_signal(number)
        world.drive(lambda: controller.poll() is not None, "the controller's end")
        assert controller.returncode == 0
        speeds = np.array([c.velocity for c in world.commands])
        assert speeds[0].min() > 2.0 and not speeds[-1].any()
        assert np.abs(np.diff(speeds, axis=0)).max() < 9.5 * 0.1, "a jump, not a ramp"
        world.spin(lambda: world.speed() < 0.01, "the robot at rest")
        drive.send_signal(number)
        assert drive.wait(PATIENCE) == 0


def test_a_killed_controller_lets_the_drive_ramp_to_rest():
    with Processes() as world:
        world.start("simulated_drive")
        controller = world.start("platform_controller")
        world.drive(lambda: world.speed() > 0.39, "the robot at speed")
        controller.kill()
        world.drive(lambda: abs(world.speed()) < 0.001, "the robot at rest")


def test_nodes_run_on_the_clock_that_the_drive_makes():
    with Processes() as world:
        world.start("simulated_drive", "publish_clock:=true", "real_time_factor:=3.0")
        world.start("platform_controller", "use_sim_time:=true")
        world.drive(lambda: world.speed() > 0.39, "the robot at speed")
        stamp = world.commands[-1].header.stamp
        assert 1 <= stamp.sec < 1000, "commands are stamped with simulated time"
        world.spin(lambda: abs(world.speed()) < 0.001, "the robot at rest after silence")


@pytest.mark.parametrize(
    ("given", "word"),
    [("robot:=nobody", "nobody"), ("limits.linear_velocity:=-1.0", "limits.linear_velocity"),
     ("coupling.k_epsilon:=2", "coupling.k_epsilon"), ("drive.mode:=magic", "drive.mode")],
)  # fmt: skip
def test_nonsense_at_start_ends_with_a_message_that_names_it(given, word):
    with Processes() as world:
        child = world.start("platform_controller", given)
        _, said = child.communicate(timeout=PATIENCE)
        assert child.returncode == 1
        assert word in said and "Traceback" not in said, said


LOCKED_UP = """
import ctypes, os, signal
from omniman_ros.nodes import runtime

class Node(runtime.OmnimanNode):
    def destroy_node(self):
        ctypes.PyDLL(None).pause()  # waits with Python's lock held, as the middleware may

def make():
    signal.raise_signal(signal.SIGINT)
    return Node("locked_up")

runtime.TAKE_DOWN = 1
runtime.run(make)
"""


def test_a_node_that_locks_up_in_the_middleware_is_gone_all_the_same():
    domain = {"ROS_DOMAIN_ID": str(free_domain()), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    ended = subprocess.run(
        [sys.executable, "-c", LOCKED_UP], env=os.environ | domain, timeout=60, check=False
    )
    assert ended.returncode == -signal.SIGALRM
