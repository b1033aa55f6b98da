import pytest

from omniman_ros.core.late_delivery import LONGEST_PERIOD, LateDelivery

TOLERANCE = 0.2
PERIOD = 0.05


def stream(judge, begin, seconds, ahead=0.0, delay=0.002):
    """Send a live stream by a clock that is ahead; return what is late."""
    return [
        judge.is_late(at + ahead, at + delay, TOLERANCE)
        for at in (begin + PERIOD * k for k in range(round(seconds / PERIOD)))
    ]


def repeated(judge, now, sent, count=1):
    """Deliver the last messages again that were sent until `sent`; return what is late."""
    return [
        judge.is_late(sent - PERIOD * k, now + 1e-4 * (count - k), TOLERANCE)
        for k in reversed(range(count))
    ]


def test_live_stream_is_not_late():
    assert not any(stream(LateDelivery(), 100.0, 5.0))


@pytest.mark.parametrize("ahead", [0.0, -7.0, 7.0])
@pytest.mark.parametrize("count", [1, 10])
def test_messages_that_are_repeated_after_a_break_are_late(ahead, count):
    judge = LateDelivery()
    stream(judge, 100.0, 5.0, ahead)
    assert all(repeated(judge, 110.0, 106.0 + ahead, count))
    assert not any(stream(judge, 110.1, 1.0, ahead)), "the sender goes on"


@pytest.mark.parametrize("count", [1, 10])
def test_messages_from_before_the_first_connection_are_late(count):
    assert all(repeated(LateDelivery(), 110.0, 106.0, count))


def test_stream_of_a_sender_whose_clock_is_behind_is_late_but_once():
    assert stream(LateDelivery(), 100.0, 5.0, ahead=-60.0) == [True] + 99 * [False]


def test_clock_of_a_sender_that_is_set_costs_one_message_at_most():
    judge = LateDelivery()
    for k, ahead in enumerate((0.0, 30.0, -30.0, 0.3, 0.0)):
        assert sum(stream(judge, 100.0 + 10 * k, 5.0, ahead)) <= 1


def test_single_messages_of_a_sender_whose_clock_is_behind_stay_late():
    judge, step = LateDelivery(), LONGEST_PERIOD + 0.1
    assert all(judge.is_late(100 + step * k, 160 + step * k, TOLERANCE) for k in range(5))
