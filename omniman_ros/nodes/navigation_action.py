"""Actions of nav2_msgs that send the platform somewhere: NavigateToPose and FollowPath.

nav2_msgs is imported here only, and only when an action is to be served, so that the package works
without it.
"""

import importlib
from dataclasses import dataclass
from enum import Enum
from typing import Any, Protocol

from rclpy.action import CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle

from omniman_ros.conversions.headers import duration_message
from omniman_ros.core.errors import InputError
from omniman_ros.nodes.deferred_action import DeferredActionServer
from omniman_ros.nodes.motion_log import LoggedMotion
from omniman_ros.nodes.omniman_node import OmnimanNode

FEEDBACK_PERIOD = 0.1  #: Time between two messages of feedback [s]


class NavigationKind(Enum):
    """An action of nav2_msgs: its type, and the codes of goals that are not used or not reached.

    The codes are those of Nav2's servers: UNKNOWN of NavigateToPose for both (the action of Jazzy
    has names for none), INVALID_PATH and UNKNOWN of FollowPath.
    """

    NAVIGATE_TO_POSE = ("NavigateToPose", 9000, 9000)
    FOLLOW_PATH = ("FollowPath", 103, 100)

    def __init__(self, action: str, refused: int, failed: int) -> None:
        self.action, self.refused, self.failed = action, refused, failed

    @property
    def type(self) -> Any:
        """Type of the action, or None without nav2_msgs."""
        try:
            return getattr(importlib.import_module("nav2_msgs.action"), self.action)
        except ImportError:
            return None


class NavigationExecutor(Protocol):
    """What drives the platform to a goal."""

    def send(self, request: Any) -> LoggedMotion:
        """Accept a goal and return its motion; raise InputError if it is refused."""

    def cancel(self, motion: LoggedMotion) -> None:
        """Bring a motion to rest, unless it has ended already."""

    def fill_feedback(self, feedback: Any) -> bool:
        """Write what is known into the action's feedback; return whether the pose is known."""


@dataclass
class _Goal:
    """A goal under way."""

    handle: ServerGoalHandle
    motion: LoggedMotion
    since: float  #: Time of its acceptance [s]


class NavigationAction:
    """An action of nav2_msgs with one goal at a time, as Nav2's own servers have them.

    Each goal is accepted, and aborted with code and reason if it cannot be used; then the motion
    under way goes on. A new goal replaces the last one, which is aborted. A goal that is cancelled
    ends when the robot has come to rest.
    """

    def __init__(
        self,
        node: OmnimanNode,
        kind: NavigationKind,
        name: str,
        executor: NavigationExecutor,
    ) -> None:
        self._node, self._kind, self._name, self._executor = node, kind, name, executor
        self._goal: _Goal | None = None
        self._type = kind.type
        self._server = DeferredActionServer(
            node,
            self._type,
            name,
            goal_callback=lambda _: GoalResponse.ACCEPT,
            handle_accepted_callback=self._on_accepted,
            cancel_callback=self._on_cancel,
        )
        self._timer = node.create_timer(FEEDBACK_PERIOD, self.update, clock=node.clock)

    @property
    def idle(self) -> bool:
        """Whether no goal is under way."""
        return self._goal is None

    def destroy(self) -> None:
        """Destroy the action server, which must happen before its node is destroyed."""
        self._node.destroy_timer(self._timer)
        self._server.destroy()

    def _on_accepted(self, handle: ServerGoalHandle) -> None:
        handle.execute()
        try:
            motion = self._executor.send(handle.request)
        except InputError as error:
            self._abort(handle, self._kind.refused, str(error))
            return
        last, self._goal = self._goal, _Goal(handle, motion, self._node.now())
        if last is not None:
            self._end(last.handle, "replaced by a new goal")
        self._timer.reset()

    def _on_cancel(self, handle: ServerGoalHandle) -> CancelResponse:
        goal = self._goal
        if goal is None or goal.handle != handle:
            return CancelResponse.REJECT
        self._executor.cancel(goal.motion)
        return CancelResponse.ACCEPT

    def update(self) -> None:
        """Publish the feedback of the goal under way, or its result if it has ended."""
        goal = self._goal
        if goal is None:
            self._timer.cancel()  # until the next goal
            return
        if goal.motion.outcome is not None:
            self._goal = None
            self._end(goal.handle, goal.motion.outcome)
            return
        feedback = self._type.Feedback()
        if self._executor.fill_feedback(feedback):
            if self._kind is NavigationKind.NAVIGATE_TO_POSE:
                feedback.navigation_time = duration_message(self._node.now() - goal.since)
            goal.handle.publish_feedback(feedback)

    def _end(self, handle: ServerGoalHandle, outcome: str) -> None:
        if handle.is_cancel_requested:
            handle.canceled()
            self._node.get_logger().info(f"{self._name}: a goal is canceled")
            self._server.finish(handle, self._type.Result(error_msg=outcome))
        elif outcome:
            self._abort(handle, self._kind.failed, outcome)
        else:
            handle.succeed()
            self._node.get_logger().info(f"{self._name}: a goal is succeeded")
            self._server.finish(handle, self._type.Result())

    def _abort(self, handle: ServerGoalHandle, code: int, reason: str) -> None:
        handle.abort()
        self._node.warn(self._name, f"{self._name}: a goal is aborted: {reason}")
        self._server.finish(handle, self._type.Result(error_code=code, error_msg=reason))


def serve_navigation(
    node: OmnimanNode, kind: NavigationKind, name: str, executor: NavigationExecutor
) -> tuple[NavigationAction, ...]:
    """Serve an action of nav2_msgs; returns no action where nav2_msgs is not installed."""
    if kind.type is None:
        node.get_logger().info(f"no action {name}: nav2_msgs is not installed")
        return ()
    return (NavigationAction(node, kind, name, executor),)
