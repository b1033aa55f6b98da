import math

import numpy as np
import pytest

from omniman_ros.collision.footprint import Footprint
from omniman_ros.collision.rectangles import Rectangles
from omniman_ros.planning.obstacles.clearance import Clearance
from omniman_ros.planning.obstacles.separation import box_gap, outside_by
from test.planning.support import crowd

FOOTPRINT = Footprint(Rectangles.centred(np.array([0.4, 0.25])))
WIDE = (-1e3, -1e3, 1e3, 1e3)


@pytest.mark.parametrize("count", [0, 7, 60])
@pytest.mark.parametrize("reach", [0.3, math.inf])
def test_gaps_are_the_minimum_of_box_gap_and_workspace(count, reach):
    rng = np.random.default_rng(count)
    known = crowd(rng, count)
    poses = np.cumsum(rng.uniform(-0.3, 0.3, (400, 3)), axis=0)
    found = Clearance(FOOTPRINT, known, (-5, -4, 5, 4), reach).gaps(poses)
    centers = np.tile(known.centers, (len(poses), 1, 1))
    axes = np.tile(known.semi_axes, (len(poses), 1, 1))
    each = box_gap(poses, FOOTPRINT.whole, centers, axes, known.angles).min(axis=1, initial=np.inf)
    each = np.minimum(each, -outside_by(poses, FOOTPRINT.whole, (-5, -4, 5, 4)))
    touching = each <= 0
    np.testing.assert_array_equal(found <= 0, touching)
    tells = ~touching & (each <= reach)
    assert tells.sum() > 20
    np.testing.assert_allclose(found[tells], each[tells], atol=1e-12)
    assert (found[~touching & ~tells] > reach).all()


def test_gaps_do_not_depend_on_the_order_of_obstacles_and_poses():
    rng = np.random.default_rng(5)
    known, poses = crowd(rng, 80), rng.uniform(-6, 6, (200, 3))
    order, other = rng.permutation(80), rng.permutation(200)
    one = Clearance(FOOTPRINT, known, WIDE, 0.5).gaps(poses)
    two = Clearance(FOOTPRINT, known.select(order), WIDE, 0.5).gaps(poses[other])
    # Whether a far obstacle is reported depends on its tile.
    np.testing.assert_allclose(np.minimum(two, 0.5), np.minimum(one[other], 0.5), atol=1e-12)


@pytest.mark.parametrize("count", [3, 60])
def test_pose_or_obstacle_that_is_not_finite_is_not_free(count):
    known = crowd(np.random.default_rng(1), count)
    poses = np.array([[0, math.nan, 0], [0, 0, math.inf], [40, 0, 0]])
    found = Clearance(FOOTPRINT, known, WIDE, 0.3).gaps(poses)
    assert found[0] == -math.inf and found[1] == -math.inf and found[2] > 0.3
