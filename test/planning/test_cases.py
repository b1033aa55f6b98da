"""Test cases of the paper: number, geometry and speeds."""

import math

import numpy as np
import pytest

from omniman_ros.collision.rectangles import Rectangles
from omniman_ros.core.parameters import build
from omniman_ros.core.platform import Platform
from omniman_ros.planning.cases import CASES, RADIUS, TwoVelocityPath
from omniman_ros.planning.obstacles.separation import box_gap
from omniman_ros.robots import robot_parameters


@pytest.fixture(scope="module")
def body():
    """Return half the dimensions of the paper's robot."""
    return build(Platform, robot_parameters("ig42")).body


def gaps(pose, case, body, time=0.0):
    """Return gaps between the robot at a pose and each obstacle at a time (M,) [m]."""
    centers = np.array([path(time) for path in case.paths]).reshape(1, -1, 2)
    return box_gap(
        np.array([pose]),
        Rectangles.centred(np.array([body.length, body.width]) / 2.0),
        centers,
        np.full_like(centers, case.radius),
        np.zeros(centers.shape[1]),
    )[0]


@pytest.mark.parametrize("name", CASES)
def test_start_and_goal_are_clear(name, body):
    case = CASES[name]
    assert (gaps(case.start, case, body) > 0.3).all()
    if name == "corridor":
        assert (gaps(case.goal, case, body) > 0.3).all()


def test_free_goal_is_nearly_sideways_and_keeps_the_heading():
    case = CASES["free"]
    x, y, theta = case.start
    direction = math.atan2(case.goal[1] - y, case.goal[0] - x) - theta
    assert math.degrees(direction) == pytest.approx(70.0)
    assert case.goal[2] == theta
    assert math.dist(case.goal[:2], case.start[:2]) == pytest.approx(6.0)
    assert case.paths == ()


def test_gaps_of_the_corridor_are_wider_than_the_robot_and_shorter_than_it(body):
    centers = np.array([path(0.0) for path in CASES["corridor"].paths])
    between = np.hypot(*np.diff(centers, axis=0).T) - 2.0 * RADIUS
    assert len(between) == 3
    assert (body.width < between).all() and (between < body.length).all()
    assert all(not np.any(path.speed(1.0)) for path in CASES["corridor"].paths)


def test_row_of_the_corridor_blocks_the_straight_line(body):
    case = CASES["corridor"]
    path = np.linspace(case.start, case.goal, 200)
    assert min(gaps(pose, case, body).min() for pose in path) < 0.0


def test_four_obstacles_cross_from_both_sides_and_the_third_changes_course():
    case = CASES["moving"]
    begin, end = np.array([[path(time)[1] for path in case.paths] for time in (0.0, 8.0)])
    assert len(case.paths) == 4
    assert (begin * end < 0.0).all(), "each gets to the other side"
    assert (begin > 0.0).any() and (begin < 0.0).any()
    changing = [path.speed(0.0) != path.speed(100.0) for path in case.paths]
    assert changing == [False, False, True, False]


@pytest.mark.parametrize("seed", range(20))
def test_speed_is_the_rate_of_the_position(seed):
    rng = np.random.default_rng(seed)
    path = TwoVelocityPath(
        tuple(rng.normal(size=2)), tuple(rng.normal(size=2)), 2.0, tuple(rng.normal(size=2))
    )
    for time in (*rng.uniform(0.0, 1.9, 5), *rng.uniform(2.1, 9.0, 5)):
        rate = (path(time + 1e-4) - path(time - 1e-4)) / 2e-4
        assert path.speed(time) == pytest.approx(tuple(rate), abs=1e-8)
    assert path(2.0 - 1e-9) == pytest.approx(path(2.0 + 1e-9), abs=1e-6), "it does not jump"


def test_obstacle_that_never_turns_moves_straight():
    path = TwoVelocityPath((1.0, 2.0), (0.5, -1.0))
    assert path(1e6).tolist() == [500001.0, -999998.0]
    assert path.speed(1e6) == (0.5, -1.0)


@pytest.mark.parametrize("robot", ["ig42", "omniman"])
@pytest.mark.parametrize("name", CASES)
def test_case_scales_to_robots_of_other_sizes(name, robot):
    body = build(Platform, robot_parameters(robot)).body
    case, plain = CASES[name].fitting(body.length, body.width), CASES[name]
    assert case.name == name and case.goal[2] == plain.goal[2]
    if robot == "ig42":
        assert case == plain
    assert (gaps(case.start, case, body) > 0.3).all()
    if name == "corridor":
        centers = np.array([path(0.0) for path in case.paths])
        between = np.hypot(*np.diff(centers, axis=0).T) - 2.0 * case.radius
        assert (between > body.width + 0.15).all() and (between < 1.02 * body.length).all()
