"""A motion that waits: for a robot that becomes ready, and for what passes by itself."""

import pytest

from omniman_ros.core.pending_start import HANDOVER_TIME, WAIT_TIMEOUT, PendingStart, StartState
from omniman_ros.core.stream_monitor import StreamMonitor


class Waiting:
    """A pending motion, a monitor and a clock."""

    def __init__(self, source):
        self.now, self.started = 100.0, 0
        self.monitor = StreamMonitor(1.2)
        self.monitor.update_source(source)
        self.pending = PendingStart(lambda: self.now, self.monitor)
        self.pending.put(self.start)

    def start(self):
        self.started += 1

    def attempt(self):
        attempt = self.pending.attempt(self.monitor.blocking_reason, lambda: "")
        return attempt.state, attempt.reason


@pytest.mark.parametrize(
    ("source", "why", "patience"),
    [("mpc", "mpc drives", HANDOVER_TIME), ("", "no platform_controller", WAIT_TIMEOUT)],
)
def test_a_motion_waits_for_what_passes_but_not_for_long(source, why, patience):
    it = Waiting(source)
    state, reason = it.attempt()
    assert state is StartState.WAITING and why in reason
    it.now += patience - 0.01
    assert it.attempt()[0] is StartState.WAITING
    it.now += 0.02
    state, reason = it.attempt()
    assert state is StartState.REFUSED and why in reason
    it.monitor.update_source("none")
    assert it.attempt()[0] is StartState.NOTHING_PENDING and not it.started


@pytest.mark.parametrize("source", ["mpc", ""])
def test_its_timeout_begins_with_simulated_time(source):
    it = Waiting(source)
    it.now = 0.0  # as before the first time on /clock
    it.pending.put(it.start)
    it.attempt()
    it.now = 1000.0
    assert it.attempt()[0] is StartState.WAITING
    it.now += WAIT_TIMEOUT + 0.1
    assert it.attempt()[0] is StartState.REFUSED and not it.started


def test_it_starts_when_the_other_motion_has_passed():
    it = Waiting("mpc")
    it.attempt()
    it.now += 0.2
    it.monitor.update_source("none")
    assert it.attempt()[0] is StartState.STARTED and it.started == 1


@pytest.mark.parametrize("source", ["stop", "cmd_vel"])
def test_it_waits_neither_for_a_stop_nor_for_who_drives_by_twists(source):
    assert Waiting(source).attempt()[0] is StartState.REFUSED


def test_a_stop_refuses_it_while_it_waits():
    it = Waiting("mpc")
    it.attempt()
    it.monitor.update_emergency(True)
    assert it.attempt() == (StartState.REFUSED, "emergency_stop is true")
