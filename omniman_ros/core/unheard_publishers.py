"""Publishers that came and went, and of which no message was received.

A publisher of one message may end before a subscription is connected to it: its message is lost,
and neither side is told. The middleware tells that a publisher has come and gone.
"""

#: Longest life of a publisher that counts as one that came to send one message [s]
SHORT_VISIT = 5.0
#: Time by which a message and the news of its publisher may come in the wrong order [s]
LATE_ORDER = 0.1


class UnheardPublishers:
    """Finds short visits of publishers that were not heard.

    The middleware does not tell which publisher has gone: it is taken for the latest that was not
    heard, if that one came within `SHORT_VISIT`. All times are of one clock, in seconds.
    """

    def __init__(self) -> None:
        self._unheard: list[float] = []
        self._heard: list[float] = []
        self._gone: list[float] = []

    def appear(self, now: float) -> None:
        """Register a publisher that is there from now on."""
        self._heard = [time for time in self._heard if 0.0 <= now - time < LATE_ORDER]
        if self._heard:
            self._heard.pop()
        else:
            self._unheard.append(now)

    def hear(self, now: float) -> None:
        """Register the first message of a publisher."""
        if self._gone:
            self._gone.pop()
        elif self._unheard:
            self._unheard.pop()
        else:
            self._heard.append(now)

    def vanish(self, now: float, present: int) -> None:
        """Register that a publisher has gone, and how many are present."""
        if self._unheard and 0.0 <= now - self._unheard[-1] <= SHORT_VISIT:
            self._unheard.pop()
            self._gone.append(now)
        del self._unheard[: max(len(self._unheard) - present, 0)]

    def missed(self, now: float) -> bool:
        """Return whether one was not heard until a while after it had gone; told once."""
        waiting = [time for time in self._gone if 0.0 <= now - time < LATE_ORDER]
        is_missed = len(waiting) < len(self._gone)
        self._gone = waiting
        return is_missed
