import math

import numpy as np
import pytest

from omniman_ros.lab.studies.closed_loop import PERIOD
from omniman_ros.lab.studies.crowd import HALF, RADIUS, DiscCrowd, disc_gaps, drive_in_crowd
from omniman_ros.robots import load_robot

BOX = np.array([0.4, 0.25])
CORNERS = BOX * [[1, 1], [1, -1], [-1, 1], [-1, -1]]


def test_a_gap_is_that_of_disc_and_box():
    pose = np.array([1.0, 2.0, math.pi / 2])  # its length along y
    places = np.array([[1.0, 3.0], [2.0, 2.0], [1.1, 2.1], [1.25 + 0.3, 2.4 + 0.4]])
    expected = [0.6 - RADIUS, 0.75 - RADIUS, -RADIUS, 0.5 - RADIUS]
    assert disc_gaps(pose, BOX, places) == pytest.approx(expected)


@pytest.mark.parametrize("gives_way", [False, True])
def test_discs_stay_in_their_square_and_those_that_give_way_touch_nothing(gives_way):
    crowd = DiscCrowd(8, gives_way, seed=1)
    gap, apart, way = math.inf, math.inf, np.zeros(8)
    for _ in range(round(5.0 / PERIOD)):
        before = crowd.positions
        crowd.advance(CORNERS, np.zeros(2))
        way += np.hypot(*(crowd.positions - before).T)
        gap = min(gap, disc_gaps(np.zeros(3), BOX, crowd.positions).min())
        offset = crowd.positions[:, None] - crowd.positions[None]
        apart = min(apart, (np.hypot(*offset.T) + 9.0 * np.eye(8)).min())
    assert np.abs(crowd.positions).max() < HALF + 0.1
    assert way.min() > 1.0
    assert not gives_way or (gap > 0.0 and apart > 2.0 * RADIUS)


@pytest.mark.exhaustive
def test_a_robot_touches_nobody_who_gives_way():
    run = drive_in_crowd(load_robot("ig42"), 0, True, 20.0, 8, lambda: 0.0)
    assert run.contacts == 0
    assert run.goals > 0
