"""Rate up to which the messages of one connection are read."""

RATE = 200.0  #: Largest rate of messages of a connection [1/s]; a page that drags sends 60
BURST = 200  #: Number of messages of a connection that may come at once, as when it begins
ROUND_OFF = 1e-6  #: Delay that does not count [s]


class MessagePace:
    """Tells when the next message of a connection may be read (a token bucket)."""

    def __init__(self) -> None:
        self._spent_until = 0.0

    def delay(self, now: float) -> float:
        """Return how long to wait before the next message is read [s], and count it at `now`."""
        self._spent_until = max(self._spent_until, now) + 1.0 / RATE
        delay = self._spent_until - BURST / RATE - now
        return delay if delay > ROUND_OFF else 0.0
