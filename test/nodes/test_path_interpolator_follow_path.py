"""Tests of the interpolator's action `follow_path`."""

from importlib import import_module

import numpy as np
import pytest
from action_msgs.msg import GoalStatus

from omniman_ros.motion.path.interpolator import PathState
from test import ros_interfaces
from test.nodes.navigation_client import NavigationClient
from test.nodes.test_path_interpolator import BENT, FakeControllerWorld, path
from test.tiers import exhaustive

SUCCEEDED, ABORTED, CANCELED = (
    GoalStatus.STATUS_SUCCEEDED,
    GoalStatus.STATUS_ABORTED,
    GoalStatus.STATUS_CANCELED,
)
INVALID_PATH, UNKNOWN = 103, 100


@pytest.fixture(scope="module")
def action_type():
    with ros_interfaces.installed("nav2_msgs"):
        yield import_module("nav2_msgs.action").FollowPath


@pytest.fixture
def world(action_type):
    with FakeControllerWorld() as made:
        made.client = NavigationClient(made, action_type, "path_interpolator/follow_path")
        yield made
        made.client.close()


def test_a_path_is_driven_and_its_feedback_counts_down(world):
    _, future = world.client.send(path=path(BENT))
    assert world.client.result(future) == (SUCCEEDED, 0, "")
    assert world.setpoint.pose == pytest.approx(BENT[-1], abs=1e-3)
    ways = [message.distance_to_goal for message in world.client.feedback]
    assert len(ways) > 10 and ways == sorted(ways, reverse=True)
    assert 0.7 < ways[0] < 0.8, "the corner is cut"
    assert max(message.speed for message in world.client.feedback) > 0.2


def test_a_new_path_replaces_the_old_one_without_a_stop(world):
    _, first = world.client.send(path=path(BENT))
    world.run(1.0)
    _, second = world.client.send(path=path([(0.4, 0.0, 0.0), (1.0, 0.0, 0.0)]))
    assert world.client.result(first, 1.0) == (ABORTED, UNKNOWN, "replaced by a new goal")
    assert world.client.result(second) == (SUCCEEDED, 0, "")
    assert world.setpoint.pose == pytest.approx((1.0, 0.0, 0.0), abs=1e-3)


def test_a_path_from_the_topic_replaces_that_of_the_action(world):
    _, future = world.client.send(path=path(BENT))
    world.run(1.0)
    world.send([(0.4, 0.0, 0.0), (1.0, 0.0, 0.0)])
    assert world.client.result(future, 1.0) == (ABORTED, UNKNOWN, "replaced by a new path")


def test_a_cancelled_path_ends_at_rest_on_the_path(world):
    handle, future = world.client.send(path=path([(0, 0, 0), (2.0, 0, 0)]))
    world.run(1.5)
    assert world.client.cancel(handle)
    assert not future.done(), "the platform brakes"
    assert world.client.result(future, 2.0) == (CANCELED, 0, "cancelled")
    assert world.core.state is PathState.IDLE
    assert 0.1 < world.setpoint.pose[0] < 1.5
    assert np.abs(world.setpoint.pose[1:]).max() < 1e-6


@pytest.mark.parametrize(
    ("message", "word"),
    [
        (path([(50.0, 0.0, 0.0), (51.0, 0.0, 0.0)]), "at most"),
        exhaustive(path(BENT, frame="lidar"), "lidar"),
        exhaustive(path([]), "empty"),
        exhaustive(path([(np.nan, 0.0, 0.0), (1.0, 0.0, 0.0)]), "position"),
    ],
)
def test_a_path_that_cannot_be_used_is_aborted_and_the_last_one_goes_on(world, message, word):
    _, first = world.client.send(path=path(BENT))
    world.run(0.5)
    _, second = world.client.send(path=message)
    status, code, text = world.client.result(second, 1.0)
    assert (status, code) == (ABORTED, INVALID_PATH)
    assert word in text
    assert world.client.result(first) == (SUCCEEDED, 0, "")


def test_a_path_that_is_given_up_is_aborted(world):
    _, future = world.client.send(path=path(BENT))
    world.run(1.0)
    world.odometry = None
    status, code, text = world.client.result(future, 5.0)
    assert (status, code) == (ABORTED, UNKNOWN)
    assert "odom" in text
