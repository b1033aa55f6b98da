"""Prediction of a leader, and of a station that is fixed to it."""

import math

import numpy as np
import pytest

from omniman_ros.core import se2
from omniman_ros.motion.station.keeper import Leader

LEADER = Leader(2.0, (1.0, -0.5, 0.7), np.array([0.3, -0.1, 0.4]))
OFFSET = (0.2, -1.3, 0.5)


def test_leader_drives_on_along_the_arc_of_its_twist():
    x, y, theta = LEADER.predicted_pose(4.0)
    steps = 20000
    pose = np.array(LEADER.pose)
    for _ in range(steps):
        pose += 2.0 / steps * se2.to_world(pose[2], LEADER.twist)
    assert (x, y, theta) == pytest.approx(tuple(pose), abs=1e-4)


@pytest.mark.parametrize("time", [2.0, 2.4, 5.0])
def test_velocity_of_the_station_is_the_derivative_of_its_pose(time):
    step = 1e-5
    (before, _), (after, _) = (LEADER.station(OFFSET, time + d) for d in (-step, step))
    _, velocity = LEADER.station(OFFSET, time)
    assert velocity == pytest.approx((np.array(after) - before) / (2.0 * step), abs=1e-8)


def test_station_has_its_offset_in_the_frame_of_the_leader():
    station, _ = LEADER.station(OFFSET, 2.0)
    difference = np.array(station) - LEADER.pose
    seen = se2.to_robot(LEADER.pose[2], np.array([difference[0], difference[1], 0.0]))
    assert seen[:2] == pytest.approx(OFFSET[:2])
    assert math.isclose(difference[2], OFFSET[2])
