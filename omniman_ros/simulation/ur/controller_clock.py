"""The time on which a simulated controller runs: real, or simulated and given by another."""

import math
import threading
import time
from typing import Protocol

CATCH_UP_PERIOD = 0.002  #: Period of cycles that are late on real time [s]
MAX_WAIT = 0.1  #: Longest wait for simulated time before the caller may look at other things [s]


class ControllerClock(Protocol):
    """Clock of a controller, which can be waited for."""

    def now(self) -> float:
        """Return the time [s]."""

    def wait(self, until: float) -> None:
        """Wait until a time [s], or less."""

    def give_way(self) -> None:
        """Let a client that was delayed as well catch up, between two cycles that are late."""


class MonotonicClock:
    """The monotonic clock of the machine."""

    def now(self) -> float:
        """Return the time [s]."""
        return time.monotonic()

    def wait(self, until: float) -> None:
        """Wait until a time [s]."""
        time.sleep(max(until - time.monotonic(), 0.0))

    def give_way(self) -> None:
        """Wait for `CATCH_UP_PERIOD`."""
        time.sleep(CATCH_UP_PERIOD)


class SimulatedTime:
    """Time that passes when another thread says so."""

    def __init__(self) -> None:
        self._now = -math.inf
        self._changed = threading.Condition()

    def now(self) -> float:
        """Return the time that was last given [s]; minus infinity before the first one."""
        return self._now

    def set(self, now: float) -> None:
        """Give the time [s]."""
        with self._changed:
            self._now = now
            self._changed.notify_all()

    def wait(self, until: float) -> None:
        """Wait until the given time is `until` [s], up to `MAX_WAIT` of real time."""
        with self._changed:
            self._changed.wait_for(lambda: self._now >= until, MAX_WAIT)

    def give_way(self) -> None:
        """Do nothing: simulated time waits for this controller and for its clients."""
