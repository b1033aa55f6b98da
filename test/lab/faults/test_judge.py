import math

import numpy as np
import pytest

from omniman_ros.lab.faults.judge import judge_stop, largest_change

STEP = 0.01


def braking(begin, deceleration, speed=0.5, end=2.0):
    """Return times and speeds of a motion that brakes from a time on."""
    times = np.arange(-0.5, end, STEP)
    return times, np.clip(speed - deceleration * (times - begin), 0.0, speed)


@pytest.mark.parametrize("begin", [0.0, 0.1, 0.37])
@pytest.mark.parametrize("deceleration", [0.8, 1.2, 5.0])
def test_a_straight_ramp_gives_its_begin_its_end_and_its_slope(begin, deceleration):
    times, speeds = braking(begin, deceleration)
    stop = judge_stop(times, speeds, 0.0, 2.0, 0.01)
    assert stop.speed == pytest.approx(0.5)
    assert stop.reaction == pytest.approx(begin + 0.025 / deceleration, abs=1.01 * STEP)
    assert stop.rest == pytest.approx(begin + 0.49 / deceleration, abs=1.01 * STEP)
    longest = 0.06 + STEP
    expected = deceleration if deceleration * longest < 0.5 else 0.5 / longest
    assert stop.deceleration == pytest.approx(expected, rel=0.2)


def test_a_motion_that_goes_on_neither_reacts_nor_rests():
    times = np.arange(-0.5, 2.0, STEP)
    stop = judge_stop(times, np.full(times.shape, 0.5), 0.0, 1.0, 0.01)
    assert (stop.reaction, stop.rest, stop.deceleration) == (math.inf, math.inf, 0.0)


def test_a_motion_that_begins_again_is_not_at_rest():
    times, speeds = braking(0.1, 1.2)
    speeds[times > 1.5] = 0.4
    stop = judge_stop(times, speeds, 0.0, 2.0, 0.01)
    assert stop.rest == math.inf
    assert judge_stop(times, speeds, 0.0, 1.5, 0.01).rest < 0.6


def test_without_samples_nothing_has_happened():
    stop = judge_stop(np.zeros(0), np.zeros(0), 0.0, 1.0, 0.01)
    assert stop.reaction == stop.rest == math.inf


def test_largest_change_counts_within_the_time_only():
    times = np.array([0.0, 1.0, 2.0, 3.0])
    values = np.array([[0.0, 0.0], [1.0, 1.0], [1.0, 0.8], [9.0, 9.0]])
    assert largest_change(times, values, 0.5, 2.5) == pytest.approx(0.2)
    assert largest_change(times, values, 5.0, 6.0) == 0.0
