import math

import numpy as np
import pytest

from omniman_ros.lab.bench.crowd import HALF, RADIUS, DiscCrowd, disc_gaps, drive_in_crowd
from omniman_ros.lab.studies.closed_loop import PERIOD
from omniman_ros.robots import robot_parameters

BOX = np.array([0.4, 0.25])


def test_a_gap_is_that_of_disc_and_box():
    pose = np.array([1.0, 2.0, math.pi / 2])  # its length along y
    places = np.array([[1.0, 3.0], [2.0, 2.0], [1.1, 2.1], [1.25 + 0.3, 2.4 + 0.4]])
    expected = [0.6 - RADIUS, 0.75 - RADIUS, -RADIUS, 0.5 - RADIUS]
    assert disc_gaps(pose, BOX, places) == pytest.approx(expected)


def test_discs_cross_their_square_again_and_again():
    crowd, way = DiscCrowd(8, seed=1), np.zeros(8)
    for _ in range(round(30.0 / PERIOD)):
        before = crowd.positions
        crowd.advance()
        way += np.hypot(*(crowd.positions - before).T)
    assert np.abs(crowd.positions).max() <= HALF
    assert way.min() == pytest.approx(30.0 * crowd._speeds.min())
    assert way.min() > 2.0 * HALF


@pytest.mark.exhaustive
def test_a_robot_that_moves_touches_nobody():
    run = drive_in_crowd(robot_parameters("ig42"), 0, 20.0, 8)
    assert run.contacts == 0
    assert run.goals > 0
