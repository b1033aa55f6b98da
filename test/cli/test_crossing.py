import math

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from visualization_msgs.msg import Marker

from omniman_ros.cli.crossing import SHOWN, Crossing
from omniman_ros.cli.score import DrivenGoal, faults, goal_figures

HALF = (0.5, 0.35)


@pytest.fixture
def crossing():
    return Crossing.before((1.0, 2.0, math.pi / 2), 100.0)


def test_obstacles_stand_and_move_as_the_robot_sees_them(crossing):
    x, y, vx, vy, _ = SHOWN[0]
    assert crossing.at(100.0)[0] == pytest.approx([1.0 - y, 2.0 + x])
    moved = crossing.at(102.0)[0] - crossing.at(100.0)[0]
    assert moved == pytest.approx([-2.0 * vy, 2.0 * vx])


def test_the_message_says_where_they_are_now(crossing):
    message = crossing.message(103.0, Time(sec=103))
    assert [(m.pose.position.x, m.pose.position.y) for m in message.markers] == [
        pytest.approx(tuple(place)) for place in crossing.at(103.0)
    ]
    for marker, row in zip(message.markers, SHOWN, strict=True):
        assert (marker.type, marker.action) == (Marker.CYLINDER, Marker.ADD)
        assert marker.scale.x == marker.scale.y == 2.0 * row[4]
        assert marker.header.frame_id == "odom"
    assert [m.action for m in crossing.gone().markers] == [Marker.DELETEALL]


def driven(crossing, poses, goal=(0.0, 0.0, 0.0)):
    rows = np.array([[100.0 + i, *pose, 0.0, 0.0, 0.0] for i, pose in enumerate(poses)])
    return goal_figures(rows, DrivenGoal(goal, crossing, 100.0, 100.0 + len(rows) - 1), HALF)


def test_the_least_gap_to_an_obstacle_is_that_of_the_right_time():
    crossing = Crossing(100.0, np.array([[2.0, 0.0]]), np.array([[0.0, 1.0]]), np.array([0.3]))
    # The obstacle is beside x = 2 at 102 s, 2 m further left.
    assert driven(crossing, [(0, 0, 0)] * 3)["clearance_m"] == pytest.approx(2.0 - 0.5 - 0.3)
    through = driven(crossing, [(0, 0, 0), (0, 0, 0), (2.0, 0.0, 0)])
    assert through["clearance_m"] == pytest.approx(1.2), "it has gone when the robot is there"
    hit = driven(crossing, [(0, 0, 0), (2.0, 1.0, 0), (2.0, 0.0, 0)])
    assert hit["clearance_m"] < 0.0


def test_the_way_to_a_goal_ends_where_it_ends():
    crossing = Crossing.before((50.0, 0.0, 0.0), 100.0)
    result = driven(crossing, [(0, 0, 0), (1.0, 0.0, math.pi)], (1.0, 0.02, -math.pi + 0.01))
    assert result["position_mm"] == pytest.approx(20.0)
    assert result["heading_deg"] == pytest.approx(math.degrees(0.01))
    assert result["time_s"] == 1.0


GOOD = {
    "tracking": {"rms_mm": 0, "max_mm": 0, "final_mm": 0, "final_heading_deg": 0},
    "odometry": {"position_mm": 0, "heading_deg": 0},
    "timing": {"odom": {"rate_hz": 100}, "wheel_commands": {"rate_hz": 200}},
    "twists": [],
}


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        ({}, None),
        ({"position_mm": 41.0}, "goal position, mm: 41"),
        ({"heading_deg": math.nan}, "goal heading, deg: nan"),
        ({"clearance_m": 0.0}, "an obstacle was touched"),
        ({"clearance_m": math.nan}, "an obstacle was touched"),
    ],
)
def test_a_goal_missed_or_an_obstacle_touched_is_a_fault(change, fault):
    goal = {"position_mm": 5.0, "heading_deg": 0.5, "clearance_m": 0.1, "time_s": 7.0} | change
    found = faults(GOOD | {"goal": goal})
    assert [text for text in found if fault is None or fault not in text] == []
    assert bool(found) == (fault is not None)
