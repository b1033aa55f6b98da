"""What a motion passes through before it starts: its topic, and the wait for the robot."""

from collections.abc import Callable

from nav_msgs.msg import Path

from omniman_ros.core.errors import InputError
from omniman_ros.core.pending_start import PendingStart, StartState
from omniman_ros.nodes.serialized import deserialized
from omniman_ros.nodes.trajectory_interfaces.motion_context import BodyContext, MotionContext
from omniman_ros.nodes.trajectory_interfaces.motion_log import MotionLog

POSE_BYTES = 160  #: Upper bound of the size of a pose in a serialized path [bytes]
SPARE_POSES = 100  #: Number of poses whose bytes are allowed for the rest of the message


class PathInput:
    """Passes each received path on, once the transform of its frame is known."""

    def __init__(
        self,
        context: BodyContext,
        topic: str,
        max_poses: Callable[[], int],
        refusal: Callable[[], str],
        accept: Callable[[Path], str],
        refuse: Callable[[str], InputError],
    ) -> None:
        self._max_poses, self._refusal, self._refuse = max_poses, refusal, refuse
        self._take = context.frames.deferred(topic, lambda message: [message.header], accept)
        # The message stays serialized, so that a path of a million poses is refused unread.
        on_data = context.node.guarded(topic, self._on_data)
        context.node.create_subscription(Path, topic, on_data, 10, raw=True)

    def _on_data(self, data: bytes) -> str | None:
        max_poses = self._max_poses()
        if len(data) > POSE_BYTES * (max_poses + SPARE_POSES):
            raise self._refuse(f"{len(data) / 1e6:.0f} MB, at most {max_poses} poses are accepted")
        why = self._refusal()
        if why:  # before unpacking, which would hold up the motion under way
            raise self._refuse(why)
        try:
            message = deserialized(data, Path)
        except InputError as error:
            raise self._refuse(str(error)) from error
        return self._take(message)


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
