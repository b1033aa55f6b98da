"""Topics with paths, `path` and `tool_path`."""

from collections.abc import Callable

from nav_msgs.msg import Path

from omniman_ros.core.errors import InputError
from omniman_ros.nodes.serialized import deserialized
from omniman_ros.nodes.trajectory_interfaces.motion_context import BodyContext

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
