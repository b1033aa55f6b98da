"""Limit of the speed that a collision monitor sets, as those who move the robot receive it."""

from dataclasses import dataclass

from omniman_ros.core.errors import InputError
from omniman_ros.core.parameters import parameter

NEVER = float("-inf")
"""Time of an event that has not happened [s]."""


@dataclass(frozen=True, kw_only=True)
class MotionLimitParameters:
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
    """Share of the speed limits that a collision monitor allows, while its messages are fresh.

    A limit is never latched: the motion goes on as soon as it allows that.

    Args:
        parameters: Whether there is a limit, and what applies without its messages.

    Attributes:
        parameters: As above; may be changed at any time.
    """

    def __init__(self, parameters: MotionLimitParameters) -> None:
        self.parameters = parameters
        self._share = 0.0
        self._time = NEVER

    def update(self, share: float, sent: float, now: float) -> None:
        """Set the limit.

        Args:
            share: Share of the speed limits, 0 to 1.
            sent: When it was sent [s]; if that is ahead of now, now counts.
            now: Time of arrival [s].

        Raises:
            InputError: The share is not a number from 0 to 1, or the limit is stale or older than
                the last one.
        """
        if not 0.0 <= share <= 1.0:
            raise InputError(f"the share {share} is not 0 to 1")
        time = min(sent, now)
        if now - time > self.parameters.timeout:
            raise InputError(f"stale, {now - time:.3f} s old")
        if self._is_fresh(now) and time < self._time:
            raise InputError(f"out of order, {self._time - time:.3f} s before the last one")
        self._share, self._time = share, time

    def _is_fresh(self, now: float) -> bool:
        """Return whether the last limit counts; not if time has gone back behind it."""
        timeout = self.parameters.timeout
        return -timeout <= now - self._time <= timeout

    def is_silent(self, now: float) -> bool:
        """Return whether a limit is expected at a time [s], and there is no fresh one."""
        return self.parameters.use and not self._is_fresh(now)

    def share(self, now: float) -> float:
        """Return the share of the speed limits that is allowed at a time [s], 0 to 1."""
        if not self.parameters.use:
            return 1.0
        return self._share if self._is_fresh(now) else self.parameters.silent_speed
