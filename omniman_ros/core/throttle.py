"""Rate limit for warnings, one a subject."""


class Throttle:
    """Lets a subject through once a period and counts what it holds back.

    Args:
        period: Shortest time between two of one subject [s].
    """

    def __init__(self, period: float) -> None:
        self._period = period
        self._last: dict[str, float] = {}
        self._held: dict[str, int] = {}
        self.counts: dict[str, int] = {}

    def allow(self, subject: str, now: float) -> int | None:
        """Return how many were held back since the last, or None if this one is held back too.

        `counts` has the total of each subject.
        """
        self.counts[subject] = self.counts.get(subject, 0) + 1
        last = self._last.get(subject)
        if last is not None and 0.0 <= now - last < self._period:
            self._held[subject] = self._held.get(subject, 0) + 1
            return None
        self._last[subject] = now
        return self._held.pop(subject, 0)
