"""Limit of the speed before contact, against closed forms and dense sampling."""

import math

import numpy as np
import pytest

from omniman_ros.collision.curve import curve_poses
from omniman_ros.collision.monitor import CollisionMonitor, MonitorParameters, RobotMotion
from omniman_ros.collision.moving_obstacles import MovingObstacles
from omniman_ros.collision.upright_obstacles import UprightObstacles
from omniman_ros.core import se2
from omniman_ros.core.arm_model import JOINTS
from omniman_ros.core.parameters import build
from omniman_ros.nodes.collision_monitor_parameters import CollisionMonitorParameters
from test import robots

GIVEN = build(CollisionMonitorParameters, robots.values())
LIMITS = GIVEN.speed_limits
PLATFORM, WHOLE = GIVEN.geometry(with_arm=False), GIVEN.geometry(with_arm=True)
REST = np.zeros(JOINTS)
FOLDED = np.array([0.0, -2.5, 2.6, -1.7, 0.0, 0.0])


def motion(x=0.0, y=0.0, turn=0.0, joints=REST):
    return np.array([x, y, turn, *joints])


def judge(place, speed, surroundings, geometry=PLATFORM, joints=FOLDED, **options):
    """Return the limit of a robot at a place that moves with a speed."""
    monitor = CollisionMonitor(geometry, LIMITS, MonitorParameters(**options))
    return monitor.limit(RobotMotion(np.array(place), joints, speed), [], surroundings)


def posts(*each, velocity=None):
    obstacles = UprightObstacles.join(
        [UprightObstacles.cylinder(x, y, r, (0.0, 2.0)) for x, y, r in each]
    )
    still = MovingObstacles.standing(obstacles)
    return still if velocity is None else MovingObstacles(obstacles, np.array([velocity]).T)


WALL = MovingObstacles.standing(UprightObstacles.box((3.0, 0.0, 0.0), 1.0, 9.0, (0.0, 2.0)))


@pytest.mark.parametrize("gap", [0.031, 0.05, 0.1, 0.3, 0.7, 1.5])
@pytest.mark.parametrize("speed", [0.05, 1.0])
def test_straight_at_a_wall_the_share_is_that_of_the_distance_that_is_left(gap, speed):
    fraction = judge((2.0 - gap, 0.0, 0.0), motion(speed), WALL).platform
    left = gap - 0.03
    stopping = math.sqrt(0.1**2 + 2 * left / 1.2) - 0.1
    exact = min(1.0, left, stopping * 1.2)
    assert 0.85 * exact - 0.02 <= fraction <= exact + 1e-6


def test_what_stops_is_reported():
    found = judge((1.9, 0.0, 0.0), motion(0.5), WALL)
    assert found.encounter.part == "platform"
    assert found.encounter.obstacle == 0
    assert found.encounter.distance == pytest.approx(0.1)
    assert found.arm == 1.0


@pytest.mark.parametrize("gap", [0.0001, 0.02, 0.03, 0.05])
def test_a_robot_at_a_wall_may_drive_along_it_and_away_but_not_nearer(gap):
    place = (2.0 - gap, 0.0, 0.0)
    for away in (motion(-1.0), motion(-0.1, 1.0), motion(0.0, 1.0), motion(0.0, -0.2)):
        assert judge(place, away, WALL).platform == 1.0
    assert judge(place, motion(1.0), WALL).platform <= max(gap - 0.03, 0.0) + 1e-6
    assert judge(place, motion(turn=1.0), WALL).platform < 0.2


def test_where_something_seems_to_touch_the_robot_it_is_slow_in_every_direction():
    for speed in (motion(1.0), motion(-1.0)):
        found = judge((2.1, 0.0, 0.0), speed, WALL)
        assert found.in_contact
        assert found.platform == 0.05
    assert judge((2.1, 0.0, 0.0), motion(1.0), WALL, contact_speed=0.0).platform == 0.0


def test_a_robot_that_neither_moves_nor_is_asked_to_is_not_limited():
    assert judge((1.99, 0.0, 0.0), motion(), WALL).platform == 1.0


def test_the_direction_that_is_asked_for_counts_at_rest():
    monitor = CollisionMonitor(PLATFORM, LIMITS, MonitorParameters())
    robot = RobotMotion(np.array((1.98, 0.0, 0.0)), FOLDED, motion())
    assert monitor.limit(robot, [motion(1e-2)], WALL).platform == 0.0
    assert monitor.limit(robot, [motion(-1.0)], WALL).platform == 1.0


def free_distance(pose, twist, obstacles, fraction, geometry=PLATFORM):
    """Return the least distance while the robot reacts, and brakes from a share of full speed."""
    stop_time = LIMITS.stop_time(twist)
    end = 0.1 * fraction + 0.5 * fraction**2 * stop_time
    poses = curve_poses(pose, twist[:3], np.linspace(0.0, end, 400))
    return float(geometry.distances(poses, np.tile(FOLDED, (400, 1)), obstacles).min())


@pytest.mark.parametrize("seed", range(40))
def test_a_robot_at_the_limit_comes_to_rest_before_the_margin(seed):
    rng = np.random.default_rng(seed)
    place = rng.uniform(-3.0, 3.0, 3)
    found = [rng.uniform((-3, -3, 0.02), (3, 3, 0.5)) for _ in range(6)]
    surroundings = posts(*found)
    start = PLATFORM.distances(place[None], FOLDED[None], surroundings.obstacles).min()
    speed = motion(*rng.uniform(-1.0, 1.0, 3))
    speed /= LIMITS.fraction(speed)
    limit = judge(place, speed, surroundings)
    if start > 0.0:
        least = free_distance(place, speed, surroundings.obstacles, limit.platform)
        assert least >= min(start, 0.03) - 1e-5
    if limit.platform == 1.0:
        assert free_distance(place, speed, surroundings.obstacles, 1.0) >= min(start, 0.03) - 1e-5


def test_what_drives_away_ahead_is_followed_and_what_comes_nearer_is_met_slowly():
    place, post = (0.0, 0.0, 0.0), (1.0, 0.0, 0.1)
    leaving, standing, coming = (
        judge(place, motion(0.5), posts(post, velocity=(v, 0.0))).platform
        for v in (1.0, 0.0, -1.0)
    )
    assert 0.0 <= coming < standing < 0.5 < leaving


def test_what_will_have_passed_does_not_stop_the_robot():
    crossing = posts((1.5, 0.5, 0.1), velocity=(0.0, 2.0))
    assert judge((0.0, 0.0, 0.0), motion(0.5), crossing).platform == 1.0


def test_the_arm_is_limited_alone_and_its_reach_counts_for_the_platform():
    ahead = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    post = posts((1.6, 0.0, 0.05))
    reach = WHOLE.distances(np.zeros((1, 3)), ahead[None], post.obstacles).min()
    assert 0.1 < reach < 0.6
    turning = motion(joints=(0.0, 0.0, 0.0, 0.0, 0.0, 1.0))
    assert judge((0.0, 0.0, 0.0), turning, post, WHOLE, ahead).arm == 1.0
    drive = judge((0.0, 0.0, 0.0), motion(0.5), post, WHOLE, ahead)
    assert drive.encounter.part not in ("platform", "base")
    assert drive.platform < reach
    assert drive.arm == 1.0
    aside = np.array([0.5, 0.0, 0.0, 0.0, 0.0, 0.0])
    swing = motion(joints=(-1.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    found = judge((0.0, 0.0, 0.0), swing, posts((1.0, 0.0, 0.05)), WHOLE, aside)
    assert found.arm < 0.3
    assert found.platform == 1.0


def test_curves_are_those_of_the_exponential_map():
    pose, twist = (0.3, -0.2, 0.7), np.array([0.5, -0.3, 0.8])
    found = curve_poses(np.array(pose), twist, np.array([0.0, 0.4, 2.0]))
    expected = [se2.compose(pose, se2.arc(t * twist)) for t in (0.0, 0.4, 2.0)]
    np.testing.assert_allclose(found, expected, atol=1e-12)
