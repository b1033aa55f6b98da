"""The twists of the demo, and how their error is measured."""

import math

import numpy as np
import pytest

from omniman_ros.control.limits import TwistLimits
from omniman_ros.core.parameters import build
from omniman_ros.demo.twist_leg import (
    DrivenPhase,
    Pace,
    TwistPhase,
    twist_error,
    twist_phases,
)
from test import robots

ROBOTS = robots.ALL
START = 1000.0


def limits(name):
    return build(TwistLimits, robots.values(name), "limits.")


@pytest.mark.parametrize("name", ROBOTS)
def test_the_twists_are_within_the_limits_of_every_robot_and_short(name):
    bounds = limits(name)
    pace = Pace.within(bounds)
    total = 0.0
    for phase in twist_phases(pace):
        total += phase.duration + 1.0
        for t in np.linspace(0.0, phase.duration, 200):
            x, y, turn = phase.twist(t)
            assert math.hypot(x, y) <= bounds.linear_velocity
            assert abs(turn) <= bounds.angular_velocity
    assert total < 20.0


def test_there_are_a_diagonal_a_spin_and_a_circle():
    assert [phase.name for phase in twist_phases(Pace())] == ["diagonal", "spin", "circle + spin"]


def test_the_circle_is_a_circle_in_the_world_while_the_platform_turns():
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
    radius = pace.speed * circle.duration / math.tau
    centre = np.array([0.0, radius])
    np.testing.assert_allclose(np.linalg.norm(track - centre, axis=1), radius, rtol=0.01)
    np.testing.assert_allclose(track[-1], track[0], atol=0.01)
    assert pose[2] > 1.0


def test_the_twist_error_is_that_of_the_mean_once_settled():
    phase = TwistPhase("forward", 3.0, lambda t: (0.3, 0.0, 0.0))
    times = np.arange(0.0, 4.0, 0.01)
    odom = np.zeros((len(times), 7))
    odom[:, 0] = START + times
    settled = (times > 0.99) & (times < 3.01)
    noise = 0.1 * (-1.0) ** np.arange(settled.sum())
    odom[settled, 4] = 0.3 + noise
    odom[settled, 5] = 0.02
    odom[settled, 6] = -0.01
    result = twist_error(odom, DrivenPhase(phase, START))
    assert result["linear_m_s"] == pytest.approx(0.02, abs=1e-3)
    assert result["angular_rad_s"] == pytest.approx(0.01)
    without_odometry = twist_error(odom, DrivenPhase(phase, START + 1e6))
    assert without_odometry["linear_m_s"] == math.inf
