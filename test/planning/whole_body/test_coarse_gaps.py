"""Gaps to many obstacles at once, beside those that look at each as it is."""

import numpy as np
import pytest

from omniman_ros.collision.upright_obstacles import UprightObstacles
from omniman_ros.planning.whole_body.body_gaps import BodyGaps, in_odom
from omniman_ros.planning.whole_body.coarse_gaps import ROUNDED, CoarseGaps
from test.planning.whole_body.support import setup

SETUP = setup()
GAPS = BodyGaps(SETUP.description, SETUP.tool, None, 0.15)
COARSE = CoarseGaps(GAPS)


def obstacles(random):
    """Return cells of a map, posts, a table below the arm, and a wall, in a random order."""
    x, y = random.uniform(-1.5, 1.5, (2, 30))
    yaw = random.uniform(-3.0, 3.0, 30)
    each = [UprightObstacles.box((x[k], y[k], yaw[k]), 0.05, 0.05, (-9, 9)) for k in range(20)]
    each += [UprightObstacles.cylinder(x[k], y[k], 0.1, (0.0, 3.0)) for k in range(20, 25)]
    each += [UprightObstacles.cylinder(x[k], y[k], 0.3, (0.3, 0.34)) for k in range(25, 28)]
    each += [UprightObstacles.box((x[k], y[k], yaw[k]), 1.0, 0.1, (0, 2)) for k in range(28, 30)]
    return UprightObstacles.join([each[k] for k in random.permutation(30)])


@pytest.mark.parametrize("seed", range(4))
def test_no_gap_is_overestimated_nor_much_underestimated(seed, monkeypatch):
    random = np.random.default_rng(seed)
    around = obstacles(random)
    poses = random.uniform(-1.0, 1.0, (40, 3))
    exact = GAPS.platform(poses, around)
    coarse = COARSE.platform(poses, around)
    is_apart = exact > 0.0
    assert (coarse <= exact + 1e-9)[is_apart].all()
    assert (coarse >= exact - ROUNDED - 1e-9)[is_apart].all()
    assert (coarse <= 0.0)[~is_apart].all()

    placed = GAPS.spheres.place(random.uniform(-1.5, 1.5, (40, 6)))
    centre = np.moveaxis(in_odom(poses, placed.centre), -1, 0)
    exact = GAPS.to_obstacles(poses, placed.centre, around)[:, 1:]
    monkeypatch.setattr("omniman_ros.planning.whole_body.coarse_gaps.BATCH", 5000)
    least, sphere, obstacle = COARSE.spheres_least(centre, around)
    true = exact.reshape(40, -1).min(axis=1)
    assert (least <= np.maximum(true, 0.0) + 1e-9).all()
    assert (least >= true - ROUNDED - 1e-9)[true > 0.0].all()
    named = exact[np.arange(40), sphere, obstacle]
    assert (named <= true + ROUNDED + 1e-9)[true > 0.0].all()
