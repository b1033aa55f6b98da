"""Maps and their updates through messages and back."""

from types import SimpleNamespace

import numpy as np
import pytest

from omniman_ros.core.errors import InputError

pytest.importorskip("rclpy")
from builtin_interfaces.msg import Time
from std_msgs.msg import Header

from omniman_ros.conversions.maps import (
    map_from_message,
    map_message,
    map_update_from_message,
    map_update_message,
)

CELLS = np.array([[0, -1, 100], [50, 1, 2]], dtype=np.int8)


def message(frame="odom", stamp=None):
    stamp = Time(sec=3, nanosec=500_000_000) if stamp is None else stamp
    return map_message(CELLS, 0.25, np.array([1.0, -2.0]), frame, stamp)


def update(header):
    """Return a message with the fields of `map_msgs/OccupancyGridUpdate`."""
    return SimpleNamespace(header=header)


def test_a_map_is_the_same_after_a_message():
    read = map_from_message(message())
    np.testing.assert_array_equal(read.values, CELLS)
    assert (read.resolution, read.origin.tolist()) == (0.25, [1.0, -2.0, 0.0])
    assert (read.frame, read.time) == ("odom", 3.5)


def test_a_map_without_a_stamp_has_no_time_and_a_leading_slash_does_not_count():
    read = map_from_message(message(frame="/map", stamp=Time()))
    assert (read.frame, read.time) == ("map", None)


def test_the_corner_of_a_map_is_turned_by_its_orientation():
    turned = message()
    turned.info.origin.orientation.z = turned.info.origin.orientation.w = np.sqrt(0.5)
    assert map_from_message(turned).origin[2] == pytest.approx(np.pi / 2)


def test_a_map_changes_by_an_update_after_a_message():
    after = CELLS.copy()
    after[:, 1:] = 7
    part = (slice(0, 2), slice(1, 3))
    sent = map_update_message(update, after, part, "odom", Time(sec=4))
    changed = map_from_message(message()).updated(map_update_from_message(sent))
    np.testing.assert_array_equal(changed.values, after)
    assert changed.time == 4.0


def test_an_update_after_a_stamped_map_needs_a_stamp():
    sent = map_update_message(update, CELLS, (slice(0, 1), slice(0, 1)), "odom", Time())
    with pytest.raises(InputError, match="it is unstamped"):
        map_from_message(message()).updated(map_update_from_message(sent))


@pytest.mark.parametrize("read", [map_from_message, map_update_from_message])
def test_too_few_cells_are_refused(read):
    sent = SimpleNamespace(header=Header(), data=[0] * 5, width=3, height=2, x=0, y=0)
    sent.info = message().info
    with pytest.raises(InputError, match="there are 5 cells, expected 3 x 2"):
        read(sent)
