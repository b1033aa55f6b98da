import math

import numpy as np
import pytest

from omniman_ros.core.errors import InputError
from omniman_ros.core.motion_limit import MotionLimit, MotionLimitParameters

USED = MotionLimitParameters(use=True, timeout=0.2, silent_speed=0.1)


def test_without_a_monitor_nothing_is_limited():
    limit = MotionLimit(MotionLimitParameters())
    limit.update(0.0, 1.0, 1.0)
    assert limit.fraction(1.0) == 1.0
    assert not limit.is_silent(9.0)


def test_a_limit_holds_until_it_is_stale_and_then_the_speed_is_that_of_silence():
    limit = MotionLimit(USED)
    assert limit.fraction(0.0) == 0.1
    assert limit.is_silent(0.0)
    limit.update(0.7, 0.95, 1.0)
    assert limit.fraction(1.14) == 0.7
    assert limit.fraction(1.16) == 0.1


@pytest.mark.parametrize("fraction", [math.nan, math.inf, -0.1, 1.1])
def test_what_is_no_share_is_refused_and_not_fresh(fraction):
    limit = MotionLimit(USED)
    with pytest.raises(InputError, match="0 to 1"):
        limit.update(fraction, 1.0, 1.0)
    assert limit.is_silent(1.0)


def test_late_and_out_of_order_limits_are_refused():
    limit = MotionLimit(USED)
    with pytest.raises(InputError, match="stale"):
        limit.update(1.0, 0.7, 1.0)
    limit.update(0.2, 0.99, 1.0)
    with pytest.raises(InputError, match="out of order"):
        limit.update(1.0, 0.95, 1.0)
    assert limit.fraction(1.0) == 0.2


def test_after_time_went_back_an_old_limit_does_not_count():
    limit = MotionLimit(USED)
    limit.update(0.8, 100.0, 100.0)
    assert limit.fraction(5.0) == 0.1
    limit.update(0.9, 5.0, 5.0)
    assert limit.fraction(5.0) == 0.9


def test_a_limit_from_a_clock_that_is_ahead_counts_as_sent_now():
    limit = MotionLimit(USED)
    limit.update(0.6, 1.5, 1.0)
    assert (limit.fraction(1.19), limit.fraction(1.21)) == (0.6, 0.1)


def test_of_two_publishers_the_smaller_share_counts_until_it_is_stale():
    limit = MotionLimit(USED)
    limit.update(0.3, 0.9, 1.0)
    limit.update(1.0, 1.0, 1.0, publishers=2)
    assert limit.fraction(1.09) == 0.3
    assert limit.fraction(1.11) == 1.0


def test_the_last_message_of_a_publisher_that_has_left_does_not_loosen_the_limit():
    limit = MotionLimit(USED)
    limit.update(0.3, 1.0, 1.0, publishers=2)
    limit.update(1.0, 1.01, 1.01, publishers=1)
    assert limit.fraction(1.01) == 0.3
    limit.update(0.8, 1.3, 1.3)
    assert limit.fraction(1.3) == 0.8
    limit.update(0.9, 1.31, 1.31)
    assert limit.fraction(1.31) == 0.9


def test_a_stricter_publisher_whose_messages_are_older_counts():
    limit = MotionLimit(USED)
    limit.update(1.0, 1.0, 1.0, publishers=2)
    limit.update(0.2, 0.95, 1.01, publishers=2)
    assert limit.fraction(1.01) == 0.2


@pytest.mark.parametrize("seed", range(5))
def test_whatever_publishers_send_the_smallest_fresh_share_counts(seed):
    """The judge keeps all messages."""
    rng = np.random.default_rng(seed)
    limit, sent = MotionLimit(USED), []
    for now in np.cumsum(rng.uniform(0.0, 0.05, 300)):
        message = now - rng.uniform(0.0, 0.1), rng.uniform()
        sent.append(message)
        limit.update(message[1], message[0], now, publishers=2)
        later = now + rng.uniform(0.0, 0.25)
        fresh = [fraction for time, fraction in sent if later - time <= 0.2]
        assert limit.fraction(later) == min(fresh, default=0.1)
