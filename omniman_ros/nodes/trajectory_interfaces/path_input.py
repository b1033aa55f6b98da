"""Topics of type nav_msgs/Path."""

from collections.abc import Callable

from nav_msgs.msg import Path

from omniman_ros.core.errors import InputError
from omniman_ros.nodes.motion_log import LoggedMotion, MotionLog
from omniman_ros.nodes.serialized import deserialized, serialized_stamp
from omniman_ros.nodes.trajectory_interfaces.motion_context import BodyContext

POSE_BYTES = 160  #: Upper bound of the size of a pose in a serialized path [bytes]
SPARE_POSES = 100  #: Number of poses whose bytes are allowed for the rest of the message


class PathInput:
    """Passes each received path on, once the transform of its frame is known."""

    def __init__(
        self,
        context: BodyContext,
        topic: str,
        log: MotionLog,
        max_poses: Callable[[], int],
        refusal: Callable[[], str],
        accept: Callable[[LoggedMotion, Path], str],
    ) -> None:
        self._log, self._max_poses, self._refusal = log, max_poses, refusal

        def take(received: tuple[LoggedMotion, Path]) -> str:
            return accept(*received)

        self._take = context.frames.deferred(topic, lambda received: [received[1].header], take)
        # The message stays serialized, so that a path of a million poses is refused unread.
        on_data = context.node.guarded(topic, self._on_data)
        context.node.create_subscription(Path, topic, on_data, 10, raw=True)

    def _on_data(self, data: bytes) -> str | None:
        motion = self._log.receive(serialized_stamp(data))
        max_poses = self._max_poses()
        try:
            if len(data) > POSE_BYTES * (max_poses + SPARE_POSES):
                raise InputError(
                    f"{len(data) / 1e6:.0f} MB, at most {max_poses} poses are accepted"
                )
            if why := self._refusal():  # before unpacking, which would hold up the motion
                raise InputError(why)
            message = deserialized(data, Path)
        except InputError as error:
            raise self._log.refuse(motion, str(error)) from error
        return self._take((motion, message))
