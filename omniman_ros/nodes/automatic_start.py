"""When hardware is started automatically, and whether a fault of it leads to another start."""

import math

RETRY_PERIOD = 2.0  #: Time between two automatic attempts to start [s]
MAX_RETRIES = 5  #: Number of faults after which hardware that has not moved yet is started again


class AutomaticStart:
    """Decides when hardware is started, until it may have moved or somebody has taken it down.

    Hardware that is missing is waited for without a limit. A fault of hardware that is there, be
    it enabled or not, leads to another start, but at most :data:`MAX_RETRIES` times: a fault that
    stays is a stop.

    Attributes:
        faults: Number of faults since the first attempt or the last reset.
    """

    def __init__(self) -> None:
        self.faults = 0
        self._next_attempt = -math.inf
        self._has_ended = False

    @property
    def is_retrying(self) -> bool:
        """Whether a fault leads to another start; otherwise it is a stop."""
        return not self._has_ended and self.faults < MAX_RETRIES

    def is_due(self, now: float) -> bool:
        """Return whether an attempt is to be made at the time `now` [s]."""
        return not self._has_ended and now >= self._next_attempt

    def postpone(self, now: float) -> None:
        """Make the next attempt :data:`RETRY_PERIOD` after the time `now` [s]."""
        self._next_attempt = now + RETRY_PERIOD

    def retry(self, now: float) -> str:
        """Count a fault at `now` [s], postpone the next attempt, and return "n of m"."""
        self.faults += 1
        self.postpone(now)
        return f"{self.faults} of {MAX_RETRIES}"

    def end(self) -> None:
        """End the automatic start for good."""
        self._has_ended = True
