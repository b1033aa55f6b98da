"""A motion that was accepted and waits for the robot; the log of its interface follows it."""

from collections.abc import Callable

from omniman_ros.core.pending_start import PendingStart, StartState
from omniman_ros.core.stream_monitor import StreamMonitor
from omniman_ros.nodes.motion_log import LoggedMotion, MotionEvent, MotionLog
from omniman_ros.nodes.omniman_node import OmnimanNode


class PendingMotion:
    """Has at most one accepted motion wait, and tells the log what becomes of it.

    A `conflict` refuses a motion at once; for a `blocking_reason` it waits.
    """

    def __init__(
        self,
        node: OmnimanNode,
        monitor: StreamMonitor,
        log: MotionLog,
        blocking_reason: Callable[[], str],
        conflict: Callable[[], str],
    ) -> None:
        self._monitor, self._log = monitor, log
        self._blocking_reason, self._conflict = blocking_reason, conflict
        self._pending = PendingStart(node.now, monitor)
        self.motion: LoggedMotion | None = None  #: The motion that waits

    def __bool__(self) -> bool:
        return bool(self._pending)

    def accept(self, motion: LoggedMotion, start: Callable[[], None]) -> str:
        """Accept a motion in place of the one that waits; start it, return or raise why not."""
        self.discard(MotionEvent.REPLACED)
        self.motion = motion
        self._pending.put(start)
        return self.start()

    def start(self) -> str:
        """Start the motion that waits if possible; return why it is refused, or ""."""
        refusal = self._monitor.blocking_reason or self._conflict()
        attempt = self._pending.attempt(refusal, self._blocking_reason)
        if self.motion is not None and attempt.state is StartState.WAITING:
            self._log.report(self.motion, MotionEvent.WAITING, attempt.reason)
            return ""
        motion, self.motion = self.motion, None
        if motion is not None and attempt.refusal:
            self._log.refuse(motion, attempt.refusal)
        return attempt.refusal

    def discard(self, event: MotionEvent = MotionEvent.CANCELLED) -> bool:
        """Discard the motion that waits, and return whether there was one."""
        motion, self.motion = self.motion, None
        if motion is not None:
            self._log.report(motion, event)
        return self._pending.discard()

    def restart_timeout(self) -> None:
        """Let the motion wait for the whole timeout from now on."""
        self._pending.restart_timeout()
