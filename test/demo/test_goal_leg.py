"""The goal among moving obstacles, and how it is measured."""

import math

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from nav_msgs.msg import OccupancyGrid
from sensor_msgs.msg import LaserScan
from visualization_msgs.msg import Marker, MarkerArray

from omniman_ros.conversions.maps import map_message
from omniman_ros.demo.goal_leg import DrivenGoal, GoalLeg, goal_figures
from omniman_ros.demo.interval import Interval
from omniman_ros.demo.moving_obstacles import DEMO_OBSTACLES, MovingObstacles
from omniman_ros.demo.perception_recorder import People, PerceptionRecorder
from test.demo.stepped_robot import SteppedRobot, stepped_driver

HALF = (0.5, 0.35)
START = 100.0


@pytest.fixture
def obstacles():
    return MovingObstacles.in_front_of((1.0, 2.0, math.pi / 2), START)


def test_obstacles_are_placed_and_move_relative_to_the_robot(obstacles):
    x, y, vx, vy, _ = DEMO_OBSTACLES[0]
    assert obstacles.at(START)[0] == pytest.approx([1.0 - y, 2.0 + x])
    moved = obstacles.at(102.0)[0] - obstacles.at(START)[0]
    assert moved == pytest.approx([-2.0 * vy, 2.0 * vx])


def test_the_message_has_the_positions_at_its_time(obstacles):
    message = obstacles.message(103.0, Time(sec=103))
    assert [(m.pose.position.x, m.pose.position.y) for m in message.markers] == [
        pytest.approx(tuple(position)) for position in obstacles.at(103.0)
    ]
    for marker, row in zip(message.markers, DEMO_OBSTACLES, strict=True):
        assert (marker.type, marker.action) == (Marker.CYLINDER, Marker.ADD)
        assert marker.scale.x == marker.scale.y == 2.0 * row[4]
        assert marker.header.frame_id == "odom"
    assert [m.action for m in obstacles.removal_message().markers] == [Marker.DELETEALL]


def figures_of(obstacles, poses, goal=(0.0, 0.0, 0.0)):
    """Figures of a robot that is at one of the poses every second."""
    rows = np.array([[START + i, *pose, 0.0, 0.0, 0.0] for i, pose in enumerate(poses)])
    interval = Interval("goal", START, START + len(rows) - 1)
    return goal_figures(rows, rows[:, :4], DrivenGoal(goal, obstacles, interval), HALF)


def test_the_clearance_is_that_of_robot_and_obstacle_at_the_same_time():
    # The obstacle is beside x = 2 at 102 s, 2 m further left.
    obstacles = MovingObstacles(
        START, np.array([[2.0, 0.0]]), np.array([[0.0, 1.0]]), np.array([0.3])
    )
    at_rest = figures_of(obstacles, [(0, 0, 0)] * 3)
    assert at_rest["clearance_m"] == pytest.approx(2.0 - 0.5 - 0.3)
    behind = figures_of(obstacles, [(0, 0, 0), (0, 0, 0), (2.0, 0.0, 0)])
    assert behind["clearance_m"] == pytest.approx(1.2), "it has gone when the robot is there"
    collision = figures_of(obstacles, [(0, 0, 0), (2.0, 1.0, 0), (2.0, 0.0, 0)])
    assert collision["clearance_m"] < 0.0


def test_the_error_at_the_goal_is_that_of_the_last_pose():
    obstacles = MovingObstacles.in_front_of((50.0, 0.0, 0.0), START)
    poses = [(0, 0, 0), (1.0, 0.0, math.pi)]
    result = figures_of(obstacles, poses, (1.0, 0.02, -math.pi + 0.01))
    assert result["position_mm"] == pytest.approx(20.0)
    assert result["heading_deg"] == pytest.approx(math.degrees(0.01))
    assert result["time_s"] == 1.0


def test_a_goal_without_odometry_is_infinitely_far_away():
    obstacles = MovingObstacles.in_front_of((0.0, 0.0, 0.0), START)
    driven = DrivenGoal((0.0, 0.0, 0.0), obstacles, Interval("goal", START, START + 1.0))
    result = goal_figures(np.zeros((3, 7)), np.zeros((3, 4)), driven, HALF)
    assert result["position_mm"] == math.inf and result["clearance_m"] == -math.inf


# ---- by the scanner ---------------------------------------------------------------------------


def test_a_person_is_where_the_reports_before_and_after_say():
    rows = [np.array([[0.0, y, 0.25], [5.0, 0.0, 0.3]]) for y in (0.0, 1.0, 1.0)]
    people = People(list(zip((10.0, 12.0, 13.0), rows, strict=True)))
    assert people.at(11.0) == pytest.approx(np.array([[0.0, 0.5], [5.0, 0.0]]))
    assert people.at(12.5)[0] == pytest.approx([0.0, 1.0])
    assert people.at(0.0)[0] == pytest.approx([0.0, 0.0]), "nobody knows what was before"
    assert people.at(20.0)[0] == pytest.approx([0.0, 1.0])
    gaps = people.gaps(np.array([[10.0, 2.0, 0.0, 0.0]]), HALF)
    assert gaps[0] == pytest.approx([2.0 - 0.5 - 0.25, 3.0 - 0.5 - 0.3])


def test_the_clearance_of_persons_counts_from_the_true_pose():
    people = People([(START, np.array([[2.0, 0.0, 0.25]]))])
    driven = DrivenGoal((0.0, 0.0, 0.0), people, Interval("goal", START, START))
    odom, truth = np.zeros((1, 7)), np.array([[START, 0.1, 0.0, 0.0]])
    odom[0, 0] = START
    assert goal_figures(odom, truth, driven, HALF)["clearance_m"] == pytest.approx(1.15)
    alone = DrivenGoal((0.0, 0.0, 0.0), People([(START, np.zeros((0, 3)))]), driven.interval)
    assert "clearance_m" not in goal_figures(odom, truth, alone, HALF)


def test_what_is_perceived_is_recorded_until_the_goal():
    robot = SteppedRobot()
    recorder = PerceptionRecorder(robot)
    hear = robot._callbacks
    hear["scan"](
        LaserScan(angle_min=-0.5, angle_increment=0.5, range_max=9.0, ranges=[math.inf, 2.0])
    )
    cells = np.array([[0, 100]], dtype=np.int8)
    stamp = OccupancyGrid().header.stamp
    hear["map"](map_message(cells, 0.1, np.array([1.0, 2.0]), "odom", stamp))
    person, crate = Marker(type=Marker.CYLINDER), Marker(type=Marker.CUBE)
    person.pose.position.x, person.scale.x = 3.0, 0.5
    hear["ground_truth/obstacles"](MarkerArray(markers=[person, crate]))
    seen = recorder.perception
    assert seen.scans[0][1] == pytest.approx(np.array([[0.55 + 2.0, 0.0]]))
    assert seen.map.values.tolist() == [[0, 100]]
    assert seen.people[0][1].tolist() == [[3.0, 0.0, 0.25]]
    recorder.close()
    assert set(robot.ended) == {"scan", "map", "obstacle_tracks", "ground_truth/obstacles"}


def test_by_the_scanner_the_robot_is_told_of_nobody(monkeypatch):
    robot = SteppedRobot()
    driver = stepped_driver(monkeypatch, robot)
    robot.spin(0.1)
    leg = GoalLeg(HALF, by_scanner=True)
    leg.drive(driver)
    assert "obstacles" not in robot.received and "goal_pose" in robot.received
    assert leg.driven.perception is not None
    assert leg.measure(driver.recorder.recording)["goal"]["position_mm"] < 40.0
