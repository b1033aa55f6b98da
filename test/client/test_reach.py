"""Goals of the tool, and of platform and joints, by a client: reached, or refused."""

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped

from omniman_ros.client.handle import Outcome
from omniman_ros.client.messages import joint_goal, tool_goal
from omniman_ros.core.errors import InputError, ParameterError
from omniman_ros.nodes.stop_interface import ALL_LATCHED
from test.client.test_robot import client_of
from test.nodes.test_path_interpolator_tool import START
from test.nodes.test_whole_body_planner import DodgeWorld


@pytest.fixture(scope="module")
def world():
    with DodgeWorld() as world:
        states = world.publisher(DiagnosticStatus, "stop_state", ALL_LATCHED)
        states.publish(DiagnosticStatus(name="/platform_controller"))
        yield world


@pytest.fixture(scope="module")
def robot(world):
    with client_of(world, needs=("tool_goal", "joint_goal")) as robot:
        yield robot


def ended(world, handle):
    """Return how a goal ended; it is planned in real time."""
    world.run(0.2)
    world.wait_for_plan()
    return handle.result(timeout=60.0)


def test_the_tool_reaches_its_goal_and_keeps_its_orientation(world, robot):
    target = START[:3, 3] + [0.2, 0.1, 0.05]
    handle = robot.reach(*target)
    assert ended(world, handle).outcome is Outcome.ARRIVED
    assert handle.feedback.progress == pytest.approx(1.0, abs=0.02)
    assert robot.tool.value == pytest.approx(target, abs=2e-3)
    last, first = (world.tool_references[k].pose.orientation for k in (-1, 0))
    assert [last.x, last.y, last.z, last.w] == pytest.approx(
        [first.x, first.y, first.z, first.w], abs=1e-6
    )


def test_a_goal_out_of_reach_is_refused_with_the_reason(world, robot):
    result = ended(world, robot.reach(1.0, 0.0, 3.0))
    assert result.outcome is Outcome.REFUSED and "finds no place" in result.reason


def test_platform_and_joints_reach_their_goal(world, robot):
    names, start = tuple(robot.joints.value), np.array([*robot.joints.value.values()])
    angles = start + [0.1, 0.0, -0.1, 0.0, 0.0, 0.2]
    handle = robot.move_body(0.2, 0.1, 0.3, dict(zip(names, angles, strict=True)))
    assert ended(world, handle).outcome is Outcome.ARRIVED
    pose = robot.pose.value
    assert [pose.x, pose.y, pose.heading] == pytest.approx([0.2, 0.1, 0.3], abs=5e-3)
    assert [*robot.joints.value.values()] == pytest.approx(angles, abs=2e-3)


def test_a_goal_of_platform_and_joints_is_cancelled_by_its_handle(world, robot):
    handle = robot.move_body(1.5, 0.0, 0.0, [*robot.joints.value.values()])
    world.run(0.2)
    world.run_to_motion_start()
    world.run(0.5)
    handle.cancel()
    assert handle.result(timeout=10.0).outcome is Outcome.CANCELLED
    assert robot.pose.value.x < 1.0


def test_a_goal_of_the_joints_has_the_platform_first_and_its_frame():
    message = joint_goal(1.0, 2.0, 0.5, {"b": 0.1}, ("a", "b"), "map")
    assert message.header.frame_id == "map"
    assert message.joint_names == ["odom_x", "odom_y", "odom_t", "b"]
    assert list(message.points[0].positions) == [1.0, 2.0, 0.5, 0.1]
    with pytest.raises(ParameterError, match="heading"):
        joint_goal(1.0, 2.0, float("nan"), [0.1, 0.2], ("a", "b"), "odom")


def test_an_orientation_is_sent_as_it_is():
    message = tool_goal(1.0, 2.0, 0.5, (0.0, 0.6, 0.0, 0.8), "map")
    assert isinstance(message, PoseStamped) and message.header.frame_id == "map"
    assert (message.pose.orientation.y, message.pose.orientation.w) == (0.6, 0.8)


@pytest.mark.parametrize(
    ("goal", "error"),
    [
        ((float("nan"), 0.0, 0.5), ParameterError),
        ((1.0, 0.0, 0.5, (0.0, 0.0, 1.0)), InputError),
        ((1.0, 0.0, 0.5, (0.0, 0.0, float("inf"), 0.0)), InputError),
    ],
)
def test_a_goal_that_makes_no_sense_is_refused_before_it_is_sent(robot, goal, error):
    with pytest.raises(error):
        robot.reach(*goal)
