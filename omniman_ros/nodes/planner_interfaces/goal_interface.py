"""Topics on which the planner receives goals."""

from collections.abc import Callable
from typing import Any

from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from trajectory_msgs.msg import MultiDOFJointTrajectory

from omniman_ros.conversions.poses import goal_pose_from_message, goal_state_from_message
from omniman_ros.conversions.trajectories import preview_from_message
from omniman_ros.core.errors import InputError
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.parameters import ParameterSet
from omniman_ros.nodes.planner_interfaces.parameters import MpcPlannerParameters
from omniman_ros.planning.goals import Goal, PoseGoal, StateGoal, TrajectoryGoal


class GoalInterface:
    """Subscribes to `goal_pose`, `goal_state` and `goal_trajectory`.

    Args:
        node: Node that receives the messages.
        settings: Parameters of the node.
        submit: Called for each message with a function that returns the goal, or raises
            InputError; returns why the goal is refused, or an empty string.
    """

    def __init__(
        self,
        node: OmnimanNode,
        settings: ParameterSet[MpcPlannerParameters],
        submit: Callable[[Callable[[], Goal]], str],
    ) -> None:
        self._node, self._settings, self._submit = node, settings, submit
        for kind, topic, convert in (
            (PoseStamped, "goal_pose", self._pose_goal),
            (Odometry, "goal_state", self._state_goal),
            (MultiDOFJointTrajectory, "goal_trajectory", self._trajectory_goal),
        ):
            handler = node.guarded(topic, self._handler(convert))
            node.create_subscription(kind, topic, handler, 10)

    def submit_pose(self, message: PoseStamped) -> str:
        """Submit a pose to come to rest at; return why it is refused, or an empty string.

        Raises:
            InputError: The goal is invalid.
        """
        return self._submit(lambda: self._pose_goal(message))

    def _handler(self, convert: Callable[[Any], Goal]) -> Callable[[Any], str]:
        return lambda message: self._submit(lambda: convert(message))

    def _pose_goal(self, message: PoseStamped) -> Goal:
        return PoseGoal(goal_pose_from_message(message, self._settings.value.input_frames))

    def _state_goal(self, message: Odometry) -> Goal:
        frames = self._settings.value.input_frames
        pose, velocity = goal_state_from_message(message, frames)
        return StateGoal(pose, velocity) if velocity.any() else PoseGoal(pose)

    def _trajectory_goal(self, message: MultiDOFJointTrajectory) -> Goal:
        start = self._node.instant(message.header.stamp)
        preview = preview_from_message(message, start, self._settings.value.input_frames)
        now = self._node.now()
        if preview.end < now:
            raise InputError(f"the trajectory ended {now - preview.end:.2f} s ago")
        return TrajectoryGoal(preview)
