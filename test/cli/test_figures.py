import math

import numpy as np
import pytest

from omniman_ros.cli.figures import Pace, twist_phases
from omniman_ros.core.limits import TwistLimits
from omniman_ros.core.parameters import build
from test import robots

ROBOTS = robots.ALL


def limits(name):
    return build(TwistLimits, robots.values(name), "limits.")


@pytest.mark.parametrize("name", ROBOTS)
def test_the_show_keeps_to_every_robots_limits_and_is_short(name):
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


def test_the_parts_are_those_that_are_promised():
    assert [phase.name for phase in twist_phases(Pace())] == ["diagonal", "spin", "circle + spin"]


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
