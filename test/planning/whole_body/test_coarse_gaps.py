"""Gaps to many obstacles at once, beside those that look at each as it is."""

import numpy as np
import pytest

from omniman_ros.collision.signed_gaps import point_gap_values
from omniman_ros.collision.upright_obstacles import UprightObstacles
from omniman_ros.planning.whole_body.body_gaps import BodyGaps, in_odom
from omniman_ros.planning.whole_body.coarse_gaps import LEAST_GAP, CoarseGaps
from test.planning.whole_body.support import setup

SETUP = setup()
GAPS = BodyGaps(SETUP.description, SETUP.tool, None, 0.15)
WIDE = 0.25  #: Gap from which on a wider one is no better [m]
FAR = 1e3  #: Distance of all places from the origin of odom [m]
BOX = GAPS.rectangles[0].half
#: Largest underestimation [m]: the diagonal of a cell, and the spacing of the platform's outline
EXACT = {"arm": 0.015, "platform": 0.018}


def obstacles(random):
    """Return cells of a map, posts, tables below and above the deck, and walls, mixed."""
    x, y = random.uniform(-3.0, 3.0, (2, 30)) + np.array([[FAR], [0.0]])
    yaw = random.uniform(-3.0, 3.0, 30)
    each = [UprightObstacles.box((x[k], y[k], yaw[k]), 0.05, 0.05, (-9, 9)) for k in range(18)]
    each += [UprightObstacles.cylinder(x[k], y[k], 0.1, (0.0, 3.0)) for k in range(18, 22)]
    each += [UprightObstacles.cylinder(x[k], y[k], 0.3, (0.3, 0.34)) for k in range(22, 25)]
    each += [UprightObstacles.cylinder(x[k], y[k], 0.3, (0.6, 0.64)) for k in range(25, 28)]
    each += [UprightObstacles.box((x[k], y[k], yaw[k]), 1.0, 0.1, (0, 2)) for k in range(28, 30)]
    return UprightObstacles.join([each[k] for k in random.permutation(30)])


def coarse(around, extent, heights=(0.0, 1.0)):
    middle = np.array([FAR, 0.0])
    return CoarseGaps(GAPS, around, middle - extent, middle + extent, heights, WIDE)


def assert_close(found, exact, part):
    """No gap is overestimated, and none up to the wide one is underestimated by much."""
    counts = exact >= LEAST_GAP
    assert counts.any() and not counts.all()
    assert (np.minimum(found, WIDE) <= np.maximum(exact, 0.0) + 1e-6).all()
    least = np.minimum(exact, WIDE)[counts] - EXACT[part]
    assert (found[counts] >= np.where(least < LEAST_GAP, -LEAST_GAP, least) - 1e-6).all()


@pytest.mark.parametrize("seed", range(4))
def test_no_gap_is_overestimated_nor_much_underestimated(seed, monkeypatch):
    monkeypatch.setattr("omniman_ros.planning.whole_body.coarse_gaps.BATCH", 500)
    random = np.random.default_rng(seed)
    around = obstacles(random)
    poses = random.uniform(-2.0, 2.0, (400, 3)) + [FAR, 0.0, 0.0]
    placed = GAPS.spheres.place(random.uniform(-1.5, 1.5, (400, 6)))
    centre = np.moveaxis(in_odom(poses, placed.centre), -1, 0)
    exact = point_gap_values(around, centre).min(axis=2) - GAPS.spheres.radius
    assert_close(
        coarse(around, 2.0 + GAPS.radius).platform(poses),
        GAPS.platform(poses, around).min(axis=1),
        "platform",
    )
    gaps = coarse(around, 3.5, (centre[2].min(), centre[2].max()))
    assert_close(gaps.arm(centre), exact.min(axis=1), "arm")


def test_whatever_is_within_the_platform_touches_it():
    x, y = np.meshgrid(*(np.linspace(-half, half, 60) for half in BOX))
    yaw = 0.4
    c, s = np.cos(yaw), np.sin(yaw)
    for px, py in np.stack([x.ravel(), y.ravel()], axis=1)[::7].tolist():
        post = UprightObstacles.cylinder(FAR + c * px - s * py, s * px + c * py, 0.005, (0, 9))
        assert coarse(post, 0.7).platform(np.array([[FAR, 0.0, yaw]]))[0] < 0.0


def test_what_is_between_two_points_of_the_outline_is_not_farther_away_than_it_is():
    poses = np.random.default_rng(0).uniform(-1.0, 1.0, (4000, 3)) + [FAR, 0.0, 0.0]
    post = UprightObstacles.cylinder(FAR, 0.0, 0.005, (0, 9))
    exact = GAPS.platform(poses, post).min(axis=1)
    assert_close(coarse(post, 1.0 + GAPS.radius).platform(poses), exact, "platform")
