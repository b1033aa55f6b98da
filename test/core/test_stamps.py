"""Stamps that are ahead, and clocks that go back."""

import pytest

from omniman_ros.core.errors import InputError
from omniman_ros.core.stamps import (
    MAX_LEAD,
    TIME_JUMP,
    ClockWatch,
    comparable,
    demand_not_ahead,
)


def test_a_stamp_may_be_ahead_by_the_bound_and_no_more():
    for lead in (-1e9, 0.0, 1.0):
        demand_not_ahead(lead, 1.0)
    with pytest.raises(InputError, match=r"3600\.000 s ahead, at most 1 s are accepted"):
        demand_not_ahead(3600.0, 1.0)


def test_what_is_kept_is_compared_with_later_stamps_unless_it_is_ahead():
    assert comparable(None, 5.0) is None
    assert comparable(5.0 + 0.9 * MAX_LEAD, 5.0) == 5.0 + 0.9 * MAX_LEAD
    assert comparable(65.0, 5.0) is None


def test_a_clock_that_goes_back_is_noticed_once():
    watch = ClockWatch()
    times = (7.0, 9.0, 9.0 - 0.9 * TIME_JUMP, 3.0, 3.1, 2.9)
    assert [watch.went_back(now) for now in times] == [False, False, False, True, False, True]
