import math

import numpy as np
import pytest

from omniman_ros.lab.studies.closed_loop import PERIOD
from omniman_ros.lab.studies.crowds import HALF, RADIUS, ContactJudge, DiscCrowd, disc_gaps

BOX = np.array([0.4, 0.25])
CORNERS = BOX * [[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]]


def advanced(crowd, corners=CORNERS):
    """Yield after each tick of half a minute beside a robot at rest."""
    for _ in range(round(30.0 / PERIOD)):
        crowd.advance(corners, np.zeros(2))
        yield crowd.positions


def test_a_gap_is_that_of_disc_and_box():
    pose = np.array([1.0, 2.0, math.pi / 2])  # its length along y
    places = np.array([[1.0, 3.0], [2.0, 2.0], [1.1, 2.1], [1.25 + 0.3, 2.4 + 0.4]])
    expected = [0.6 - RADIUS, 0.75 - RADIUS, -RADIUS, 0.5 - RADIUS]
    assert disc_gaps(pose, BOX, places) == pytest.approx(expected)
    poses = np.stack([pose, pose + [0.0, 0.0, math.pi / 2]])[:, None]  # (2, 1, 3)
    gaps = disc_gaps(poses, BOX, places)
    assert gaps[0] == pytest.approx(expected)
    assert gaps[1, :2] == pytest.approx([0.75 - RADIUS, 0.6 - RADIUS])


@pytest.mark.parametrize(("gives_way", "least"), [(False, 1.0), (True, 0.75)])
def test_discs_cross_their_square_again_and_again(gives_way, least):
    crowd, way = DiscCrowd(8, 1, gives_way), np.zeros(8)
    nowhere = CORNERS + 100.0
    before = crowd.positions
    for positions in advanced(crowd, nowhere):
        way += np.hypot(*(positions - before).T)
        before = positions
        assert gives_way or np.abs(positions).max() <= HALF
    assert (way >= least * 30.0 * crowd._speeds - 1e-9).all()


@pytest.mark.parametrize("gives_way", [False, True])
def test_only_discs_that_give_way_keep_clear_of_a_robot_and_of_each_other(gives_way):
    crowd, robot, others = DiscCrowd(8, 2, gives_way), [], []
    pairs = np.triu_indices(8, 1)
    for positions in advanced(crowd):
        robot.append(disc_gaps(np.zeros(3), BOX, positions).min())
        away = positions[pairs[0]] - positions[pairs[1]]
        others.append(np.hypot(*away.T).min() - 2.0 * RADIUS)
    assert [bool(min(robot) > 0.0), bool(min(others) > 0.0)] == [gives_way, gives_way]


def test_a_contact_counts_once_by_the_motion_at_its_begin():
    judge, far, near = ContactJudge(BOX), [5.0, 0.0], [0.6, 0.0]
    driving, rest = np.array([0.0, 0.1, 0.0]), np.zeros(3)
    turning = np.array([0.0, 0.0, 0.1])
    for velocity, place, moving, at_rest in (
        (driving, far, 0, 0),
        (driving, near, 1, 0),
        (rest, near, 1, 0),  # the same contact
        (rest, far, 1, 0),
        (rest, near, 1, 1),
        (driving, near, 1, 1),
        (driving, far, 1, 1),
        (turning, near, 2, 1),
    ):
        judge.add(np.zeros(3), velocity, np.array([place]))
        assert (judge.moving, judge.at_rest) == (moving, at_rest)
