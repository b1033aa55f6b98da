"""The obstacles of the page, on the topic that planners subscribe to."""

import math
from functools import partial

import numpy as np
import pytest
from nav_msgs.msg import Odometry
from rclpy.node import Node
from visualization_msgs.msg import Marker, MarkerArray

from omniman_ros.conversions.geometry import quaternion_from_yaw, yaw_from_quaternion
from omniman_ros.conversions.headers import time_seconds, within
from omniman_ros.core.parameters import build
from omniman_ros.core.source_monitor import SourceMonitor, SourceTerms
from omniman_ros.nodes import obstacle_interface
from omniman_ros.planning.cases import TwoVelocityPath
from omniman_ros.surroundings.obstacles import ObstacleParameters, ObstacleSet
from omniman_ros.viewer.events import (
    ButtonPressed,
    ObstacleDeleted,
    ObstacleDragged,
    ObstacleMotionSet,
    ObstaclePathSet,
    ObstacleResized,
    ObstacleSelected,
    ObstacleVelocitySet,
    WaypointAdded,
)
from omniman_ros.viewer.node import ViewerNode
from omniman_ros.viewer.obstacle_paths import PathKind
from test.nodes.harness import World
from test.viewer.ros.fake_page import FakePage, post, press, until, view

NAN = math.nan


class Town:
    """The viewer and a receiver of its obstacles, as a planner has.

    Attributes:
        messages: All messages on `obstacles` with their times of arrival.
        known: The obstacles as a planner interprets them.
    """

    def __init__(self, world):
        self.world = world
        self.node = world.nodes[-1]
        self.state = self.node.state
        self.messages = []
        self.known = ObstacleSet(build(ObstacleParameters, {}))
        self.source = SourceMonitor("obstacles", SourceTerms(timeout=1.0))
        world.probe.create_subscription(MarkerArray, "obstacles", self._on_obstacles, 50)

    def _on_obstacles(self, message):
        self.messages.append((self.world.time, message))
        obstacle_interface.update_obstacles(self.node, message, self.known, within("odom"))
        self.source.use(self.world.time)

    @property
    def around(self):
        return self.known.ellipses(self.world.time)

    def add(self, *places):
        """Add obstacles at positions and return their numbers."""
        numbers = []
        for place in places:
            press(self.world, "add", 0.1)
            numbers.append(int(self.state.obstacles.numbers[-1]))
            post(self.world, ObstacleDragged(numbers[-1], place, True))
        count = len(self.state.obstacles.numbers)
        until(self.world, lambda: len(self.known) >= count, "the obstacles")
        self.world.run(0.6)  # the planner estimates that they are at rest
        return numbers


@pytest.fixture
def town():
    with view() as world:
        world.run(0.1)
        yield Town(world)


def test_without_an_obstacle_nothing_is_published(town):
    town.world.run(1.0)
    assert town.messages == []
    assert town.world.probe.count_publishers("obstacles") == 0


def test_obstacles_are_cylinders_in_odom_ten_times_a_second(town):
    (number,) = town.add((2.0, 1.0))
    post(town.world, ObstacleResized(number, (0.4, 0.2), 0.5))
    town.messages.clear()
    town.world.run(1.0)
    assert len(town.messages) == pytest.approx(10, abs=1)
    time, message = town.messages[-1]
    (marker,) = message.markers
    assert (marker.ns, marker.id, marker.type) == ("viewer", number, Marker.CYLINDER)
    assert marker.header.frame_id == "odom"
    assert time_seconds(marker.header.stamp) == pytest.approx(time, abs=0.01)
    assert (marker.scale.x, marker.scale.y) == pytest.approx((0.8, 0.4))
    assert yaw_from_quaternion(marker.pose.orientation) == pytest.approx(0.5)
    assert time_seconds(marker.lifetime) == pytest.approx(1.0)


def test_a_planner_learns_the_velocity_of_an_obstacle(town):
    (number,) = town.add((2.0, 1.0))
    post(town.world, ObstacleVelocitySet(number, (0.0, -0.4)), seconds=1.0)
    assert town.around.velocities[0] == pytest.approx([0.0, -0.4], abs=0.03)
    centre = town.state.obstacles.centers[0]
    assert town.around.centers[0] == pytest.approx(centre, abs=0.03)


def test_a_click_that_selects_another_obstacle_adds_no_way_point(town):
    first, second = town.add((2.0, 0.0), (3.0, 0.0))
    post(town.world, ObstacleMotionSet(first, PathKind.WAYPOINTS))
    post(town.world, ObstacleSelected(second), WaypointAdded(first, (3.0, 0.0)))
    assert town.state.obstacles.placed[0].home.points == ((2.0, 0.0),)
    assert "another obstacle" in town.state.note


def test_a_deleted_obstacle_is_gone_at_once_and_the_others_stay(town):
    first, second = town.add((2.0, 1.0), (3.0, 1.0))
    post(town.world, ObstacleDeleted(first), seconds=0.06)
    assert len(town.known) == 1
    assert town.around.centers[0] == pytest.approx([3.0, 1.0])
    assert town.state.obstacles.numbers.tolist() == [second]


def test_empty_messages_continue_after_the_last_obstacle(town):
    """A planner that has received obstacles stops when their source falls silent."""
    town.add((2.0, 1.0), (3.0, 1.0))
    post(town.world, ObstacleDeleted(None), seconds=3.0)
    assert len(town.known) == 0
    assert town.source.blind_reason(town.world.time) == ""


def test_the_silence_of_another_source_is_not_masked(town):
    other = Node("camera", context=town.world.context)
    other.create_publisher(MarkerArray, "obstacles", 10)
    town.add((2.0, 1.0))
    until(town.world, lambda: town.world.probe.count_publishers("obstacles") == 2, "both")
    town.world.run(1.1)
    post(town.world, ObstacleDeleted(None), seconds=3.0)
    assert len(town.known) == 0
    assert town.source.blind_reason(town.world.time)
    other.destroy_node()


def test_the_end_of_the_node_deletes_its_obstacles(town):
    town.add((2.0, 1.0))
    town.node.begin_shutdown("SIGINT")
    town.world.run(0.5)
    assert len(town.known) == 0
    (_, last), message_count = town.messages[-1], len(town.messages)
    assert [(m.action, m.ns) for m in last.markers] == [(Marker.DELETEALL, "viewer")]
    town.world.run(1.0)
    assert len(town.messages) == message_count
    assert [p.topic_name for p in town.node.final_publishers] == ["/obstacles"]


def test_obstacles_restart_when_simulated_time_goes_back(town):
    (number,) = town.add((2.0, 1.0))
    post(town.world, ObstacleVelocitySet(number, (0.5, 0.0)), seconds=1.0)
    town.world.time -= 500.0
    town.messages.clear()
    town.world.run(1.0)
    assert len(town.messages) >= 8
    assert town.state.obstacles.centers[0] == pytest.approx([2.5, 1.0], abs=0.1)


def test_a_second_viewer_displays_the_obstacles_of_the_first_apart_from_its_own():
    makers = [partial(ViewerNode, make_page=FakePage) for _ in range(2)]
    with World(*makers) as world:
        world.run(0.1)
        first, second = (node.state for node in world.nodes)
        town = Town(world)
        world.nodes[0].page.post(ButtonPressed("add"))
        until(world, lambda: len(second.other_obstacles) == 1, "the first's at the second")
        town.add((5.0, 0.0))
        until(world, lambda: len(first.other_obstacles) == 1, "the second's at the first")
        assert len(town.known) == 2
        assert [len(p.other_obstacles) for p in (first, second)] == [1, 1]
        assert [len(p.obstacles.numbers) for p in (first, second)] == [1, 1]


def test_a_new_obstacle_is_placed_ahead_of_the_robot_and_clear_of_the_others(town):
    odom = Odometry()
    odom.header.frame_id = "odom"
    odom.pose.pose.position.x = 3.0
    odom.pose.pose.orientation = quaternion_from_yaw(math.pi / 2)
    town.world.publisher(Odometry, "odom").publish(odom)
    town.world.run(0.1)
    for _ in range(5):
        press(town.world, "add", 0.1)
    centers = town.state.obstacles.centers
    assert centers[0] == pytest.approx([3.0, 1.2])
    gaps = np.hypot(*(centers[:, None] - centers[None]).T) + 9.0 * np.eye(5)
    assert gaps.min() > 0.5, "two radii"
    assert town.state.selected_obstacle == town.state.obstacles.numbers[-1]


def test_an_obstacle_is_selected_until_it_is_deleted(town):
    first, second = town.add((2.0, 1.0), (3.0, 1.0))
    post(town.world, ObstacleSelected(first))
    assert town.state.selected_obstacle == first
    post(town.world, ObstacleDeleted(second))
    assert town.state.selected_obstacle == first
    post(town.world, ObstacleDeleted(first))
    assert town.state.selected_obstacle is None


@pytest.mark.parametrize(
    "bad",
    [
        ObstacleDragged(0, (NAN, 0.0), True),
        ObstacleDragged(0, (0.0, 1e7), True),
        ObstacleDragged(7, (0.0, 0.0), True),
        ObstacleVelocitySet(0, (math.inf, 0.0)),
        ObstacleVelocitySet(0, (0.0, 100.0)),
        ObstacleVelocitySet(7, (0.0, 0.0)),
        ObstaclePathSet(0, TwoVelocityPath((0.0, 0.0), (0.0, 0.0), -1.0)),
        ObstaclePathSet(7, TwoVelocityPath((0.0, 0.0))),
        ObstacleMotionSet(7, PathKind.STRAIGHT),
        WaypointAdded(0, (3.0, 0.0)),
        WaypointAdded(7, (3.0, 0.0)),
        ObstacleResized(0, (0.0, 0.3), 0.0),
        ObstacleResized(0, (0.3, NAN), 0.0),
        ObstacleResized(0, (0.3, 0.3), NAN),
        ObstacleResized(7, (0.3, 0.3), 0.0),
        ObstacleSelected(7),
        ObstacleDeleted(7),
    ],
    ids=str,
)
def test_an_invalid_event_is_refused_and_changes_nothing(town, bad):
    town.add((2.0, 1.0))
    town.state.note = ""
    before = town.state.obstacles
    post(town.world, bad, seconds=0.3)
    after = town.state.obstacles
    assert town.state.note
    assert after.centers.tolist() == before.centers.tolist()
    assert after.semi_axes.tolist() == before.semi_axes.tolist()
    assert not after.velocities.any()
    assert town.around.centers[0] == pytest.approx([2.0, 1.0])


def test_more_than_a_hundred_obstacles_are_refused(town):
    for _ in range(101):
        town.node.page.post(ButtonPressed("add"))
    town.world.run(0.1)
    assert len(town.state.obstacles.numbers) == 100
    assert "100 obstacles" in town.state.note
