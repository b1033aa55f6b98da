"""A motion that was accepted and waits until the robot is ready for it."""

import enum
from collections.abc import Callable
from dataclasses import dataclass

from omniman_ros.core.errors import InputError
from omniman_ros.core.stream_monitor import StreamMonitor

WAIT_TIMEOUT = 5.0  #: Longest time for which a motion waits until the robot can start it [s]
HANDOVER_TIME = 1.0  #: Longest time for which it waits for the end of another source's motion [s]


class StartState(enum.Enum):
    """Outcome of an attempt to start a pending motion."""

    NOTHING_PENDING = "nothing pending"
    WAITING = "waiting"
    REFUSED = "refused"
    STARTED = "started"


@dataclass(frozen=True)
class StartAttempt:
    """Result of :meth:`PendingStart.attempt`."""

    state: StartState  #: Outcome of the attempt
    reason: str = ""  #: Reason why the motion waits or was refused; empty in the other states

    @property
    def refusal(self) -> str:
        """Reason for which the motion was refused, or an empty string."""
        return self.reason if self.state is StartState.REFUSED else ""


class PendingStart:
    """Slot for at most one motion that waits to be started."""

    def __init__(self, clock: Callable[[], float], stream_monitor: StreamMonitor) -> None:
        self._clock, self._stream_monitor = clock, stream_monitor
        self._start: Callable[[], None] | None = None
        self._since = self._deadline = self._handover = 0.0

    def __bool__(self) -> bool:
        return self._start is not None

    def put(self, start: Callable[[], None]) -> None:
        """Store a motion in place of the pending one; InputError of its start refuses it."""
        self._start = start
        self.restart_timeout()

    def restart_timeout(self) -> None:
        """Let the pending motion wait for the whole timeout from now on.

        On a clock that reads zero, as simulated time does until a node has heard it, the timeout
        begins with the first time.
        """
        now = self._since = self._clock()
        self._handover = now + HANDOVER_TIME
        self._deadline = now + WAIT_TIMEOUT + self._stream_monitor.waiting_time(now)

    def discard(self) -> bool:
        """Discard the pending motion, and return whether there was one."""
        pending, self._start = self._start is not None, None
        return pending

    def attempt(self, refusal: str, blocking_reason: Callable[[], str]) -> StartAttempt:
        """Start the pending motion if the robot is ready for it.

        The motion is refused at once for a reason in `refusal`, after `HANDOVER_TIME` if that is
        one which may pass (`StreamMonitor.passing_reason`), and after the timeout for one that
        `blocking_reason` returns, or while the controller is not heard. The motion is no longer
        pending unless the outcome is that it is still waiting.
        """
        if self._start is None:
            return StartAttempt(StartState.NOTHING_PENDING)
        if not self._since:
            self.restart_timeout()
        now, reason = self._clock(), refusal
        monitor = self._stream_monitor
        passes = reason == monitor.passing_reason and now < self._handover
        if reason and (passes or (monitor.is_unheard and now < self._deadline)):
            return StartAttempt(StartState.WAITING, reason)
        if not reason:
            reason = blocking_reason()
            if reason and now < self._deadline:
                return StartAttempt(StartState.WAITING, reason)
        start, self._start = self._start, None
        if not reason:
            try:
                start()
            except InputError as error:
                reason = str(error)
        if reason:
            return StartAttempt(StartState.REFUSED, reason)
        return StartAttempt(StartState.STARTED)
