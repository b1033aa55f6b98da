"""Action server whose goals end by a call of the node."""

from typing import Any

from rclpy.action import ActionServer
from rclpy.action.server import ServerGoalHandle

RESULT_TIMEOUT = 60  #: Time for which a client can fetch a result [s]


class DeferredActionServer(ActionServer):
    """An action server whose goals end by a call: no callback or coroutine waits for the end.

    rclpy's executors call a coroutine that waits again and again.
    """

    def __init__(self, node: Any, kind: Any, name: str, **callbacks: Any) -> None:
        super().__init__(
            node, kind, name, lambda _: None, result_timeout=RESULT_TIMEOUT, **callbacks
        )

    def notify_execute(self, goal_handle: Any, execute_callback: Any) -> None:
        """Do nothing, as the motion has started already."""

    def finish(self, handle: ServerGoalHandle, result: Any) -> None:
        """Send the result of a goal that has reached a terminal state."""
        super().notify_execute(handle, lambda _: result)
