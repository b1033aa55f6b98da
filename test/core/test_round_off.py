import numpy as np
import pytest

from omniman_ros.core import round_off
from omniman_ros.core.errors import InputError


@pytest.mark.parametrize(("last", "ends"), [(0.0, 0.0), (5.2e-5, 0.0), (-9e-4, 0.0), (0.01, 0.01)])
def test_a_motion_that_ends_at_rest_but_for_round_off_ends_exactly_at_rest(last, ends):
    velocities = np.array([[0.5, 0.2], [0.0, last]])
    assert round_off.ended(velocities).tolist() == [[0.5, 0.2], [0.0, ends]]
    assert velocities[1, 1] == last, "the caller's array is not modified"
    assert round_off.is_rest(velocities[-1]) == (ends == 0.0)


def test_of_points_that_repeat_each_other_the_last_counts():
    times = np.array([0.0, 4e-6, 1.0, 2.0, 2.0 - 3e-9])
    positions = np.array([[0.0], [1e-5], [0.5], [1.0], [1.0 + 2e-6]])
    found, rows = round_off.distinct(times, positions)
    assert found.tolist() == [0.0, 1.0, 2.0] and rows.tolist() == [1, 2, 4]


def test_points_that_are_dense_in_time_are_not_all_one():
    times = 4e-6 * np.arange(1000.0)
    found, rows = round_off.distinct(times, 1e-6 * np.arange(1000.0)[:, None])
    assert len(found) > 300 and (np.diff(found) > round_off.SAME_TIME).all() and rows[-1] == 999


@pytest.mark.parametrize(
    ("times", "positions"),
    [([1.0, 1.0], [0.0, 0.1]), ([1.0, 0.9], [0.0, 0.0]), ([0.0, 2.0, 2.0], [0.0, 0.1, 0.2])],
)
def test_different_points_at_one_time_and_times_that_fall_are_refused(times, positions):
    with pytest.raises(InputError, match=r"times do not increase: point \d at [\d.]+ s, point"):
        round_off.distinct(np.array(times), np.array(positions)[:, None])
