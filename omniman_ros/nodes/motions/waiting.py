"""A motion that waits until the robot is ready for it."""

from collections.abc import Callable

from omniman_ros.core.control import ControlWatch
from omniman_ros.core.errors import InputError

PATIENCE = 5.0
"""How long a motion waits for the robot to come to rest [s]."""


class Waiting:
    """At most one motion that waits.

    Args:
        clock: Time [s].
        watch: Who drives, and who is stopped.
    """

    def __init__(self, clock: Callable[[], float], watch: ControlWatch) -> None:
        self._clock, self._watch = clock, watch
        self._begin: Callable[[], None] | None = None
        self._until = 0.0

    def __bool__(self) -> bool:
        return self._begin is not None

    def put(self, begin: Callable[[], None]) -> None:
        """Let a motion wait in place of any other."""
        self._begin = begin
        self.extend()

    def extend(self) -> None:
        """Let it wait its whole time from now on."""
        now = self._clock()
        self._until = now + PATIENCE + self._watch.wait(now)

    def drop(self) -> bool:
        """Forget it; returns whether there was one."""
        there, self._begin = self._begin is not None, None
        return there

    def attempt(self, obstacle: str, not_yet: Callable[[], str]) -> tuple[str, str]:
        """Begin it, if that can be.

        Args:
            obstacle: Why it never will, or an empty string.
            not_yet: Tells why it cannot now, or an empty string.

        Returns:
            Why it never will, and what it waits for; both empty if it has begun.
        """
        if self._begin is None:
            return "", ""
        now, why = self._clock(), obstacle
        if not why:
            why = not_yet()
            if why and now < self._until:
                return "", why
        begin, self._begin = self._begin, None
        if not why:
            try:
                begin()
            except InputError as error:
                why = str(error)
        return why, ""
