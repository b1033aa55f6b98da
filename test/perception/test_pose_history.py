import math

import numpy as np
import pytest

from omniman_ros.core.errors import InputError
from omniman_ros.perception.pose_history import LEAD, SPAN, PoseHistory

STILL = np.zeros(3)


def history(*rows, velocity=STILL):
    made = PoseHistory()
    for time, *pose in rows:
        made.add(time, np.array(pose), np.asarray(velocity))
    return made


def test_poses_are_interpolated_and_headings_take_the_shorter_way():
    made = history((1.0, 0.0, 0.0, 3.0), (1.1, 0.2, -0.1, -3.0))
    poses = made.at(np.array([1.0, 1.05, 1.1]))
    assert poses.shape == (3, 3)
    turn = math.tau - 6.0
    np.testing.assert_allclose(poses[1], [0.1, -0.05, 3.0 + 0.5 * turn])


def test_the_newest_pose_goes_on_at_its_velocity_for_a_moment_only():
    made = history((1.0, 0.0, 0.0, 0.0), velocity=[1.0, 0.0, 0.5])
    np.testing.assert_allclose(made.at(np.array([1.08]))[0], [0.08, 0.0, 0.04])
    with pytest.raises(InputError, match=r"ends 0\.200 s earlier"):
        made.at(np.array([1.2]))
    assert LEAD < 0.2


def test_times_before_the_first_pose_are_refused():
    with pytest.raises(InputError, match="no odometry"):
        PoseHistory().at(np.array([1.0]))
    made = history(*((0.1 * k, 0.0, 0.0, 0.0) for k in range(100)))
    with pytest.raises(InputError, match="begins"):
        made.at(np.array([9.9 - SPAN - 0.2]))


def test_jumps_of_time_and_place_are_noticed_and_motion_is_not():
    made = history((1.0, 0.0, 0.0, 0.0), velocity=[1.0, 0.0, 0.0])
    assert made.jump(1.1, np.array([0.1, 0.0, 2.0])) == ""
    assert made.jump(0.95, np.array([0.0, 0.0, 0.0])) == ""
    assert "jumped by 0.90 m" in made.jump(1.1, np.array([1.0, 0.0, 0.0]))
    assert "went back" in made.jump(0.5, np.array([0.0, 0.0, 0.0]))
