"""The policy of the automatic start, without the nodes that follow it."""

import pytest

from omniman_ros.nodes.hardware_node import MAX_RETRIES, RETRY_PERIOD, AutomaticStart

NOW = 50.0


@pytest.fixture
def start():
    return AutomaticStart()


def test_the_first_attempt_is_due_at_once_and_the_next_after_a_period(start):
    assert start.is_due(NOW)
    start.postpone(NOW)
    assert not start.is_due(NOW + RETRY_PERIOD - 1e-3)
    assert start.is_due(NOW + RETRY_PERIOD)


def test_missing_hardware_is_waited_for_without_a_limit(start):
    for k in range(10 * MAX_RETRIES):
        start.postpone(NOW + RETRY_PERIOD * k)
    assert start.is_retrying


def test_a_fault_leads_to_a_bounded_number_of_retries_each_a_period_later(start):
    counts = []
    while start.is_retrying:
        counts.append(start.retry(NOW))
        assert not start.is_due(NOW)
        assert start.is_due(NOW + RETRY_PERIOD)
    assert counts == [f"{k} of {MAX_RETRIES}" for k in range(1, MAX_RETRIES + 1)]


def test_what_has_ended_neither_starts_nor_retries_again(start):
    start.end()
    start.faults = 0
    start.postpone(NOW)
    assert not start.is_due(NOW + RETRY_PERIOD)
    assert not start.is_retrying
