"""What happened last, in words, and in which order among all that tell."""

import itertools

_order = itertools.count(1)

TROUBLE = ("a path", "the path", "a trajectory", "the trajectory", "a tool path")
"""What a warning in the diagnostics begins with."""
BEFORE = 0


class Teller:
    """Has a last word.

    Attributes:
        told: When it was said: larger is later, 0 before anything has happened.
    """

    _last = ""
    told = BEFORE

    @property
    def last(self) -> str:
        """What happened last, in words."""
        return self._last

    @last.setter
    def last(self, text: str) -> None:
        if text != self._last:  # what waits says so again and again
            self._last, self.told = text, next(_order)

    @property
    def troubled(self) -> bool:
        """Whether the last word is one of trouble."""
        return self._last.startswith(TROUBLE)
