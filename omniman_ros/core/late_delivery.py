"""Detection of messages without a stamp that the middleware has delivered late."""

import math

LONGEST_PERIOD = 1.0
"""Longest time between two messages of a live stream [s]."""
JITTER = 0.5
"""Largest deviation of the distance of two arrivals from that of sending, as a share of it."""


class LateDelivery:
    """Tells what waited on its way from what a sender says now.

    When a broken connection comes back, a reliable publisher repeats its last messages, however
    old they are. The middleware tells when a message was sent, by the sender's clock. That clock
    may be wrong: messages that keep arriving at the distances at which they were sent are not
    late, but show by how much it is. Those that are repeated arrive at once.
    """

    def __init__(self) -> None:
        self._offset = 0.0
        self._sent = self._arrival = -math.inf

    def is_late(self, sent: float, now: float, tolerance: float) -> bool:
        """Return whether a message was delivered late.

        Args:
            sent: Time of sending, by the sender's clock as far as its offset is not known [s].
            now: Time of arrival [s].
            tolerance: Delay up to which a message is not late [s].
        """
        distance, elapsed = sent - self._sent, now - self._arrival
        self._sent, self._arrival = sent, now
        delay = now - sent
        if delay <= self._offset + tolerance:
            self._offset = min(self._offset, delay)
            return False
        is_live = 0.0 < distance <= LONGEST_PERIOD and abs(elapsed - distance) <= JITTER * distance
        if is_live:
            self._offset = delay
        return not is_live
