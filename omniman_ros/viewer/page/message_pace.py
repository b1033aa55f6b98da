"""Rate up to which the messages of one connection are read."""

#: Largest rate of messages of a connection in the long run [1/s].
#:
#: A page that drags something sends up to 60.
RATE = 200.0
#: Number of messages of a connection that may come at once: a page that connects sends many
BURST = 200
ROUND_OFF = 1e-6  #: Delay that does not count [s]


class MessagePace:
    """Tells when the next message of a connection may be read (a token bucket)."""

    def __init__(self, rate: float = RATE, burst: int = BURST) -> None:
        self._interval, self._reserve = 1.0 / rate, burst / rate
        self._spent_until = 0.0

    def delay(self, now: float) -> float:
        """Return how long to wait before the next message is read [s], and count it at `now`."""
        self._spent_until = max(self._spent_until, now) + self._interval
        delay = self._spent_until - self._reserve - now
        return delay if delay > ROUND_OFF else 0.0
