import math

import pytest

from omniman_ros.viewer.settling import PATIENCE, QUIET, Settling


def test_what_is_typed_is_sent_once_when_it_has_rested():
    number = Settling(0.0, 1000.0)
    sent = []
    for i, typed in enumerate((1.0, 12.0, 123.0)):
        number.ask(typed)
        sent.append(number.step(10.0 + 0.9 * QUIET * i))
    assert sent == [None, None, None]
    rested = 10.0 + 0.9 * QUIET * 2 + QUIET
    assert number.step(rested - 0.01) is None
    assert [number.step(rested), number.step(rested + 0.1)] == [123.0, None]


def test_the_nodes_value_is_shown_again_some_time_after_the_last_change():
    number = Settling(0.0, 1.0)
    assert number.is_open(0.0)
    number.ask(0.5)
    assert not number.is_open(10.0)
    number.step(10.0)
    number.step(10.0 + QUIET)
    assert not number.is_open(10.0 + QUIET + 0.99 * PATIENCE)
    assert number.is_open(10.0 + QUIET + PATIENCE)


@pytest.mark.parametrize("garbage", [math.nan, math.inf, -0.1, 1.1, "0.5", None, [0.5]])
def test_what_is_no_number_that_the_node_takes_is_dropped(garbage):
    number = Settling(0.0, 1.0)
    number.ask(0.5)
    number.ask(garbage)
    number.step(10.0)
    assert number.step(10.0 + QUIET) is None
    assert number.is_open(10.0 + QUIET + PATIENCE)


def test_a_number_that_stands_for_something_else_forgets_what_was_asked_for():
    number = Settling(0.0, 1.0)
    number.ask(0.5)
    number.step(10.0)
    number.reopen()
    assert number.is_open(10.0)
    assert number.step(10.0 + QUIET) is None
