"""Topics on which the planner receives goals."""

from collections.abc import Callable
from typing import Any

from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from trajectory_msgs.msg import MultiDOFJointTrajectory

from omniman_ros.conversions.poses import goal_pose_from_message, goal_state_from_message
from omniman_ros.conversions.trajectories import preview_from_message
from omniman_ros.core.errors import InputError
from omniman_ros.nodes.frame_transforms import FrameTransforms
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.parameters import ParameterSet
from omniman_ros.nodes.planner_interfaces.goal_anchor import PlacedGoal
from omniman_ros.nodes.planner_interfaces.parameters import MpcPlannerParameters
from omniman_ros.planning.goals import Goal, PoseGoal, TrajectoryGoal, goal_of_state


class GoalInterface:
    """Subscribes to `goal_pose`, `goal_state` and `goal_trajectory`.

    Args:
        submit: Called for each message with a function that returns the goal, or raises
            InputError; returns why the goal is refused, or an empty string.
    """

    def __init__(
        self,
        node: OmnimanNode,
        settings: ParameterSet[MpcPlannerParameters],
        frames: FrameTransforms,
        submit: Callable[[Callable[[], PlacedGoal]], str],
    ) -> None:
        self._node, self._settings, self._frames = node, settings, frames
        self._submit = submit
        for kind, topic, convert in (
            (PoseStamped, "goal_pose", self._pose_goal),
            (Odometry, "goal_state", self._state_goal),
            (MultiDOFJointTrajectory, "goal_trajectory", self._trajectory_goal),
        ):
            handler = frames.deferred(topic, lambda got: [got.header], self._handler(convert))
            node.create_subscription(kind, topic, node.guarded(topic, handler), 10)

    def submit_pose(self, message: PoseStamped) -> str:
        """Submit a pose to come to rest at; return why it is refused, or an empty string."""
        return self._handler(self._pose_goal)(message)

    def _handler(self, convert: Callable[[Any], Goal]) -> Callable[[Any], str]:
        return lambda message: self._submit(lambda: self._placed(message, convert))

    def _placed(self, message: Any, convert: Callable[[Any], Goal]) -> PlacedGoal:
        placement = self._frames.placement(message.header)
        goal = convert(message).displaced(placement.transform.planar())
        return PlacedGoal(placement.frame, goal)

    # Goals are converted within the frames of their own messages.

    def _pose_goal(self, message: PoseStamped) -> Goal:
        return PoseGoal(goal_pose_from_message(message, (_frame(message),)))

    def _state_goal(self, message: Odometry) -> Goal:
        names, frame, child = self._odom_names(), _frame(message), message.child_frame_id
        if child in names and frame not in names:
            raise InputError(f"its twist is in '{child}', its pose in '{frame[:40]}'")
        known = self._settings.value.frames.odom.beside(frame)
        pose, velocity = goal_state_from_message(message, known)
        return goal_of_state(pose, velocity)

    def _trajectory_goal(self, message: MultiDOFJointTrajectory) -> Goal:
        start = self._node.instant(message.header.stamp)
        preview = preview_from_message(message, start, (_frame(message),))
        now = self._node.now()
        if preview.end < now:
            raise InputError(f"the trajectory ended {now - preview.end:.2f} s ago")
        return TrajectoryGoal(preview)

    def _odom_names(self) -> tuple[str, ...]:
        return self._settings.value.frames.odom.names


def _frame(message: PoseStamped | Odometry | MultiDOFJointTrajectory) -> str:
    return str(message.header.frame_id).lstrip("/")
