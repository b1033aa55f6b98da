"""Tests of the actions `move_tool` and `follow_tool_path` of the whole-body planner."""

from importlib import import_module

import numpy as np
import pytest
from action_msgs.msg import GoalStatus

from test import ros_interfaces
from test.nodes.navigation_client import NavigationClient
from test.nodes.test_path_interpolator_tool import START, tool_path
from test.nodes.test_whole_body_planner import AHEAD, ON_PATH, SHORT, DodgeWorld, tool_goal

SUCCEEDED, ABORTED, CANCELED = (
    GoalStatus.STATUS_SUCCEEDED,
    GoalStatus.STATUS_ABORTED,
    GoalStatus.STATUS_CANCELED,
)
UNKNOWN, UNKNOWN_OF_PATHS, INVALID_PATH = 9000, 100, 103
NEAR = (0.3, 0.1, 0.05)  #: Offset of a goal from the tool [m]
FAR_END = 60.0  #: Time within which any motion ends [s]


@pytest.fixture(scope="module")
def action_types():
    with ros_interfaces.installed("nav2_msgs"):
        yield import_module("nav2_msgs.action")


@pytest.fixture
def client(action_types, request):
    """A client of the action that a test names; its world has a post where a test says so."""
    name, *posts = request.param
    kind = {"move_tool": "NavigateToPose", "follow_tool_path": "FollowPath"}[name]
    with DodgeWorld(*posts) as world:
        made = NavigationClient(world, getattr(action_types, kind), f"whole_body_planner/{name}")
        made.world = world
        yield made
        made.close()


def of(name, *posts):
    return pytest.mark.parametrize("client", [(name, *posts)], indirect=True, ids=[name])


@of("move_tool")
def test_a_goal_is_reached_and_its_feedback_counts_down(client):
    _, future = client.send(pose=tool_goal(NEAR))
    assert client.result(future, FAR_END) == (SUCCEEDED, 0, "")
    ways = [message.distance_remaining for message in client.feedback]
    assert len(ways) > 10 and ways == sorted(ways, reverse=True)
    assert ways[0] == pytest.approx(np.linalg.norm(NEAR), abs=0.05)
    last = client.feedback[-1].current_pose
    assert last.header.frame_id == "odom"
    place = last.pose.position
    assert [place.x, place.y, place.z] == pytest.approx(START[:3, 3] + NEAR, abs=5e-3)
    assert client.world.node.finished


@of("move_tool")
def test_a_new_goal_replaces_the_one_under_way(client):
    _, first = client.send(pose=tool_goal(AHEAD[1]))
    client.world.run_to_motion_start()
    client.world.run(1.0)
    _, second = client.send(pose=tool_goal(NEAR))
    assert client.result(first, 1.0) == (ABORTED, UNKNOWN, "replaced by a new goal")
    assert client.result(second, FAR_END) == (SUCCEEDED, 0, "")


@of("move_tool", ON_PATH)
def test_a_goal_that_something_stands_on_is_aborted_with_part_and_obstacle(client):
    _, future = client.send(pose=tool_goal((0.9, 0.0, 0.0)))
    status, code, text = client.result(future, FAR_END)
    assert (status, code) == (ABORTED, UNKNOWN)
    assert "no room beside obstacle post/0" in text
    assert not client.world.references


@of("move_tool")
def test_a_goal_that_cannot_be_used_leaves_the_motion_under_way(client):
    _, first = client.send(pose=tool_goal(NEAR))
    client.world.run_to_motion_start()
    _, second = client.send(pose=tool_goal(NEAR, frame="lidar"))
    status, code, text = client.result(second, 1.0)
    assert (status, code) == (ABORTED, UNKNOWN) and "lidar" in text
    _, third = client.send(pose=tool_goal(NEAR), behavior_tree="other.xml")
    assert "behavior_tree must be empty" in client.result(third, 1.0)[2]
    assert client.result(first, FAR_END) == (SUCCEEDED, 0, "")


@of("move_tool")
def test_a_goal_is_cancelled_while_it_is_planned(client):
    handle, future = client.send(pose=tool_goal(AHEAD[1]))
    assert client.cancel(handle)
    assert client.result(future, 1.0) == (CANCELED, 0, "cancelled")
    client.world.run(1.0)
    assert client.world.body.idle and not client.world.references


@of("move_tool")
def test_a_cancelled_goal_ends_at_rest_on_its_way(client):
    handle, future = client.send(pose=tool_goal(AHEAD[1]))
    client.world.run_to_motion_start()
    client.world.run(2.0)
    assert client.cancel(handle)
    assert not future.done(), "the robot brakes"
    assert client.result(future, 2.0) == (CANCELED, 0, "cancelled")
    assert client.world.tool_errors().max() < 1e-4


@of("follow_tool_path")
def test_a_path_is_followed_and_its_feedback_counts_down(client):
    _, future = client.send(path=tool_path(SHORT))
    assert client.result(future, FAR_END) == (SUCCEEDED, 0, "")
    ways = [message.distance_to_goal for message in client.feedback]
    assert len(ways) > 10 and ways == sorted(ways, reverse=True)
    assert ways[0] == pytest.approx(0.3, abs=0.02)
    speeds = [message.speed for message in client.feedback]
    assert 0.1 < max(speeds) < 0.25 and speeds[-1] < 0.01


@of("follow_tool_path", ON_PATH)
def test_a_path_without_a_way_is_aborted_with_place_part_and_obstacle(client):
    _, future = client.send(path=tool_path(AHEAD))
    status, code, text = client.result(future, FAR_END)
    assert (status, code) == (ABORTED, UNKNOWN_OF_PATHS)
    assert "with the tool at (" in text and "no room beside obstacle post/0" in text


@of("follow_tool_path")
def test_a_path_is_refused_while_another_motion_is_under_way(client):
    client.world.lead(SHORT)
    _, future = client.send(path=tool_path(SHORT))
    status, code, text = client.result(future, 1.0)
    assert (status, code) == (ABORTED, INVALID_PATH) and "~/cancel ends it" in text
    client.world.run_to_motion_end(FAR_END)
    assert client.world.body.log.text == "arrived"
