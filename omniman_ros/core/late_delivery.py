"""Detection of messages without a stamp that the middleware has delivered late."""

import math

LONGEST_PERIOD = 1.0  #: Longest time between two messages of a live stream [s]
#: Largest difference between the intervals of arrival and sending, as a fraction of the latter
JITTER = 0.5


class LateDelivery:
    """Distinguishes messages that were delayed on their way from those that were just sent.

    When a broken connection is restored, a reliable publisher repeats its last messages, however
    old they are. The middleware reports when a message was sent, by the sender's clock. That clock
    may be wrong: messages that keep arriving at the intervals at which they were sent are not
    late, but show by how much it is wrong. Repeated messages arrive all at once.
    """

    def __init__(self) -> None:
        self._offset = 0.0
        self._sent = self._arrival = -math.inf

    def is_late(self, sent: float, now: float, tolerance: float) -> bool:
        """Return whether a message was delivered late.

        Args:
            sent: Time of sending by the sender's clock, whose offset is unknown [s].
            tolerance: Delay up to which a message is not late [s].
        """
        interval, elapsed = sent - self._sent, now - self._arrival
        self._sent, self._arrival = sent, now
        delay = now - sent
        if delay <= self._offset + tolerance:
            self._offset = min(self._offset, delay)
            return False
        is_live = 0.0 < interval <= LONGEST_PERIOD and abs(elapsed - interval) <= JITTER * interval
        if is_live:
            self._offset = delay
        return not is_live
