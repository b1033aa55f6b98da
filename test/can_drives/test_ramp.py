"""Ramps of all wheels in step."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from omniman_ros.can_drives.setpoints import SpeedRamp

SPEEDS = np.array([4.0, -2.0, 1.0, 3.0])
finite = st.floats(-1e3, 1e3)
speeds = st.lists(finite, min_size=4, max_size=4).map(np.array)


def begun(speeds=SPEEDS):
    ramp = SpeedRamp(4)
    ramp.begin(speeds)
    return ramp


def test_fastest_wheel_has_the_deceleration_and_the_others_keep_their_share():
    ramp = begun()
    assert ramp.step_to_rest(10.0, 0.0) == pytest.approx(SPEEDS), (
        "the time of the first step is not known"
    )
    assert ramp.step_to_rest(10.0, 0.1) == pytest.approx(0.75 * SPEEDS)
    assert ramp.step_to_rest(10.0, 0.3) == pytest.approx(0.25 * SPEEDS)
    assert ramp.step_to_rest(10.0, 0.4) == pytest.approx(np.zeros(4), abs=1e-12)


@given(
    start=speeds, times=st.lists(st.floats(-10.0, 10.0), max_size=20), rate=st.floats(0.01, 1e4)
)
@settings(max_examples=200, deadline=None)
def test_no_order_of_times_makes_a_wheel_faster_on_its_way_to_rest(start, times, rate):
    ramp, last = begun(start), np.abs(start)
    for now in times:
        speed = np.abs(ramp.step_to_rest(rate, now))
        assert (speed <= last + 1e-9).all()
        last = speed


@given(start=speeds, target=speeds, times=st.lists(st.floats(-10.0, 10.0), max_size=20))
@settings(max_examples=200, deadline=None)
def test_no_order_of_times_leaves_the_way_between_two_speeds(start, target, times):
    ramp = begun(start)
    for now in times:
        speed = ramp.step_towards(target, 30.0, now)
        assert (speed >= np.minimum(start, target) - 1e-9).all()
        assert (speed <= np.maximum(start, target) + 1e-9).all()


def test_gap_ends_the_ramp_and_equal_times_do_not_move_it():
    ramp = begun()
    ramp.step_to_rest(10.0, 0.0)
    for _ in range(5):
        assert ramp.step_to_rest(10.0, 0.0) == pytest.approx(SPEEDS)
    assert not ramp.step_to_rest(10.0, 1e9).any()


def test_command_is_approached_once_and_then_followed():
    ramp = SpeedRamp(4)
    rows = [ramp.step_towards(SPEEDS, 10.0, 0.1 * k) for k in range(6)]
    assert [row[0] for row in rows] == pytest.approx([0.0, 1.0, 2.0, 3.0, 4.0, 4.0])
    assert ramp.step_towards(-SPEEDS, 10.0, 0.51) == pytest.approx(-SPEEDS)


def test_after_a_way_down_the_next_command_is_approached_again():
    ramp = begun()
    ramp.step_to_rest(10.0, 0.0)
    ramp.step_to_rest(10.0, 0.2)
    assert ramp.step_towards(SPEEDS, 10.0, 0.3) == pytest.approx(SPEEDS * 0.75)


def test_rest_forgets_the_speeds():
    ramp = begun()
    ramp.rest()
    assert not ramp.step_to_rest(10.0, 5.0).any()
    assert not ramp.step_towards(SPEEDS, 10.0, 6.0)[0] > 10.0 + 1e-9
