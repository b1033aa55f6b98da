"""Limit of the speed that a collision monitor sets, as those who move the robot receive it."""

from bisect import insort
from dataclasses import dataclass

from omniman_ros.core.errors import InputError
from omniman_ros.core.parameters import parameter
from omniman_ros.core.validated import Validated

NEVER = float("-inf")  #: Time of an event that has not happened [s]


@dataclass(frozen=True, kw_only=True)
class MotionLimitParameters(Validated):
    """Parameters of the limit that comes from `collision_monitor`."""

    use: bool = parameter(
        False,
        "Whether the node `collision_monitor` limits the speed; without its messages, "
        "`silent_speed` applies.",
    )
    timeout: float = parameter(
        0.2, "Age from which the last limit is stale.", unit="s", low=0.02, high=10.0
    )
    silent_speed: float = parameter(
        0.0,
        "Share of the speed limits that is left while there is no fresh limit; 0: stop.",
        low=0.0,
        high=1.0,
    )


class MotionLimit:
    """Fraction of the speed limits that a collision monitor allows, while its messages are fresh.

    A limit is never latched: the motion goes on as soon as it allows that. Where there are several
    publishers, whose messages cannot be told apart, the smallest fraction of all fresh messages
    counts: no publisher can loosen the limit of another one.
    """

    def __init__(self, parameters: MotionLimitParameters) -> None:
        self.parameters = parameters
        # Times and fractions of the messages that count, both rising: a message that allows more
        # than a later one never will.
        self._kept: list[tuple[float, float]] = []
        self._shared = NEVER

    def update(self, fraction: float, sent: float, now: float, publishers: int = 1) -> None:
        """Set the limit.

        Args:
            sent: When it was sent [s]; if that is ahead of now, now counts.
            publishers: Number of publishers from which it may have come.

        Raises:
            InputError: The share is not a number from 0 to 1, or the limit is stale or, with a
                single publisher, older than the last one.
        """
        if not 0.0 <= fraction <= 1.0:
            raise InputError(f"the share {fraction} is not 0 to 1")
        time = min(sent, now)
        if now - time > self.parameters.timeout:
            raise InputError(f"stale, {now - time:.3f} s old")
        if publishers > 1:
            self._shared = now
        if abs(now - self._shared) > self.parameters.timeout:
            newest = self._kept[-1][0] if self._fresh(now) else NEVER
            if time < newest:
                raise InputError(f"out of order, {newest - time:.3f} s before the last one")
            self._kept = [(time, fraction)]
            return
        self._kept = [kept for kept in self._fresh(now) if kept[0] > time or kept[1] < fraction]
        if not any(kept[0] >= time and kept[1] <= fraction for kept in self._kept):
            insort(self._kept, (time, fraction))

    def _fresh(self, now: float) -> list[tuple[float, float]]:
        timeout = self.parameters.timeout
        return [kept for kept in self._kept if -timeout <= now - kept[0] <= timeout]

    def is_silent(self, now: float) -> bool:
        """Return whether a limit is expected at a time [s], and there is no fresh one."""
        return self.parameters.use and not self._fresh(now)

    def fraction(self, now: float) -> float:
        """Return the fraction of the speed limits that is allowed at a time [s], 0 to 1."""
        if not self.parameters.use:
            return 1.0
        fresh = self._fresh(now)
        return fresh[0][1] if fresh else self.parameters.silent_speed
