"""Motions of arm and tool by a client, on a whole robot in this process."""

import numpy as np
import pytest

from omniman_ros.client.handle import Outcome
from omniman_ros.client.state import RobotTimeoutError
from omniman_ros.core.arm_parameters import UR_JOINTS
from omniman_ros.core.errors import InputError, ParameterError
from test.client.test_robot import client_of
from test.nodes.whole_robot import WholeRobot

READY = (0.0, -1.9, 2.0, -1.7, -1.57, 0.0)  #: Angles of the arm at first [rad]


@pytest.fixture(scope="module")
def world():
    with WholeRobot(READY) as world:
        yield world


@pytest.fixture(scope="module")
def robot(world):
    with client_of(world, needs=("drive", "path", "arm", "tool")) as robot:
        yield robot


def angles(robot):
    return [robot.joints.value[name] for name in UR_JOINTS]


def test_joints_move_by_name_and_the_others_stay(robot):
    before = dict(robot.joints.value)
    robot.move_joints({"elbow_joint": before["elbow_joint"] + 0.3}).wait(timeout=20.0)
    after = robot.joints.value
    expected = before | {"elbow_joint": before["elbow_joint"] + 0.3}
    assert after == pytest.approx(expected, abs=5e-3)


def test_all_joints_move_in_a_given_time(world, robot):
    begin = world.time
    handle = robot.move_joints(READY, duration=3.0)
    handle.wait(timeout=20.0)
    assert world.time - begin == pytest.approx(3.0, abs=0.7)
    assert angles(robot) == pytest.approx(READY, abs=5e-3)


@pytest.mark.parametrize(
    ("target", "duration", "error", "words"),
    [
        ({"knee_joint": 1.0}, None, InputError, "knee_joint.*elbow_joint"),
        ({}, None, InputError, "no joint"),
        ([1.0, 2.0], None, InputError, "2 angles"),
        ({"elbow_joint": np.nan}, None, ParameterError, "elbow_joint"),
        ({"elbow_joint": 1.0}, 0.1, ParameterError, "duration"),
    ],
)
def test_angles_that_make_no_sense_are_refused(robot, target, duration, error, words):
    with pytest.raises(error, match=words):
        robot.move_joints(target, duration)


def test_an_angle_beyond_the_joints_limit_is_refused_by_the_node(robot):
    result = robot.move_joints({"elbow_joint": 6.0}).result(timeout=5.0)
    assert result.outcome is Outcome.REFUSED and "elbow_joint" in result.reason


def await_plan(world, handle):
    """Wait in real time for the planning thread, which a loop without pauses would starve."""
    tool = world.interpolator.motions.tool
    world.run_until(lambda: handle.feedback.state == "planning", 5.0, "the planning")
    world._await(lambda: not tool.is_planning, "the plan")


def test_the_tool_moves_relative_to_the_robot_in_a_straight_line(world, robot):
    start = np.array(robot.tool.value)
    handle = robot.move_tool(0.2, 0.1, 0.05, relative=True)
    await_plan(world, handle)
    handle.wait(timeout=60.0)
    assert robot.tool.value == pytest.approx(start + (0.2, 0.1, 0.05), abs=5e-3)


def test_goals_of_the_tool_need_a_planner_and_its_command_is_named(robot):
    with pytest.raises(RobotTimeoutError, match=r"no whole_body_planner .*--whole-body-planner"):
        robot.wait_until_ready(0.2, needs=("tool_goal",))


def test_a_path_of_the_tool_is_cancelled(world, robot):
    handle = robot.move_tool(2.0, 0.0, 0.0, relative=True)
    await_plan(world, handle)
    world.run_until(lambda: handle.feedback.state == "started", 5.0, "the begin")
    world.run(1.0)
    assert handle.cancel().outcome is Outcome.CANCELLED
    assert robot.twist.value == pytest.approx((0.0, 0.0, 0.0), abs=0.01)
