"""Simulated controller on given time: cycles run as far as time has come, and no further."""

import threading

import pytest

from omniman_ros.simulation.ur.arm import CYCLE, UrArmParameters
from omniman_ros.simulation.ur.controller_clock import SimulatedTime
from omniman_ros.simulation.ur.controller_server import ControllerServer
from omniman_ros.simulation.ur.port_parameters import UrPortParameters

pytestmark = pytest.mark.processes  # the controller runs in a thread

FREE = UrPortParameters(dashboard=0, primary=0, secondary=0, realtime=0, rtde=0)
TIMEOUT = 20.0  #: Real time in which the thread runs the cycles that are due [s]


class CountingServer(ControllerServer):
    """A controller that notes the times of its cycles."""

    def __init__(self, pace):
        self.times, self.has_run = [], threading.Condition()
        super().__init__(UrArmParameters(), FREE, pace)

    def cycle(self, now, due_cycles=1):
        super().cycle(now, due_cycles)
        with self.has_run:
            self.times.append(now - self.lost)
            self.has_run.notify_all()

    def until(self, count):
        with self.has_run:
            assert self.has_run.wait_for(lambda: len(self.times) >= count, TIMEOUT)


def test_cycles_follow_simulated_time_and_stand_with_it():
    pace = SimulatedTime()
    pace.set(100.0)
    server = CountingServer(pace)
    server.start()
    try:
        server.until(1)
        for k in range(1, 50):
            pace.set(100.0 + k * CYCLE + 1e-6)
            server.until(k + 1)
        # Were time not waited for, the next cycle would run at once.
        pace.wait(pace.now() + CYCLE)
        assert len(server.times) == 50
        assert server.times == pytest.approx([100.0 + k * CYCLE for k in range(50)], abs=1e-9)
        assert server.done == pytest.approx(100.0 + 50 * CYCLE, abs=1e-9)
    finally:
        server.close()


class CountingTime(SimulatedTime):
    """Simulated time that counts how often it was waited for."""

    waits = 0

    def wait(self, until):
        self.waits += 1
        super().wait(until)


def test_cycles_that_are_late_run_at_once_because_time_waits_for_them():
    pace = CountingTime()
    pace.set(0.0)
    server = CountingServer(pace)
    server.start()
    try:
        server.until(1)
        waits = pace.waits
        pace.set(0.5)
        server.until(round(0.5 / CYCLE))
        assert pace.waits - waits <= 2
    finally:
        server.close()


def test_cycles_go_on_where_simulated_time_begins_anew():
    pace = SimulatedTime()
    pace.set(100.0)
    server = CountingServer(pace)
    server.start()
    try:
        server.until(1)
        for k in range(5):
            pace.set(1.0 + k * CYCLE + 1e-6)
            server.until(k + 2)
        assert server.times == pytest.approx([100.0 + k * CYCLE for k in range(6)], abs=1e-3)
    finally:
        server.close()


def test_the_first_cycle_is_that_of_the_first_known_time():
    """A controller that joins later has no cycles to catch up with, which would all be late."""
    pace = SimulatedTime()
    server = CountingServer(pace)
    server.start()
    try:
        pace.wait(0.0)  # cycles before the first time would run meanwhile
        pace.set(0.9)
        server.until(1)
        assert server.times == [0.9]
        assert server.done == pytest.approx(0.9 + CYCLE)
    finally:
        server.close()


@pytest.mark.parametrize("begun", [True, False])
def test_the_thread_ends_while_time_stands(begun):
    pace = SimulatedTime()
    if begun:
        pace.set(0.0)
    server = CountingServer(pace)
    server.start()
    if begun:
        server.until(1)
    server.close()
    assert not server._thread.is_alive()
