"""Paths, goals and holds of the tool, from topics, services and actions of nav2_msgs."""

from collections.abc import Callable
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path
from std_msgs.msg import Header

from omniman_ros.conversions import arm as arm_conversions
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.nodes.motion_log import LoggedMotion, MotionInput
from omniman_ros.nodes.path_interpolator.motions import MotionCoordinator
from omniman_ros.nodes.path_interpolator.tool import ToolInterface
from omniman_ros.nodes.whole_body_planner.avoidance import AvoidanceInterface
from omniman_ros.nodes.whole_body_planner.parameters import WholeBodyPlannerParameters


class ToolTaskInterface(ToolInterface[Any]):
    """Accepts paths, goals and holds of the tool, one at a time and from rest.

    A goal replaces what is driven: the robot brakes on its path, and goes to the goal from there.
    """

    def __init__(
        self,
        motions: MotionCoordinator[WholeBodyPlannerParameters],
        whole_body: AvoidanceInterface,
    ) -> None:
        super().__init__(motions, whole_body)
        self.body, self._frame = whole_body, motions.options.frames.odom.odom_frame
        self._handle_goal = motions.frames.deferred(
            "tool_goal", lambda received: [received[1].header], self._accept_goal
        )
        on_goal = motions.node.guarded("tool_goal", self._on_goal)
        motions.node.create_subscription(PoseStamped, "tool_goal", on_goal, 10)

    def _on_goal(self, message: PoseStamped) -> str | None:
        motion = self.log.receive(message.header.stamp, MotionInput.TOOL_GOAL)
        return self._handle_goal((motion, message))

    def _accept_goal(self, received: tuple[LoggedMotion, PoseStamped]) -> str:
        """Take a goal, in odom as its frame is known now; return or raise why it is refused."""
        motion, message = received
        if motion.outcome is not None:  # cancelled while it waited for its frame
            return ""
        path = Path(header=message.header, poses=[message])
        planner = self._planner(motion, path, self.body.goal_planner)
        return self.replace(motion, planner, "the way of the tool to a goal")

    def replace(
        self,
        motion: LoggedMotion,
        planner: Callable[[Array], Callable[[], Any]],
        label: str,
    ) -> str:
        """Take a motion, planned from axes (9,), in place of the one that is driven, which brakes.

        It begins at rest; the result is why it is refused, or an empty string.
        """
        self._require_newest(motion)
        if (driven := self.body.log.driven) is not None:
            self.body.log.end(driven, motion)
        self.body.stop()
        return self._take(motion, planner, label)

    @property
    def _is_braking(self) -> bool:
        """Whether a motion that was replaced comes to rest."""
        return not self.body.idle and self.body.log.driven is None

    def _refusal(self) -> str:
        return "" if self._is_braking else super()._refusal()

    def _blocking_reason(self) -> str:
        why = super()._blocking_reason()
        return why or ("the last motion comes to rest" if self._is_braking else "")

    def submit_path(self, message: Path) -> LoggedMotion:
        """Lead the tool along a path; raise InputError if it is refused."""
        motion = self.log.receive(message.header.stamp)
        if refusal := self._accept(motion, message):
            raise InputError(refusal)
        return motion

    def submit_goal(self, message: PoseStamped) -> LoggedMotion:
        """Lead the tool to a pose; raise InputError if it is refused."""
        motion = self.log.receive(message.header.stamp, MotionInput.TOOL_GOAL)
        if refusal := self._accept_goal((motion, message)):
            raise InputError(refusal)
        return motion

    def fill_header(self, header: Header) -> None:
        """Write the frame and the time of the measured pose into a header."""
        header.frame_id, header.stamp = self._frame, self._node.stamp(self._motions.odom.time)

    def cancel(self, motion: LoggedMotion) -> None:
        """Discard a motion that waits or is planned, or bring the one under way to rest."""
        if motion is self.body.log.driven:
            self.body.cancel(motion)
        elif motion.outcome is None:
            self.discard()


class ToolGoalExecutor:
    """Hands goals of the action `move_tool` to the tasks of the tool; see `NavigationExecutor`."""

    def __init__(self, tasks: ToolTaskInterface) -> None:
        self._tasks, self.cancel = tasks, tasks.cancel

    def send(self, request: Any) -> LoggedMotion:
        """Lead the tool to a goal's pose; raise InputError if it is refused."""
        if request.behavior_tree:
            raise InputError(f"behavior_tree must be empty, not '{request.behavior_tree}'")
        return self._tasks.submit_goal(request.pose)

    def fill_feedback(self, feedback: Any) -> bool:
        """Write the tool's measured pose in odom, and the length of its way, into the feedback."""
        body, measured = self._tasks.body, self._tasks.body.actual()
        if body.idle or measured is None:
            return False
        self._tasks.fill_header(feedback.current_pose.header)
        arm_conversions.fill_pose(feedback.current_pose.pose, body.model.forward(measured[0]))
        feedback.distance_remaining = body.remaining_length()
        return True


class ToolPathExecutor:
    """Hands paths of the action `follow_tool_path` to the tasks of the tool.

    `controller_id` and the checkers of goal and progress name plugins of Nav2, and count for
    nothing here.
    """

    def __init__(self, tasks: ToolTaskInterface) -> None:
        self._tasks, self.cancel = tasks, tasks.cancel

    def send(self, request: Any) -> LoggedMotion:
        """Lead the tool along a path; raise InputError if it is refused."""
        return self._tasks.submit_path(request.path)

    def fill_feedback(self, feedback: Any) -> bool:
        """Write the length of the rest of the tool's path, and its speed, into the feedback."""
        body, measured = self._tasks.body, self._tasks.body.actual()
        if body.idle or measured is None:
            return False
        positions, rates = measured
        feedback.distance_to_goal = body.remaining_length()
        feedback.speed = float(np.linalg.norm(body.model.jacobian(positions)[:3] @ rates))
        return True
