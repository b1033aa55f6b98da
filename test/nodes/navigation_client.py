"""Client of an action of nav2_msgs in the harness."""

from typing import Any

from rclpy.action import ActionClient

from test.nodes.harness import World

FAR_END = 20.0


class NavigationClient:
    """Sends goals to the only action of nav2_msgs of the first node of a world.

    Attributes:
        feedback: Feedback of all goals.
    """

    def __init__(self, world: World, action_type: Any, name: str) -> None:
        self._world, self._type = world, action_type
        self._client = ActionClient(world.probe, action_type, name)
        world._await(self._client.server_is_ready, f"action {name}")
        self.feedback: list[Any] = []

    def close(self) -> None:
        self._client.destroy()
        for action in self._world.nodes[0].actions:
            action.destroy()

    def send(self, **fields: Any) -> tuple[Any, Any]:
        """Send a goal; return its handle and the future of its result."""
        future = self._client.send_goal_async(
            self._type.Goal(**fields), feedback_callback=lambda m: self.feedback.append(m.feedback)
        )
        self._world._await(future.done, "an answer to a goal")
        handle = future.result()
        assert handle.accepted
        return handle, handle.get_result_async()

    def cancel(self, handle: Any) -> bool:
        """Cancel a goal; return whether the server agreed."""
        future = handle.cancel_goal_async()
        self._world._await(future.done, "an answer to a cancellation")
        return bool(future.result().goals_canceling)

    def result(self, future: Any, seconds: float = FAR_END) -> tuple[int, int, str]:
        """Return status, error code and error message of a result, once there is one."""
        self._world.run_until(future.done, seconds, "a result")
        got = future.result()
        return got.status, got.result.error_code, got.result.error_msg
