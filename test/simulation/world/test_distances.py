"""Distances of a robot in a posture, as the physics engine measures them."""

import math

import numpy as np
import pytest

pytest.importorskip("mujoco")

from omniman_ros.core.parameters import build
from omniman_ros.description.parameters import DescriptionParameters
from omniman_ros.simulation.world.distances import ConfigurationDistances, Prism
from test import robots
from test.outlines import FORKS, outlined

DESCRIPTION = build(DescriptionParameters, robots.values("omniman"))
STRETCHED = (0.0,) * 6


def test_distances_from_a_platform_are_those_of_a_box():
    prisms = [Prism((0.2, 0.2), 0.0, (0.0, 0.3)), Prism((0.3, 0.1), 0.5 * math.pi, (1.6, 2.0))]
    shapes = ConfigurationDistances(DESCRIPTION, prisms)
    shapes.place(np.array([1.0, 2.0, 0.5 * math.pi]), np.array(STRETCHED), np.zeros((2, 2)))
    low, _ = shapes.distances(9.0)
    # The platform's near corner is at (0.65, 1.5).
    assert low == pytest.approx(math.hypot(0.65, 1.5) - 0.2, abs=1e-3)


def test_distances_from_a_platform_with_an_outline_are_those_of_the_outline():
    """A prism between the forks is clear of them; boxes of the URDF do not count."""
    shapes = ConfigurationDistances(outlined(FORKS), [Prism((0.03, 0.03), 0.0, (0.0, 0.3))])
    for x, gap in ((0.4, 0.14 * math.cos(math.atan(0.1)) - 0.03), (0.2, 0.089), (-0.3, 0.0)):
        shapes.place(np.zeros(3), np.array(STRETCHED), np.array([[x, 0.0]]))
        assert max(shapes.distances(9.0)[0], 0.0) == pytest.approx(gap, abs=2e-3)
