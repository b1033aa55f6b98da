"""A value that a page sets and a node has: between the two goes neither too much nor an echo."""

from dataclasses import dataclass

QUIET = 0.4
"""What is typed or dragged is sent when it has rested for so long [s]."""
PATIENCE = 2.0
"""So long after that the page shows what was asked for; then what the node has [s]."""


@dataclass
class Settling:
    """One number.

    What is typed comes digit by digit, and a slider's value at each step: a robot is to get what
    is meant. What the node then has is not shown at once, or it would fall into the next digit.
    All times are on one steady clock.

    Args:
        low, high: What the node takes; anything else is dropped.
    """

    low: float
    high: float

    def __post_init__(self) -> None:
        self._asked: float | None = None
        self._new = False
        self._changed_at = -float("inf")
        self._sent = True

    def ask(self, value: object) -> None:
        """Take in what a page says; from any thread."""
        # NaN is within nothing.
        if isinstance(value, int | float) and self.low <= value <= self.high:
            self._asked = float(value)
        else:
            self._asked = None
        self._new = True

    def step(self, now: float) -> float | None:
        """What is to be sent now, once; None for nothing."""
        if self._new:
            self._new, self._changed_at, self._sent = False, now, False
        if self._sent or now - self._changed_at < QUIET:
            return None
        self._sent = True
        return self._asked

    def is_open(self, now: float) -> bool:
        """Whether the node's value may be shown: nothing was asked for just now."""
        return not self._new and self._sent and now - self._changed_at >= QUIET + PATIENCE

    def reopen(self) -> None:
        """Forget what was asked for: the number now stands for something else."""
        self._new, self._sent, self._changed_at = False, True, -float("inf")
