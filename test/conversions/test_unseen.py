"""Times of arrival through a message and back."""

import numpy as np
import pytest
from builtin_interfaces.msg import Time

from omniman_ros.conversions.unseen import arrivals_from_message, unseen_message
from omniman_ros.core.errors import InputError


def message():
    times = np.array([[0.0, 0.5, 2.9], [np.inf, np.nan, 1.234]])
    return times, unseen_message(times, 0.1, np.array([1.0, -2.0]), "odom", Time(sec=3))


def test_times_are_kept_within_three_hundredths_of_a_second_and_never_later():
    times, sent = message()
    read = arrivals_from_message(sent)
    late = read.times - times
    assert np.isinf(read.times[1, :2]).all()
    known = np.isfinite(times)
    assert (late[known] <= 1e-12).all() and late[known].min() > -0.031
    assert (read.origin.tolist(), read.resolution) == ([1.0, -2.0], pytest.approx(0.1))


@pytest.mark.parametrize(
    "change",
    [
        lambda m: m.data.append(0),
        lambda m: m.data.__setitem__(0, 101),
        lambda m: m.data.__setitem__(0, -2),
        lambda m: setattr(m.info, "resolution", float("nan")),
        lambda m: setattr(m.info.origin.position, "x", float("inf")),
        lambda m: setattr(m.info.origin.orientation, "z", 0.5),
    ],
)
def test_bad_messages_are_refused(change):
    _, sent = message()
    change(sent)
    with pytest.raises(InputError):
        arrivals_from_message(sent)
