import math
from itertools import count

import numpy as np
import pytest

from omniman_ros.core.parameters import build
from omniman_ros.lab.studies.closed_loop import PERIOD
from omniman_ros.lab.studies.crowd_baselines import KinematicRobot, dynamic_window, orca
from omniman_ros.lab.studies.crowds import DiscCrowd, disc_gaps
from omniman_ros.lab.studies.mppi_baseline import Mppi
from omniman_ros.planning.parameters import PlannerParameters
from omniman_ros.robots import robot_parameters

METHODS = pytest.mark.parametrize("method", [orca, dynamic_window, Mppi()])
GOAL = np.array([2.0, 1.0, 1.5])


class StandingDisc:
    """A crowd of one disc that stands."""

    def __init__(self, x, y):
        self.positions, self.velocities = np.array([[x, y]]), np.zeros((1, 2))


def robot_with(method, crowd, timer=lambda: 0.0):
    """Return a robot in a crowd, and the record of its poses and velocities."""
    record = []
    parameters = build(PlannerParameters, robot_parameters("ig42"))

    def note(pose, velocity):
        record.append((pose, velocity))

    return KinematicRobot(parameters, method, crowd, timer, note), record


@METHODS
def test_a_free_goal_is_reached_within_the_limits(method):
    robot, record = robot_with(method, StandingDisc(-4.0, -4.0))
    assert robot.reach(GOAL, 8.0)
    poses, velocities = (np.array(each) for each in zip(*record, strict=True))
    assert np.hypot(*(poses[-1] - GOAL)[:2]) <= 0.02
    assert abs(poses[-1, 2] - GOAL[2]) <= 0.02
    assert np.hypot(*velocities[:, :2].T).max() <= 0.85 * 1.0 + 1e-9
    change = np.diff(velocities, axis=0) / PERIOD
    assert np.hypot(*change[:, :2].T).max() <= 0.85 * 1.5 + 1e-6


@METHODS
def test_a_disc_in_the_way_is_passed(method):
    robot, record = robot_with(method, crowd := StandingDisc(1.5, 0.75))
    assert robot.reach(2.0 * GOAL, 20.0)
    gaps = [disc_gaps(pose, robot.half, crowd.positions).min() for pose, _ in record]
    assert 0.0 < min(gaps) < 0.5


def test_a_goal_that_is_taken_is_not_reached_nor_touched():
    robot, record = robot_with(dynamic_window, crowd := StandingDisc(*GOAL[:2]))
    assert not robot.reach(GOAL, 6.0)
    assert min(disc_gaps(pose, robot.half, crowd.positions).min() for pose, _ in record) > 0.0


def test_an_answer_is_followed_once_it_is_there():
    clock = count(step=0.02)
    timer = lambda: float(next(clock))  # noqa: E731 - each reading is 20 ms after the last
    robot, record = robot_with(orca, StandingDisc(-4.0, -4.0), timer)
    robot.reach(GOAL, 0.05)
    assert robot.cycle_times == pytest.approx([0.02])
    speeds = [math.hypot(*velocity[:2]) for _, velocity in record]
    assert speeds[:4] == [0.0] * 4 and min(speeds[4:]) > 0.0


def test_a_crowd_that_gives_way_is_crossed_without_a_contact():
    crowd, gaps = DiscCrowd(8, 0, gives_way=True), []
    robot, _ = robot_with(dynamic_window, crowd)
    corners = robot.half * [[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]]

    def tick(pose, velocity):
        c, s = math.cos(pose[2]), math.sin(pose[2])
        crowd.advance(corners @ [[c, s], [-s, c]] + pose[:2], velocity[:2])
        gaps.append(disc_gaps(pose, robot.half, crowd.positions).min())

    robot._on_tick = tick
    assert robot.reach(GOAL, 20.0)
    assert min(gaps) > 0.0
