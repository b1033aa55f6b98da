import math

import numpy as np
import pytest

from omniman_ros.cli.figures import Figure, Pace, twist_phases
from omniman_ros.core.limits import TwistLimits
from omniman_ros.core.parameters import build
from test import robots

START = (1.0, -2.0, 0.7)
ROBOTS = robots.ALL


def limits(name):
    return build(TwistLimits, robots.values(name), "limits.")


@pytest.fixture
def figure():
    return Figure(START)


def array(figure, part, times):
    return np.array([getattr(figure.sample(t), part) for t in times])


def test_it_begins_and_ends_at_the_start_at_rest(figure):
    for time in (-1.0, 0.0, figure.duration, figure.duration + 1.0):
        sample = figure.sample(time)
        np.testing.assert_allclose(sample.pose, START, atol=1e-12)
        np.testing.assert_allclose(sample.velocity, 0.0, atol=1e-12)
        np.testing.assert_allclose(sample.acceleration, 0.0, atol=1e-12)


@pytest.mark.parametrize(("of", "by"), [("pose", "velocity"), ("velocity", "acceleration")])
def test_derivatives_are_those_of_finite_differences(figure, of, by):
    step = 1e-5
    times = np.linspace(0.01, figure.duration - 0.01, 500)
    slope = (array(figure, of, times + step) - array(figure, of, times - step)) / (2 * step)
    np.testing.assert_allclose(array(figure, by, times), slope, atol=1e-6)


def test_acceleration_has_no_jump(figure):
    times = np.arange(0.0, figure.duration, 1e-3)
    assert np.abs(np.diff(array(figure, "acceleration", times), axis=0)).max() < 5e-3


@pytest.mark.parametrize("speed", [0.1, 0.3, 0.5])
def test_the_largest_speed_is_reached_and_not_passed(speed):
    figure = Figure(START, speed=speed)
    times = np.linspace(0.0, figure.duration, 2001)
    velocity = array(figure, "velocity", times)
    assert np.hypot(velocity[:, 0], velocity[:, 1]).max() == pytest.approx(speed, rel=1e-3)


def test_the_platform_moves_in_all_three_at_once(figure):
    times = np.linspace(0.0, figure.duration, 500)
    poses = array(figure, "pose", times) - START
    assert np.ptp(poses[:, 0]) > 0.5
    assert np.ptp(poses[:, 1]) > 0.5
    assert np.ptp(poses[:, 2]) == pytest.approx(math.pi / 2, rel=0.01)


def test_the_figure_is_turned_with_the_start():
    plain, turned = Figure((0.0, 0.0, 0.0)), Figure((0.0, 0.0, math.pi / 2))
    x, y, _ = plain.sample(4.0).pose
    np.testing.assert_allclose(turned.sample(4.0).pose[:2], (-y, x), atol=1e-12)


def test_ramps_that_do_not_fit_are_refused():
    with pytest.raises(ValueError, match="do not fit"):
        Figure(START, speed=5.0, ramp=10.0)


@pytest.mark.parametrize("name", ROBOTS)
def test_the_show_keeps_to_every_robots_limits_and_to_a_minute(name):
    bounds = limits(name)
    pace = Pace.within(bounds)
    total = 0.0
    for phase in twist_phases(pace):
        total += phase.duration + 1.0
        for t in np.linspace(0.0, phase.duration, 200):
            x, y, turn = phase.twist(t)
            assert math.hypot(x, y) <= bounds.linear_velocity
            assert abs(turn) <= bounds.angular_velocity
    figure = Figure(START, pace.figure, pace.ramp)
    times = np.linspace(0.0, figure.duration, 500)
    velocity = array(figure, "velocity", times)
    acceleration = array(figure, "acceleration", times)
    assert np.hypot(*velocity.T[:2]).max() <= bounds.linear_velocity
    assert np.abs(velocity[:, 2]).max() <= bounds.angular_velocity
    assert np.hypot(*acceleration.T[:2]).max() <= bounds.linear_acceleration
    assert np.abs(acceleration[:, 2]).max() <= bounds.angular_acceleration
    assert total + figure.duration < 50.0


def test_the_parts_are_those_that_are_promised():
    pace = Pace()
    phases = {phase.name: phase for phase in twist_phases(pace)}
    assert list(phases) == ["forward", "sideways", "diagonal", "spin", "circle + spin"]
    travel = np.zeros(2)
    for name in ("forward", "sideways", "diagonal"):
        travel += np.multiply(phases[name].twist(0.0)[:2], phases[name].duration)
    np.testing.assert_allclose(travel, 0.0, atol=1e-12)


def test_the_circle_is_one_in_the_world_while_the_platform_spins():
    pace = Pace()
    circle = twist_phases(pace)[-1]
    step = 1e-3
    pose = np.zeros(3)
    track = []
    for t in np.arange(0.0, circle.duration, step):
        x, y, turn = circle.twist(t)
        c, s = math.cos(pose[2]), math.sin(pose[2])
        pose += step * np.array([c * x - s * y, s * x + c * y, turn])
        track.append(pose[:2].copy())
    track = np.array(track)
    radius = pace.twist * circle.duration / math.tau
    centre = np.array([0.0, radius])
    np.testing.assert_allclose(np.linalg.norm(track - centre, axis=1), radius, rtol=0.01)
    np.testing.assert_allclose(track[-1], track[0], atol=0.01)
    assert pose[2] > 1.0
