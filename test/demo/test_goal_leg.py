"""The goal among moving obstacles, and how it is measured."""

import math

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from visualization_msgs.msg import Marker

from omniman_ros.demo.goal_leg import DrivenGoal, goal_figures
from omniman_ros.demo.leg import Interval
from omniman_ros.demo.moving_obstacles import DEMO_OBSTACLES, MovingObstacles

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
    return goal_figures(rows, DrivenGoal(goal, obstacles, interval), HALF)


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
    result = goal_figures(np.zeros((3, 7)), driven, HALF)
    assert result["position_mm"] == math.inf and result["clearance_m"] == -math.inf
