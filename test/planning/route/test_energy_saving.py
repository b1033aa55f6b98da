import math

import numpy as np
import pytest

from omniman_ros.planning.effective_limits import EffectiveLimits
from omniman_ros.planning.route.energy_saving import MIN_SAVING, YAW_RATE_FACTOR, power, straight
from omniman_ros.planning.route.route import Route
from test import robots
from test.planning.support import model, parameters

SPEEDS = EffectiveLimits(parameters()).speeds  #: Linear [m/s] and angular speed [rad/s]


def sideways(distance, heading=0.0):
    """Return a line from the origin to the left with the same heading at both ends."""
    return np.zeros(3), np.array([0.0, distance, heading])


def some_poses(random, spread=5.0):
    """Draw a start and a goal, the shorter turn apart."""
    start = np.append(random.uniform(-spread, spread, 2), random.uniform(-7.0, 7.0))
    goal = np.append(random.uniform(-spread, spread, 2), start[2] + random.uniform(-3.1, 3.1))
    return start, goal


def energy(robot, poses, speeds=SPEEDS):
    """Integrate the friction losses along a route [J] on a fine time grid."""
    route = Route(poses, speeds)
    times = np.linspace(0.0, route.duration, 2001)
    middle = route.at(0.5 * (times[:-1] + times[1:]))
    velocities = np.diff(route.at(times), axis=0) / np.diff(times)[:, None]
    cos, sin = np.cos(middle[:, 2]), np.sin(middle[:, 2])
    x, y, turning = velocities.T
    twists = np.column_stack([cos * x + sin * y, cos * y - sin * x, turning])
    return float(power(robot, twists).mean() * route.duration)


@pytest.mark.parametrize("name", ["ig42", "omniman"])
@pytest.mark.parametrize("axis", range(3))
def test_power_matches_friction_losses_computed_by_hand(name, axis):
    """All wheels have one speed ahead, sideways and turning: each carries a quarter."""
    robot = model(name)
    twist = np.zeros(3)
    twist[axis] = 0.6
    wheels, rollers = np.abs(robot.J @ twist), np.abs(robot.rolling @ twist)
    np.testing.assert_allclose(wheels, wheels[0])
    lost = float((robot.viscous * wheels + robot.coulomb) @ wheels + robot.drag @ rollers)
    current = lost / (4.0 * wheels[0]) / (robot.efficiency * robot.emf)
    by_hand = 4.0 * (robot.resistance * current**2 + robot.emf * wheels[0] * current)
    assert power(robot, twist) == pytest.approx(by_hand, rel=1e-3)
    assert by_hand > 1.0


@pytest.mark.parametrize("name", robots.ALL)
def test_power_is_that_of_the_minimum_currents_that_balance_friction(name):
    """Check wheel by wheel for any wheel layout, and against the travel model of the studies."""
    robot, random = model(name), np.random.default_rng(4)
    twists = random.uniform(-0.7, 0.7, (20, 1, 3))
    found = power(robot, twists)
    assert found.shape == (20, 1)
    for twist, total in zip(twists[:, 0], found[:, 0], strict=True):
        force = np.zeros(3)
        for row, a, b in zip(robot.J, robot.viscous, robot.coulomb, strict=True):
            force += row * (a * (row @ twist) + b * math.copysign(1.0, row @ twist))
        for row, drag in zip(robot.rolling, robot.drag, strict=True):
            force += row * drag * math.copysign(1.0, row @ twist)
        by_current = robot.efficiency * robot.emf * robot.J.T
        currents = np.linalg.lstsq(by_current, force, rcond=None)[0]
        volts = robot.resistance * currents + robot.emf * (robot.J @ twist)
        assert total == pytest.approx(float(volts @ currents), rel=1e-6)


def test_power_is_symmetric_in_direction_and_zero_at_rest():
    robot = model("ig42")
    twists = np.random.default_rng(1).uniform(-1.0, 1.0, (50, 3))
    there = power(robot, twists)
    np.testing.assert_allclose(power(robot, -twists), there)
    np.testing.assert_allclose(power(robot, twists * [1.0, -1.0, -1.0]), there, rtol=1e-9)
    np.testing.assert_allclose(power(robot, twists * [-1.0, 1.0, -1.0]), there, rtol=1e-9)
    assert there.min() > 0.0
    assert power(robot, np.zeros(3)) == 0.0


def test_turn_saves_energy_over_four_metres_sideways_but_not_over_one():
    robot = model("ig42")
    assert len(straight(robot, *sideways(1.0), SPEEDS)) == 2
    poses = straight(robot, *sideways(4.0), SPEEDS)
    assert len(poses) == 4
    saved = 1.0 - energy(robot, poses) / energy(robot, poses[[0, -1]])
    assert saved > MIN_SAVING


@pytest.mark.parametrize("name", ["ig42", "omniman", "omni3"])
def test_chosen_route_never_costs_more_than_the_plain_line(name):
    robot, random = model(name), np.random.default_rng(2)
    turned = 0
    for _ in range(40):
        start, goal = some_poses(random)
        poses = straight(robot, start, goal, SPEEDS)
        if len(poses) == 2:
            continue
        turned += 1
        # A heading is not held exactly, so the power of a line is a mean over some degrees.
        plain = energy(robot, poses[[0, -1]])
        assert energy(robot, poses) < (1.0 - 0.5 * MIN_SAVING) * plain
    assert (turned == 0) if name == "omni3" else (turned > 5)


def test_ends_are_exact_positions_are_on_the_line_and_turns_are_minimal():
    robot, random = model("ig42"), np.random.default_rng(3)
    bends = 0
    for _ in range(60):
        start, goal = some_poses(random)
        poses = straight(robot, start, goal, SPEEDS)
        np.testing.assert_allclose(poses[[0, -1]], [start, goal], rtol=0.0, atol=1e-12)
        ahead = goal[:2] - start[:2]
        away = poses[:, :2] - start[:2]
        along = away @ ahead / (ahead @ ahead)
        np.testing.assert_allclose(away, along[:, None] * ahead, atol=1e-9)
        assert (np.diff(along) >= 0.0).all()
        assert np.abs(np.diff(poses[:, 2])).max() <= math.pi + 1e-9, "the short way"
        route = Route(poses, SPEEDS)
        if len(poses) == 4:
            bends += 1
            assert poses[1, 2] == poses[2, 2]
            # The robot turns while it travels, at a fraction of the limit, without losing time.
            assert route.duration == pytest.approx(np.hypot(*ahead) / SPEEDS[0])
            turning = np.abs(np.diff(poses[:, 2])) / np.maximum(np.diff(route.times), 1e-12)
            assert turning.max() <= YAW_RATE_FACTOR * SPEEDS[1] * (1.0 + 1e-9)
    assert 5 < bends < 60


def test_choice_is_invariant_to_rotation_and_translation():
    robot = model("ig42")
    start, goal = sideways(4.0)
    here = straight(robot, start, goal, SPEEDS)
    angle, place = 2.0, np.array([30.0, -20.0, 0.0])
    c, s = math.cos(angle), math.sin(angle)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])

    def moved(pose):
        return place + turn @ pose + [0.0, 0.0, angle]

    there = straight(robot, moved(start), moved(goal), SPEEDS)
    # The choice among equally good headings is open: the robot is symmetric.
    expected = np.array([moved(pose) for pose in here])
    np.testing.assert_allclose(there[:, :2], expected[:, :2], atol=1e-6)
    assert energy(robot, there) == pytest.approx(energy(robot, here), rel=1e-6)


@pytest.mark.parametrize("fraction", [1.0, 0.01])
def test_zero_length_routes_and_turns_on_the_spot_are_unchanged(fraction):
    robot, speeds = model("ig42"), EffectiveLimits(parameters(), fraction).speeds
    here = np.array([1.0, 2.0, 3.0])
    for turned in (0.0, 1e-12, 3.1, -3.1):
        goal = here + [0.0, 0.0, turned]
        np.testing.assert_array_equal(straight(robot, here, goal, speeds), [here, goal])
    near = here + [0.0, 1e-9, 0.0]
    np.testing.assert_array_equal(straight(robot, here, near, speeds), [here, near])


def test_headings_of_several_turns_keep_their_branch():
    robot = model("ig42")
    usual = straight(robot, *sideways(4.0), SPEEDS)
    for turns in (100, -7):
        off = [0.0, 0.0, turns * math.tau]
        start, goal = sideways(4.0)
        poses = straight(robot, start + off, goal + off, SPEEDS)
        assert poses.shape == usual.shape
        np.testing.assert_allclose(np.abs(poses - off), np.abs(usual), atol=1e-6)
    # A goal whole turns away on purpose: both ends keep their headings either way.
    start, goal = sideways(4.0, heading=20.0 * math.tau)
    poses = straight(robot, start, goal, SPEEDS)
    np.testing.assert_allclose(poses[[0, -1]], [start, goal])
