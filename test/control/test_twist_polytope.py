"""The twists that the wheels reach."""

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from omniman_ros.control.kinematics import PlatformKinematics
from omniman_ros.control.twist_polytope import TwistPolytope
from omniman_ros.core.errors import ParameterError
from test import robots

SPEED = 14.0


def polytope(seed):
    rng = np.random.default_rng(seed)
    wheels = robots.random_wheels(rng, int(rng.integers(3, 9)))
    return TwistPolytope(PlatformKinematics(wheels), SPEED), rng


@pytest.mark.parametrize("seed", range(8))
def test_the_convex_hull_of_the_vertices_is_what_the_wheels_reach(seed):
    reached, rng = polytope(seed)
    np.testing.assert_allclose(reached.utilisation(reached.vertices), 1.0, atol=1e-8)
    hull = ConvexHull(reached.vertices / reached.maxima)
    twists = rng.uniform(-1.0, 1.0, (2000, 3))
    within = (hull.equations @ np.column_stack([twists, np.ones(2000)]).T <= 0.0).all(axis=0)
    assert (within == (reached.utilisation(twists * reached.maxima) <= 1.0)).all()
    assert 50 < within.sum() < 1950
    assert reached.volume == pytest.approx(hull.volume * reached.maxima.prod(), rel=1e-6)


@pytest.mark.parametrize("seed", range(4))
def test_a_section_has_its_corners_on_the_surface_and_the_area_that_the_volume_adds_up(seed):
    reached, _ = polytope(seed)
    rates = np.linspace(-1.0, 1.0, 2001) * reached.maxima[2]
    areas = []
    for rate in rates[1:-1]:
        x, y = reached.section(rate).T
        areas.append(0.5 * float((x * np.roll(y, -1) - np.roll(x, -1) * y).sum()))
    twists = np.column_stack([x, y, np.full(len(x), rate)])
    np.testing.assert_allclose(reached.utilisation(twists), 1.0, atol=1e-8)
    assert sum(areas) * (rates[1] - rates[0]) == pytest.approx(reached.volume, rel=1e-4)
    assert reached.section(1.01 * reached.maxima[2]).shape == (0, 2)


def test_four_equal_mecanum_wheels_reach_an_octahedron():
    reached = TwistPolytope(robots.kinematics("omniman"), SPEED)
    rim = 0.127 * SPEED
    expected = np.diag([rim, rim, rim / (0.36 + 0.27)])
    found = reached.vertices[np.argsort(reached.vertices @ [1.0, 2.0, 3.0])]
    wanted = np.vstack([expected, -expected])
    np.testing.assert_allclose(found, wanted[np.argsort(wanted @ [1.0, 2.0, 3.0])], atol=1e-9)
    assert [len(face) for face in reached.faces] == [3] * 8
    assert reached.volume == pytest.approx(8.0 * reached.maxima.prod() / 6.0)


@pytest.mark.parametrize("speed", [0.0, -1.0, np.nan, np.inf])
def test_a_limit_that_is_none_is_refused(speed):
    with pytest.raises(ParameterError, match="max_speed"):
        TwistPolytope(robots.kinematics("omniman"), speed)
