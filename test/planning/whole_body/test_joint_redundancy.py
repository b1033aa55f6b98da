"""Platform and joints side by side: derivatives, and the ends of the joints' path."""

import numpy as np
import pytest

from omniman_ros.motion.whole_body.model import WholeBodyModel
from omniman_ros.planning.whole_body.joint_redundancy import JointPath, JointRedundancy
from test.planning.whole_body.support import START, setup

END = 1.2  #: Length of the path [m]
STEP = 1e-5  #: Of finite differences [m]


@pytest.fixture
def redundancy():
    nodes = START[3:] + np.random.default_rng(0).uniform(-1.0, 1.0, (7, 6))
    scale = np.array([0.5, 0.5, 0.4, 0.3, 0.3, 0.2])
    return JointRedundancy(WholeBodyModel(setup().description.mount), JointPath(nodes, END, scale))


def coordinates():
    return np.random.default_rng(1).uniform(
        [-2.0, -2.0, -3.0, 0.05], [2.0, 2.0, 3.0, 1.15], (9, 4)
    )


def test_rates_are_those_of_finite_differences(redundancy):
    z = coordinates()
    for k in range(4):
        step = STEP * np.eye(4)[k]
        change = redundancy.axes(z + step) - redundancy.axes(z - step)
        expected = change[:, 3:] / (2.0 * STEP)
        assert redundancy.configurations(z).rates[:, :, k] == pytest.approx(expected, abs=1e-6)


def test_the_drift_is_the_acceleration_at_a_constant_rate(redundancy):
    z, rates = coordinates(), np.random.default_rng(2).uniform(-1.0, 1.0, (9, 4))
    ahead, here, behind = (redundancy.axes(z + k * 1e-4 * rates)[:, 3:] for k in (1, 0, -1))
    drift = redundancy.drift(redundancy.configurations(z), rates)
    assert drift == pytest.approx((ahead - 2.0 * here + behind) / 1e-8, abs=1e-3)


def test_bends_count_joints_by_their_lengths(redundancy):
    places = np.linspace(0.1, 1.1, 7)
    bend = np.abs(redundancy.path.motion(places)[2])
    expected = (bend * redundancy.path.scale).max(axis=1)
    assert redundancy.bends(places) == pytest.approx(expected)
    assert (expected > 1.0).all()


def test_the_joints_are_held_beyond_the_ends(redundancy):
    path = redundancy.path
    angles, slope, bend = path.motion(np.array([-0.1, 0.0, END, END + 0.1]))
    assert (angles[0] == angles[1]).all() and (angles[2] == angles[3]).all()
    assert not slope[[0, 3]].any() and not bend[[0, 3]].any() and slope[1:3].any()
