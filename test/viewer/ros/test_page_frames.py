"""Tests of what others send in other frames than odom."""

import math

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path
from visualization_msgs.msg import Marker, MarkerArray

from omniman_ros.viewer.events import GoalDragged
from test.nodes.transforms import Transforms, tf_installed
from test.viewer.ros.fake_page import post, until, view

QUARTER = math.pi / 2
ODOM_IN_MAP = (1.0, 0.0, QUARTER)


@pytest.fixture
def world():
    """Return a world with transforms; `transforms` sends them."""
    with tf_installed(), view() as made:
        made.transforms = Transforms(made)
        made.transforms.send("map", "odom", *ODOM_IN_MAP)
        made.run(0.1)
        yield made


def state(world):
    return world.nodes[-1].state


def goal(x, y, frame="map"):
    message = PoseStamped()
    message.header.frame_id = frame
    message.pose.position.x, message.pose.position.y = x, y
    message.pose.orientation.w = 1.0
    return message


def marker(x, y, frame="map"):
    made = Marker(type=Marker.CYLINDER)
    made.header.frame_id = frame
    made.pose.position.x, made.pose.position.y = x, y
    made.pose.orientation.w = 1.0
    made.scale.x = made.scale.y = 0.6
    return MarkerArray(markers=[made])


def path(*points, frame="map", stamp=None):
    message = Path()
    message.header.frame_id = frame
    if stamp is not None:
        message.header.stamp = stamp
    message.poses = [goal(x, y, frame) for x, y in points]
    return message


def test_a_goal_in_map_is_shown_in_odom_and_follows_a_correction_of_the_localisation(world):
    world.publisher(PoseStamped, "goal_pose").publish(goal(1.0, 2.0))
    until(world, lambda: state(world).goal is not None, "the goal")
    assert state(world).goal == pytest.approx((2.0, 0.0, -QUARTER))
    world.transforms.send("map", "odom", 1.5, 0.0, QUARTER)
    until(world, lambda: state(world).goal[1] > 0.4, "the correction")
    assert state(world).goal == pytest.approx((2.0, 0.5, -QUARTER))


def test_a_goal_of_the_page_does_not_follow_the_frame_of_an_earlier_one(world):
    world.publisher(PoseStamped, "goal_pose").publish(goal(1.0, 2.0))
    until(world, lambda: state(world).goal is not None, "the goal")
    post(world, GoalDragged((0.3, 0.4, 0.5), True))
    world.transforms.send("map", "odom", 3.0, 0.0, QUARTER)
    world.run(0.3)
    assert state(world).goal == (0.3, 0.4, 0.5)


def test_obstacles_in_map_are_shown_in_odom_and_follow_their_frame(world):
    obstacles = world.publisher(MarkerArray, "obstacles")
    obstacles.publish(marker(1.0, 2.0))
    until(world, lambda: len(state(world).other_obstacles) == 1, "the obstacle")
    assert state(world).other_obstacles.centers[0] == pytest.approx((2.0, 0.0))
    world.transforms.send("map", "odom", 1.5, 0.0, QUARTER)
    until(world, lambda: state(world).other_obstacles.centers[0][1] > 0.4, "the correction")
    assert state(world).other_obstacles.centers[0] == pytest.approx((2.0, 0.5))


@pytest.mark.parametrize("topic", ["path", "tool_path"])
def test_a_path_in_map_is_shown_in_odom(world, topic):
    world.publisher(Path, topic).publish(path((1.0, 1.0), (1.0, 2.0)))
    line = getattr(state(world), topic)
    until(world, lambda: line.version > 0, "the path")
    assert line.points[:, :2] == pytest.approx(np.array([[1.0, 0.0], [2.0, 0.0]]))


def test_a_path_in_a_frame_that_moves_is_placed_at_its_stamp(world):
    world.transforms.send("odom", "base_link", 5.0, 0.0, age=0.2)
    world.transforms.send("odom", "base_link", 7.0, 0.0)
    stamp = world.stamp(-0.1)
    world.run(0.1)
    world.publisher(Path, "path").publish(path((1.0, 0.0), frame="base_link", stamp=stamp))
    line = state(world).path
    until(world, lambda: line.version > 0, "the path")
    assert line.points[0] == pytest.approx((6.0 + 1.0, 0.0))


@pytest.mark.parametrize(
    ("kind", "topic", "message"),
    [
        (PoseStamped, "goal_pose", goal(1.0, 2.0, "mars")),
        (MarkerArray, "obstacles", marker(1.0, 2.0, "mars")),
        (Path, "path", path((1.0, 2.0), frame="mars")),
    ],
    ids=["goal", "obstacle", "path"],
)
def test_what_no_transform_places_is_not_shown_and_the_page_says_so(world, kind, topic, message):
    publisher = world.publisher(kind, topic)
    publisher.publish(message)
    until(world, lambda: topic in state(world).unplaced, "the reason")
    assert "'mars'" in state(world).unplaced[topic]
    assert state(world).goal is None
    assert len(state(world).other_obstacles) == 0
    assert state(world).path.version == 0
    headers = message.markers if kind is MarkerArray else [message]
    for stamped in headers:
        stamped.header.frame_id = "odom"
    publisher.publish(message)
    until(world, lambda: topic not in state(world).unplaced, "its end")
