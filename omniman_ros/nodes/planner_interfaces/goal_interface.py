"""Goals of the planner, from topics and from the action `navigate_to_pose`."""

import functools
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from trajectory_msgs.msg import MultiDOFJointTrajectory

from omniman_ros.conversions.headers import duration_message
from omniman_ros.conversions.poses import (
    goal_pose_from_message,
    goal_state_from_message,
    pose_message,
)
from omniman_ros.conversions.trajectories import preview_from_message
from omniman_ros.core.errors import InputError
from omniman_ros.nodes.frame_transforms import FrameTransforms
from omniman_ros.nodes.motion_log import LoggedMotion
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.parameters import ParameterSet
from omniman_ros.nodes.planner_interfaces.goal_anchor import PlacedGoal
from omniman_ros.nodes.planner_interfaces.parameters import MpcPlannerParameters
from omniman_ros.nodes.planner_interfaces.planner_loop import PlannerLoop
from omniman_ros.nodes.planner_interfaces.sensor_interface import SensorInterface
from omniman_ros.planning.goals import Goal, PoseGoal, TrajectoryGoal, goal_of_state

if TYPE_CHECKING:  # needs casadi, which is optional
    from omniman_ros.planning.planner import Planner


class GoalInterface:
    """Subscribes to `goal_pose`, `goal_state` and `goal_trajectory`."""

    def __init__(
        self,
        node: OmnimanNode,
        settings: ParameterSet[MpcPlannerParameters],
        frames: FrameTransforms,
        loop: PlannerLoop,
    ) -> None:
        self._node, self._settings, self._frames = node, settings, frames
        self._loop = loop
        for kind, topic, convert in (
            (PoseStamped, "goal_pose", self._pose_goal),
            (Odometry, "goal_state", self._state_goal),
            (MultiDOFJointTrajectory, "goal_trajectory", self._trajectory_goal),
        ):
            submit = functools.partial(self._submit, convert)
            handler = frames.deferred(topic, lambda received: [received[1].header], submit)
            receive = functools.partial(self._receive, handler)
            node.create_subscription(kind, topic, node.guarded(topic, receive), 10)

    def submit_pose(self, message: PoseStamped) -> LoggedMotion:
        """Submit a pose to come to rest at; raise InputError if it is refused."""
        motion = self._loop.goals.receive(message.header.stamp)
        if refusal := self._submit(self._pose_goal, (motion, message)):
            raise InputError(refusal)
        return motion

    def _receive(self, handler: Callable[[Any], str | None], message: Any) -> str | None:
        return handler((self._loop.goals.receive(message.header.stamp), message))

    def _submit(self, convert: Callable[[Any], Goal], received: tuple[LoggedMotion, Any]) -> str:
        motion, message = received
        return self._loop.submit(motion, lambda: self._placed(message, convert))

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


class GoalExecutor:
    """Hands goals of an action to the planner; see `NavigationExecutor`."""

    def __init__(
        self,
        node: OmnimanNode,
        goals: GoalInterface,
        loop: PlannerLoop,
        sensors: SensorInterface,
        planner: "Planner",
        frame: str,
    ) -> None:
        self._node, self._goals, self._loop = node, goals, loop
        self._sensors, self._planner, self._frame = sensors, planner, frame

    def send(self, request: Any) -> LoggedMotion:
        """Drive to a goal's pose; raise InputError if it is refused."""
        if request.behavior_tree:
            raise InputError(f"behavior_tree must be empty, not '{request.behavior_tree}'")
        return self._goals.submit_pose(request.pose)

    def cancel(self, motion: LoggedMotion) -> None:
        """Bring the robot to rest if it waits for this goal or drives to it."""
        if motion.outcome is None:
            self._loop.cancel()

    def fill_feedback(self, feedback: Any) -> bool:
        """Write the pose, and the rest of the way, into the feedback."""
        measured = self._sensors.measured
        if measured is None:
            return False
        feedback.current_pose.header.stamp = self._node.stamp(measured.time)
        feedback.current_pose.header.frame_id = self._frame
        feedback.current_pose.pose = pose_message(measured.pose)
        route = self._planner.route_planner
        if route is None or route.route is None:
            feedback.distance_remaining = self._planner.error(measured)[0]
        else:
            feedback.distance_remaining = route.remaining_length
            feedback.estimated_time_remaining = duration_message(route.remaining)
        return True
