"""A motion that was accepted and waits for the robot; the log of its interface follows it."""

from collections.abc import Callable

from omniman_ros.core.pending_start import PendingStart, StartState
from omniman_ros.core.stream_monitor import StreamMonitor
from omniman_ros.nodes.motion_log import LoggedMotion, MotionEvent, MotionLog


class PendingMotion:
    """Has at most one accepted motion wait, and tells the log what becomes of it.

    Args:
        refusal: Returns why no motion may start, or an empty string.
        blocking_reason: Returns why a motion must wait, or an empty string.
    """

    def __init__(
        self,
        clock: Callable[[], float],
        monitor: StreamMonitor,
        log: MotionLog,
        refusal: Callable[[], str],
        blocking_reason: Callable[[], str],
    ) -> None:
        self._log, self._refusal, self._blocking_reason = log, refusal, blocking_reason
        self._pending = PendingStart(clock, monitor)
        self._motion: LoggedMotion | None = None

    def __bool__(self) -> bool:
        return bool(self._pending)

    def accept(self, motion: LoggedMotion, start: Callable[[], None]) -> str:
        """Accept a motion in place of the one that waits; start it, return or raise why not."""
        self.discard(MotionEvent.REPLACED)
        self._motion = motion
        self._pending.put(start)
        return self.start()

    def start(self) -> str:
        """Start the motion that waits if possible; return why it is refused, or ""."""
        motion = self._motion
        attempt = self._pending.attempt(self._refusal(), self._blocking_reason)
        if motion is not None and attempt.state is StartState.WAITING:
            self._log.report(motion, MotionEvent.WAITING, attempt.reason)
        if motion is not None and attempt.refusal:
            self._log.refuse(motion, attempt.refusal)
        return attempt.refusal

    def discard(
        self,
        event: MotionEvent = MotionEvent.CANCELLED,
        motion: LoggedMotion | None = None,
    ) -> bool:
        """Discard the motion that waits, any or only this one, and return whether there was it."""
        if motion is not None and motion is not self._motion:
            return False
        discarded = self._pending.discard()
        if discarded and self._motion is not None:
            self._log.report(self._motion, event)
        return discarded

    def restart_timeout(self) -> None:
        """Let the motion wait for the whole timeout from now on."""
        self._pending.restart_timeout()
