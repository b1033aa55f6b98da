import math

import pytest

from omniman_ros.viewer.debounced_value import ECHO_TIME, SETTLING_TIME, DebouncedValue


def test_an_entry_is_sent_once_after_it_has_settled():
    number = DebouncedValue(0.0, 1000.0)
    sent = []
    for i, typed in enumerate((1.0, 12.0, 123.0)):
        number.request(typed)
        sent.append(number.step(10.0 + 0.9 * SETTLING_TIME * i))
    assert sent == [None, None, None]
    rested = 10.0 + 0.9 * SETTLING_TIME * 2 + SETTLING_TIME
    assert number.step(rested - 0.01) is None
    assert [number.step(rested), number.step(rested + 0.1)] == [123.0, None]


def test_the_nodes_value_is_displayed_again_after_the_echo_time():
    number = DebouncedValue(0.0, 1.0)
    assert number.is_idle(0.0)
    number.request(0.5)
    assert not number.is_idle(10.0)
    number.step(10.0)
    number.step(10.0 + SETTLING_TIME)
    assert not number.is_idle(10.0 + SETTLING_TIME + 0.99 * ECHO_TIME)
    assert number.is_idle(10.0 + SETTLING_TIME + ECHO_TIME)


@pytest.mark.parametrize("garbage", [math.nan, math.inf, -0.1, 1.1, "0.5", None, [0.5]])
def test_an_entry_out_of_range_is_dropped(garbage):
    number = DebouncedValue(0.0, 1.0)
    number.request(0.5)
    number.request(garbage)
    number.step(10.0)
    assert number.step(10.0 + SETTLING_TIME) is None
    assert number.is_idle(10.0 + SETTLING_TIME + ECHO_TIME)


def test_a_reset_discards_the_entry():
    number = DebouncedValue(0.0, 1.0)
    number.request(0.5)
    number.step(10.0)
    number.reset()
    assert number.is_idle(10.0)
    assert number.step(10.0 + SETTLING_TIME) is None
