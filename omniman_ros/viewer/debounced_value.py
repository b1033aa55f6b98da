"""A number that both the page and a node can set: entries are sent once they have settled."""

from dataclasses import dataclass

SETTLING_TIME = 0.4  #: Time without a change after which an entered value is sent [s]
ECHO_TIME = 2.0  #: Time after sending during which the page keeps displaying the entered value [s]


@dataclass
class DebouncedValue:
    """An entered number that is sent once it has settled.

    A typed number arrives digit by digit, and a slider's value at every step: only the intended
    value is to reach the robot. The node's value is not displayed right after an entry, or it
    would overwrite the next digit. All times are on one steady clock.

    Args:
        low, high: Range that the node accepts; an entry outside of it is discarded.
    """

    low: float
    high: float

    def __post_init__(self) -> None:
        self._requested: float | None = None
        self._is_new = False
        self._changed_at = -float("inf")
        self._sent = True

    def request(self, value: object) -> None:
        """Store an entry of a page; may be called from any thread."""
        # NaN is within no range.
        if isinstance(value, int | float) and self.low <= value <= self.high:
            self._requested = float(value)
        else:
            self._requested = None
        self._is_new = True

    def step(self, now: float) -> float | None:
        """Return the value to send at `now` [s], once per entry; None if there is none."""
        if self._is_new:
            self._is_new, self._changed_at, self._sent = False, now, False
        if self._sent or now - self._changed_at < SETTLING_TIME:
            return None
        self._sent = True
        return self._requested

    def is_idle(self, now: float) -> bool:
        """Return whether the node's value may be displayed: there is no recent entry."""
        settled_since = now - self._changed_at
        return not self._is_new and self._sent and settled_since >= SETTLING_TIME + ECHO_TIME

    def reset(self) -> None:
        """Discard the entry, because the number now stands for something else."""
        self._is_new, self._sent, self._changed_at = False, True, -float("inf")
