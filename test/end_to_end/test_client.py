"""A simulated robot of processes, moved by clients with threads of their own."""

import math
import os
import signal
import subprocess
import sys

import pytest

from omniman_ros.client.handle import Outcome
from omniman_ros.client.robot import Robot
from omniman_ros.client.simulated import simulated_robot
from omniman_ros.client.state import RobotError
from test.running import PATIENCE

SCRIPT = """
import sys, time
from omniman_ros.client.robot import Robot
robot = Robot()
robot.wait_until_ready(60.0)
robot.drive(0.2, 0.0, 0.5)
while robot.twist.value.wz < 0.4:
    time.sleep(0.01)
print("drives", flush=True)
"""  # its robot is neither closed nor in a `with` block


@pytest.fixture(scope="module")
def robot():
    with simulated_robot("ig42", arm=False) as robot:
        yield robot


def speed(robot):
    return max(map(abs, robot.twist.value))


def test_a_goal_arrives_and_another_one_is_cancelled(robot):
    x, y, heading = robot.pose.value
    robot.go_to(x + 0.4, y, heading).wait(PATIENCE)
    assert robot.pose.value[:2] == pytest.approx((x + 0.4, y), abs=0.05)
    handle = robot.go_to(x + 3.0, y, heading)
    assert robot._link.wait(lambda: speed(robot) > 0.2, PATIENCE)
    assert handle.cancel().outcome is Outcome.CANCELLED
    assert robot._link.wait(lambda: speed(robot) < 0.01, PATIENCE)


def test_an_exception_in_the_block_of_a_client_stops_the_robot(robot):
    with pytest.raises(ZeroDivisionError), Robot(domain=robot.domain) as other:
        other.wait_until_ready(PATIENCE)
        x, y, heading = other.pose.value
        handle = other.go_to(x - 3.0, y, heading)
        assert other._link.wait(lambda: speed(other) > 0.2, PATIENCE)
        _ = 1 / 0
    assert handle.outcome is Outcome.CANCELLED
    assert speed(robot) < 0.02


@pytest.mark.parametrize("end", ["sys.exit(3)", "1 / 0", "time.sleep(600)"])
def test_a_script_that_forgets_its_robot_stops_it_when_it_ends(robot, end):
    env = os.environ | {"ROS_DOMAIN_ID": str(robot.domain)}
    env["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    command = [sys.executable, "-c", SCRIPT + end]
    with subprocess.Popen(command, env=env, stdout=subprocess.PIPE, text=True) as script:
        assert script.stdout.readline() == "drives\n"
        if "sleep" in end:
            script.send_signal(signal.SIGINT)
        assert script.wait(PATIENCE) != 0
    assert robot._link.wait(lambda: speed(robot) < 0.01, 1.0)
    assert math.isfinite(robot.pose.value.x)


def test_arguments_that_cannot_be_used_start_nothing():
    with pytest.raises(RobotError, match="nobody"), simulated_robot("nobody"):
        pass
