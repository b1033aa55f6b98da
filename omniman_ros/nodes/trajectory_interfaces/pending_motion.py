"""A motion of an interface that waits until the robot is ready for it."""

from collections.abc import Callable

from omniman_ros.core.pending_start import PendingStart, StartState
from omniman_ros.nodes.trajectory_interfaces.motion_context import MotionContext
from omniman_ros.nodes.trajectory_interfaces.motion_log import MotionLog


class PendingMotion:
    """Has at most one accepted motion wait, and tells the interface's log what becomes of it."""

    def __init__(
        self,
        context: MotionContext,
        log: MotionLog,
        conflict: Callable[[], str],
        blocking_reason: Callable[[], str],
    ) -> None:
        self._log, self._monitor = log, context.stream_monitor
        self._conflict, self._blocking_reason = conflict, blocking_reason
        self._pending = PendingStart(context.node.now, context.stream_monitor)

    def __bool__(self) -> bool:
        return bool(self._pending)

    def accept(self, start: Callable[[], None]) -> str:
        """Accept a motion in place of the one that waits; start it, return or raise why not."""
        self._log.accept(replaces_pending=bool(self))
        self._pending.put(start)
        return self.start()

    def start(self) -> str:
        """Start the motion that waits if possible; return why it is refused, or ""."""
        refusal = self._monitor.blocking_reason or self._conflict()
        attempt = self._pending.attempt(refusal, self._blocking_reason)
        if attempt.state is StartState.WAITING:
            self._log.wait(attempt.reason)
        if attempt.refusal:
            self._log.refuse_pending(attempt.refusal)
        return attempt.refusal

    def discard(self) -> bool:
        """Discard the motion that waits, and return whether there was one."""
        discarded = self._pending.discard()
        if discarded:
            self._log.discard_pending()
        return discarded

    def restart_timeout(self) -> None:
        """Let the motion wait for the whole timeout from now on."""
        self._pending.restart_timeout()
