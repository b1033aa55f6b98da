"""Tests of the planner's action `navigate_to_pose`."""

from importlib import import_module

import numpy as np
import pytest
from action_msgs.msg import GoalStatus

from omniman_ros.nodes.motion_log import MotionEvent
from omniman_ros.planning.cycle import PlannerState
from test import ros_interfaces
from test.nodes.navigation_client import NavigationClient
from test.nodes.test_mpc_planner import FAR, PlannerWithFakeController, goal
from test.tiers import exhaustive

SUCCEEDED, ABORTED, CANCELED = (
    GoalStatus.STATUS_SUCCEEDED,
    GoalStatus.STATUS_ABORTED,
    GoalStatus.STATUS_CANCELED,
)
UNKNOWN = 9000
NEAR = (0.5, 0.2, 0.3)


@pytest.fixture(scope="module")
def action_type():
    with ros_interfaces.installed("nav2_msgs"):
        yield import_module("nav2_msgs.action").NavigateToPose


@pytest.fixture
def world(action_type):
    with PlannerWithFakeController(source="none") as made:
        made.client = NavigationClient(made, action_type, "navigate_to_pose")
        yield made
        made.client.close()


def test_a_goal_is_reached_and_its_feedback_counts_down(world):
    _, future = world.client.send(pose=goal(*NEAR))
    assert world.client.result(future) == (SUCCEEDED, 0, "")
    assert world.distance(*NEAR) < 0.01
    assert world.core.state is PlannerState.ARRIVED
    feedback = world.client.feedback
    ways = [message.distance_remaining for message in feedback]
    assert len(ways) > 10 and ways == pytest.approx(sorted(ways, reverse=True), abs=5e-3)
    assert ways[0] == pytest.approx(np.hypot(*NEAR[:2]), abs=0.05)
    spent = [message.navigation_time for message in feedback]
    assert all(time.sec * 10 + round(time.nanosec / 1e8) == i for i, time in enumerate(spent, 1))
    pose = feedback[-1].current_pose
    assert pose.header.frame_id == "odom"
    assert (pose.pose.position.x, pose.pose.position.y) == pytest.approx(NEAR[:2], abs=0.05)


@pytest.mark.parametrize("by_topic", [False, exhaustive(True)])
def test_a_new_goal_replaces_the_old_one(world, by_topic):
    _, first = world.client.send(pose=goal(*FAR))
    world.begin()
    if by_topic:
        world.send(*NEAR)
    else:
        _, second = world.client.send(pose=goal(*NEAR))
    assert world.client.result(first, 1.0) == (ABORTED, UNKNOWN, "replaced by a new goal")
    if by_topic:
        world.arrive()
    else:
        assert world.client.result(second) == (SUCCEEDED, 0, "")
    assert world.distance(*NEAR) < 0.01


def test_a_cancelled_goal_ends_at_rest(world):
    handle, future = world.client.send(pose=goal(*FAR))
    world.begin()
    world.run(1.0)
    assert world.true_speed() > 0.2
    assert world.client.cancel(handle)
    assert not future.done(), "the robot brakes"
    assert world.client.result(future, 2.0) == (CANCELED, 0, "cancelled")
    assert world.true_speed() < 0.01
    assert world.node.finished
    assert not world.client.cancel(handle), "it has ended"


def test_a_goal_that_waits_can_be_cancelled(world):
    world.odometry = None
    world.run(1.0)
    handle, future = world.client.send(pose=goal(*FAR))
    assert world.node.loop.goals.event is MotionEvent.WAITING
    assert world.client.cancel(handle)
    assert world.client.result(future, 1.0) == (CANCELED, 0, "cancelled")


@pytest.mark.parametrize(
    ("fields", "word"),
    [
        ({"pose": goal(*NEAR, frame="lidar")}, "lidar"),
        exhaustive({"pose": goal(np.nan, 0.0)}, "position"),
        exhaustive({"pose": goal(*NEAR), "behavior_tree": "follow.xml"}, "behavior_tree"),
    ],
)
def test_a_goal_that_cannot_be_used_is_aborted_and_the_last_one_goes_on(world, fields, word):
    _, first = world.client.send(pose=goal(*NEAR))
    world.begin()
    _, second = world.client.send(**fields)
    status, code, text = world.client.result(second, 1.0)
    assert (status, code) == (ABORTED, UNKNOWN)
    assert word in text
    assert world.client.result(first) == (SUCCEEDED, 0, "")


def test_a_goal_that_is_given_up_or_cancelled_elsewhere_is_aborted(world):
    _, future = world.client.send(pose=goal(*FAR))
    world.begin()
    assert world.call_service("cancel").success
    assert world.client.result(future, 2.0) == (ABORTED, UNKNOWN, "cancelled")
    _, future = world.client.send(pose=goal(*FAR))
    world.begin()
    world.odometry = None
    status, code, text = world.client.result(future, 3.0)
    assert (status, code) == (ABORTED, UNKNOWN)
    assert "odom" in text


def test_a_node_that_ends_brings_the_robot_to_rest_and_the_goal_to_an_end(world):
    _, future = world.client.send(pose=goal(*FAR))
    world.begin()
    world.node.begin_shutdown("the test ends")
    assert not world.node.finished
    assert world.client.result(future, 3.0) == (ABORTED, UNKNOWN, "cancelled")
    assert world.true_speed() < 0.01
    assert world.node.finished
