"""What a disc can reach is never left out, and a wall is closed."""

import numpy as np
import pytest

from omniman_ros.planning.route.disc_reach import EDGE, reached_by_disc
from omniman_ros.surroundings.ellipses import Ellipses

WORKSPACE = (-3.0, -2.0, 4.0, 3.0)
RADIUS = 0.25


def discs(centers, radius=0.035):
    return Ellipses.circles(0.0, np.array(centers), (0.0, 0.0), radius)


def wall(step, shift=0.0, door=0.0):
    """Return loose discs across the workspace at x = 1, with a door of a width at y = 0.5 [m]."""
    y = np.arange(-2.0, 3.01, step) + shift
    y = y[np.abs(y - 0.5) > 0.5 * door]
    sides = [0.5 - 0.5 * door, 0.5 + 0.5 * door] if door else []
    return discs([(1.0, each) for each in (*y, *sides)])


def test_loose_discs_close_a_wall_where_the_disc_does_not_fit_between():
    ends = np.array([[2.0, 0.0], [0.0, 1.0], [-2.5, -1.5]])
    start = np.array([0.0, 0.0])
    found = reached_by_disc(start, ends, RADIUS, wall(0.3), WORKSPACE)
    assert found.tolist() == [False, True, True]
    found = reached_by_disc(start, ends, RADIUS, wall(0.65), WORKSPACE)
    assert found.tolist() == [True, True, True]
    assert reached_by_disc(start, ends, RADIUS, discs(np.zeros((0, 2))), WORKSPACE).all()


@pytest.mark.parametrize("seed", range(20))
def test_a_door_as_wide_as_the_disc_is_open_wherever_it_lies(seed):
    random = np.random.default_rng(seed)
    angle, shift = random.uniform(0.0, np.pi), random.uniform(0.0, EDGE, 2)
    c, s = np.cos(angle), np.sin(angle)
    closed = wall(0.2, random.uniform(0.0, 0.2), 2.0 * (RADIUS + 0.035) + 1e-3)
    turned = (closed.centers - [1.0, 0.5]) @ np.array([[c, s], [-s, c]]) + shift
    far = 0.6 * np.array([c, s])
    bounds = (-2.0, -2.0, 2.0, 2.0)
    found = reached_by_disc(shift - far, (shift + far)[None], RADIUS, discs(turned), bounds)
    assert found.all()
