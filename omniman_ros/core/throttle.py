"""Rate limit for warnings, separate for each subject."""


class Throttle:
    """Allows one event of a subject per period, and counts those it suppresses.

    Args:
        period: Shortest time between two allowed events of one subject [s].

    Attributes:
        counts: Number of events of each subject, suppressed ones included.
    """

    def __init__(self, period: float) -> None:
        self._period = period
        self._last: dict[str, float] = {}
        self._suppressed: dict[str, int] = {}
        self.counts: dict[str, int] = {}

    def allow(self, subject: str, now: float) -> int | None:
        """Count an event at `now` [s], and decide whether it is allowed.

        Returns:
            Number of events suppressed since the last allowed event; None if this event is
            suppressed, too.
        """
        self.counts[subject] = self.counts.get(subject, 0) + 1
        last = self._last.get(subject)
        if last is not None and 0.0 <= now - last < self._period:
            self._suppressed[subject] = self._suppressed.get(subject, 0) + 1
            return None
        self._last[subject] = now
        return self._suppressed.pop(subject, 0)
