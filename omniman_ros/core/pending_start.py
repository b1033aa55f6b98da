"""A motion that was accepted and waits until the robot is ready for it."""

import enum
from collections.abc import Callable
from dataclasses import dataclass

from omniman_ros.core.errors import InputError
from omniman_ros.core.stream_monitor import StreamMonitor

WAIT_TIMEOUT = 5.0  #: Longest time for which a motion waits until the robot can start it [s]
HANDOVER_TIME = 1.0  #: Longest time for which it waits for the end of another source's motion [s]
#: Longest time between two attempts that counts as waiting [s]. In a longer one the node heard
#: nothing: it stood still, or its clock leapt, as simulated time does when it begins for a node.
LONGEST_STEP = 0.2


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
        self._attempted = self._waited = self._patience = 0.0

    def __bool__(self) -> bool:
        return self._start is not None

    def put(self, start: Callable[[], None]) -> None:
        """Store a motion in place of the pending one; InputError of its start refuses it."""
        self._start = start
        self.restart_timeout()

    def restart_timeout(self) -> None:
        """Let the pending motion wait for the whole timeout from now on."""
        self._attempted, self._waited = self._clock(), 0.0
        self._patience = WAIT_TIMEOUT + self._stream_monitor.waiting_time(self._attempted)

    def discard(self) -> bool:
        """Discard the pending motion, and return whether there was one."""
        pending, self._start = self._start is not None, None
        return pending

    def attempt(self, refusal: str, blocking_reason: Callable[[], str]) -> StartAttempt:
        """Start the pending motion if the robot is ready for it.

        The motion is refused at once for a reason in `refusal`, after `HANDOVER_TIME` if that is
        one which may pass (`StreamMonitor.passing_reason`), and after the timeout for one that
        `blocking_reason` returns, or while the controller is not heard. The motion is no longer
        pending unless the outcome is that it is still waiting. To be called in each of the node's
        cycles.
        """
        if self._start is None:
            return StartAttempt(StartState.NOTHING_PENDING)
        last, self._attempted = self._attempted, self._clock()
        self._waited += min(max(self._attempted - last, 0.0), LONGEST_STEP)
        reason, monitor, is_patient = refusal, self._stream_monitor, self._waited < self._patience
        passes = reason == monitor.passing_reason and self._waited < HANDOVER_TIME
        if reason and (passes or (monitor.is_unheard and is_patient)):
            return StartAttempt(StartState.WAITING, reason)
        if not reason:
            reason = blocking_reason()
            if reason and is_patient:
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
