"""Numbers of motions and their outcomes, for action clients that wait for the end of one."""

REMEMBERED_OUTCOMES = 20  #: Number of latest outcomes that are remembered


class MotionLedger:
    """Numbers accepted motions and remembers how they ended.

    Attributes:
        accepted: Number of the motion that was accepted last; 0 before the first.
        started: Number of the motion that was started last; 0 before the first.
    """

    def __init__(self) -> None:
        self.accepted = self.started = 0
        self._outcomes: dict[int, str] = {}

    def accept(self) -> None:
        """Give the next number to a motion that was accepted."""
        self.accepted += 1

    def start(self) -> None:
        """Note that the motion that was accepted last has started."""
        self.started = self.accepted

    def close(self, outcome: str, motion: int) -> None:
        """Record how a motion ended: an empty outcome means that it arrived."""
        self._outcomes[motion] = outcome
        while len(self._outcomes) > REMEMBERED_OUTCOMES:
            del self._outcomes[min(self._outcomes)]

    def outcome(self, motion: int) -> str:
        """Return why a motion ended; empty if it arrived."""
        return self._outcomes.get(motion, "refused")

    def outcome_so_far(self, motion: int, *, is_driven: bool, is_pending: bool) -> str | None:
        """Return why a motion ended; empty if it arrived; None while it waits or goes on."""
        under_way = is_driven and motion == self.started
        waits = is_pending and motion == self.accepted != self.started
        return None if under_way or waits else self.outcome(motion)
