"""The obstacles that the page places, on the topic where planners hear them."""

import math
from functools import partial

import numpy as np
import pytest
from nav_msgs.msg import Odometry
from rclpy.node import Node
from visualization_msgs.msg import Marker, MarkerArray

from omniman_ros import conversions
from omniman_ros.core.parameters import build
from omniman_ros.nodes import obstacle_port
from omniman_ros.nodes.viewer import ViewerNode
from omniman_ros.planning.obstacles import ObstacleParameters, ObstacleSet
from omniman_ros.viewer.events import (
    ObstacleChosen,
    ObstacleDeleted,
    ObstacleDragged,
    ObstacleSent,
    ObstacleShaped,
    Pressed,
)

from .fake_page import FakePage, post, press, until, view
from .harness import World

NAN = math.nan


class Town:
    """The viewer, and what a planner hears of its obstacles.

    Attributes:
        messages: All of `obstacles`, and when they came.
        known: What a planner makes of them.
    """

    def __init__(self, world):
        self.world = world
        self.node = world.nodes[-1]
        self.picture = self.node.picture
        self.messages = []
        self.known = ObstacleSet(build(ObstacleParameters, {}))
        world.probe.create_subscription(MarkerArray, "obstacles", self._hear, 50)

    def _hear(self, message):
        self.messages.append((self.world.time, message))
        obstacle_port.hear(self.node, message, self.known, ("odom",))

    @property
    def around(self):
        return self.known.ellipses(self.world.time)

    def add(self, *places):
        """Add obstacles, at places; returns their numbers."""
        numbers = []
        for place in places:
            press(self.world, "add", 0.1)
            numbers.append(int(self.picture.crowd.numbers[-1]))
            post(self.world, ObstacleDragged(numbers[-1], place, True))
        count = len(self.picture.crowd.numbers)
        until(self.world, lambda: len(self.known) >= count, "the obstacles")
        self.world.run(0.6)  # the planner sees that they stand
        return numbers


@pytest.fixture
def town():
    with view() as world:
        world.run(0.1)
        yield Town(world)


def test_without_an_obstacle_nothing_is_said(town):
    town.world.run(1.0)
    assert town.messages == []
    assert town.world.probe.count_publishers("obstacles") == 0


def test_obstacles_are_cylinders_in_odom_ten_times_a_second(town):
    (number,) = town.add((2.0, 1.0))
    post(town.world, ObstacleShaped(number, (0.4, 0.2), 0.5))
    town.messages.clear()
    town.world.run(1.0)
    assert len(town.messages) == pytest.approx(10, abs=1)
    time, message = town.messages[-1]
    (marker,) = message.markers
    assert (marker.ns, marker.id, marker.type) == ("viewer", number, Marker.CYLINDER)
    assert marker.header.frame_id == "odom"
    assert conversions.time_seconds(marker.header.stamp) == pytest.approx(time, abs=0.01)
    assert (marker.scale.x, marker.scale.y) == pytest.approx((0.8, 0.4))
    assert conversions.yaw(marker.pose.orientation) == pytest.approx(0.5)
    assert conversions.time_seconds(marker.lifetime) == pytest.approx(1.0)


def test_a_planner_learns_where_one_goes(town):
    (number,) = town.add((2.0, 1.0))
    post(town.world, ObstacleSent(number, (0.0, -0.4)), seconds=1.0)
    assert town.around.velocities[0] == pytest.approx([0.0, -0.4], abs=0.03)
    centre = town.picture.crowd.centers[0]
    assert town.around.centers[0] == pytest.approx(centre, abs=0.03)


def test_one_that_is_deleted_is_gone_at_once_and_the_others_stay(town):
    first, second = town.add((2.0, 1.0), (3.0, 1.0))
    post(town.world, ObstacleDeleted(first), seconds=0.06)
    assert len(town.known) == 1
    assert town.around.centers[0] == pytest.approx([3.0, 1.0])
    assert town.picture.crowd.numbers.tolist() == [second]


def test_after_the_last_it_goes_on_saying_that_there_is_none(town):
    """A planner that has heard of obstacles stops when their source falls silent."""
    town.add((2.0, 1.0), (3.0, 1.0))
    post(town.world, ObstacleDeleted(None), seconds=3.0)
    assert len(town.known) == 0
    assert town.known.silent(town.world.time) == ""


def test_the_silence_of_another_source_is_not_talked_over(town):
    other = Node("camera", context=town.world.context)
    other.create_publisher(MarkerArray, "obstacles", 10)
    town.add((2.0, 1.0))
    until(town.world, lambda: town.world.probe.count_publishers("obstacles") == 2, "both")
    town.world.run(1.1)
    post(town.world, ObstacleDeleted(None), seconds=3.0)
    assert len(town.known) == 0
    assert town.known.silent(town.world.time)
    other.destroy_node()


def test_the_end_of_the_node_takes_its_obstacles_away(town):
    town.add((2.0, 1.0))
    town.node.begin_shutdown("SIGINT")
    town.world.run(0.5)
    assert len(town.known) == 0
    (_, last), said = town.messages[-1], len(town.messages)
    assert [(m.action, m.ns) for m in last.markers] == [(Marker.DELETEALL, "viewer")]
    town.world.run(1.0)
    assert len(town.messages) == said
    assert [p.topic_name for p in town.node.last_words] == ["/obstacles"]


def test_a_node_that_dies_leaves_nothing_behind(town):
    town.add((2.0, 1.0))
    town.node._crowd.publish = lambda now: None
    town.world.run(1.2)
    assert len(town.around) == 0


def test_obstacles_begin_anew_when_simulated_time_goes_back(town):
    (number,) = town.add((2.0, 1.0))
    post(town.world, ObstacleSent(number, (0.5, 0.0)), seconds=1.0)
    town.world.time -= 500.0
    town.messages.clear()
    town.world.run(1.0)
    assert len(town.messages) >= 8
    assert town.picture.crowd.centers[0] == pytest.approx([2.5, 1.0], abs=0.1)


def test_its_own_obstacles_are_not_shown_as_seen(town):
    town.add((2.0, 1.0))
    town.world.run(0.5)
    assert len(town.picture.crowd.numbers) == 1
    assert len(town.picture.seen) == 0


def test_a_second_viewer_shows_those_of_the_first_and_keeps_its_own_apart():
    makers = [partial(ViewerNode, make_page=FakePage) for _ in range(2)]
    with World(*makers) as world:
        world.run(0.1)
        first, second = (node.picture for node in world.nodes)
        town = Town(world)
        world.nodes[0].page.post(Pressed("add"))
        until(world, lambda: len(second.seen) == 1, "the first's at the second")
        town.add((5.0, 0.0))
        until(world, lambda: len(first.seen) == 1, "the second's at the first")
        assert len(town.known) == 2
        assert [len(p.seen) for p in (first, second)] == [1, 1]
        assert [len(p.crowd.numbers) for p in (first, second)] == [1, 1]


def test_a_new_one_stands_before_the_robot_and_beside_the_others(town):
    odom = Odometry()
    odom.header.frame_id = "odom"
    odom.pose.pose.position.x = 3.0
    odom.pose.pose.orientation = conversions.quaternion(math.pi / 2)
    town.world.publisher(Odometry, "odom").publish(odom)
    town.world.run(0.1)
    for _ in range(5):
        press(town.world, "add", 0.1)
    centers = town.picture.crowd.centers
    assert centers[0] == pytest.approx([3.0, 1.2])
    gaps = np.hypot(*(centers[:, None] - centers[None]).T) + 9.0 * np.eye(5)
    assert gaps.min() > 0.5, "two radii"
    assert town.picture.chosen == town.picture.crowd.numbers[-1]


def test_one_is_chosen_until_it_is_deleted(town):
    first, second = town.add((2.0, 1.0), (3.0, 1.0))
    post(town.world, ObstacleChosen(first))
    assert town.picture.chosen == first
    post(town.world, ObstacleDeleted(second))
    assert town.picture.chosen == first
    post(town.world, ObstacleDeleted(first))
    assert town.picture.chosen is None


@pytest.mark.parametrize(
    "bad",
    [
        ObstacleDragged(0, (NAN, 0.0), True), ObstacleDragged(0, (0.0, 1e7), True),
        ObstacleDragged(7, (0.0, 0.0), True), ObstacleSent(0, (math.inf, 0.0)),
        ObstacleSent(0, (0.0, 100.0)), ObstacleSent(7, (0.0, 0.0)),
        ObstacleShaped(0, (0.0, 0.3), 0.0), ObstacleShaped(0, (0.3, NAN), 0.0),
        ObstacleShaped(0, (0.3, 0.3), NAN), ObstacleShaped(7, (0.3, 0.3), 0.0),
        ObstacleChosen(7), ObstacleDeleted(7),
    ],
    ids=str,
)  # fmt: skip
def test_nonsense_is_refused_and_changes_nothing(town, bad):
    town.add((2.0, 1.0))
    town.picture.note = ""
    before = town.picture.crowd
    post(town.world, bad, seconds=0.3)
    after = town.picture.crowd
    assert town.picture.note
    assert after.centers.tolist() == before.centers.tolist()
    assert after.semi_axes.tolist() == before.semi_axes.tolist()
    assert not after.velocities.any()
    assert town.around.centers[0] == pytest.approx([2.0, 1.0])


def test_more_than_a_hundred_are_refused(town):
    for _ in range(101):
        town.node.page.post(Pressed("add"))
    town.world.run(0.1)
    assert len(town.picture.crowd.numbers) == 100
    assert "100 obstacles" in town.picture.note
