"""Action `follow_joint_trajectory` of an interface that accepts trajectories.

control_msgs is imported here only, and only when an action is to be served, so that the package
works without it.
"""

from array import array
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from rclpy.action import CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from trajectory_msgs.msg import JointTrajectory

from omniman_ros.conversions.headers import time_seconds
from omniman_ros.conversions.joints import abbreviate_names, axis_names
from omniman_ros.core import plausible
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.motion.path.trajectory_goal import (
    Ending,
    ErrorCode,
    GoalMonitor,
    GoalResult,
    GoalTolerances,
    TrajectoryActionOptions,
)
from omniman_ros.nodes.deferred_action import DeferredActionServer
from omniman_ros.nodes.motion_log import LoggedMotion
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.trajectory_interfaces.joint_interface import JointInterface
from omniman_ros.nodes.trajectory_interfaces.motion_context import MAX_STAMP_AGE

#: Fields of a point of a trajectory, in the order of their derivatives
PARTS = ("positions", "velocities", "accelerations")


def goal_monitor(
    goal: Any, names: Sequence[str], options: TrajectoryActionOptions, now: float
) -> GoalMonitor:
    """Create the monitor of a goal; raise InputError if it is invalid, or ended in the past."""
    multi_dof = goal.multi_dof_trajectory
    if multi_dof.joint_names or multi_dof.points:
        raise InputError(
            "multi_dof_trajectory must be empty: the platform's axes are joints here "
            "(trajectory_execution.control_multi_dof_joint_variables of MoveIt)"
        )
    if goal.component_path_tolerance or goal.component_goal_tolerance:
        raise InputError("component tolerances must be empty, as multi_dof_trajectory is")
    given = list(goal.trajectory.joint_names)
    unknown = [name for name in given if name not in names]
    if unknown:
        raise InputError(
            f"no joint {abbreviate_names(unknown)}; the joints are {abbreviate_names(names)}"
        )
    if not given or len(set(given)) != len(given):
        raise InputError(f"joint names must be given once each: {abbreviate_names(given)}")
    tolerances = GoalTolerances.of_goal(
        names,
        options,
        goal.path_tolerance,
        goal.goal_tolerance,
        time_seconds(goal.goal_time_tolerance),
    )
    target = np.full(len(names), np.nan)
    target[[names.index(name) for name in given]] = _last_positions(goal.trajectory, now)
    return GoalMonitor(names, target, tolerances)


def _last_positions(trajectory: JointTrajectory, now: float) -> Array:
    if not trajectory.points:
        raise InputError("the trajectory has no points")
    last, stamp = trajectory.points[-1], time_seconds(trajectory.header.stamp)
    age = now - (stamp + time_seconds(last.time_from_start))
    if stamp and age > MAX_STAMP_AGE:
        raise InputError(f"the trajectory ended {age:.2f} s ago")
    if len(last.positions) != len(trajectory.joint_names):
        raise InputError(
            f"{len(last.positions)} positions for {len(trajectory.joint_names)} joints"
        )
    positions = np.array(last.positions)
    plausible.demand(positions, plausible.ANGLE, "positions")
    return positions


def fill_feedback(
    feedback: Any,
    stamp: Time,
    desired: tuple[Array, ...],
    actual: tuple[Array, ...],
    errors: tuple[Array, ...],
) -> None:
    """Write the motion of n axes into a feedback of the action.

    Args:
        desired: Reference positions, velocities and accelerations, (n,) each.
        actual: Measured positions and velocities, (n,) each.
        errors: Errors of positions and velocities, (n,) each.
    """
    feedback.header.stamp = stamp
    for point, arrays in (
        (feedback.desired, desired),
        (feedback.actual, actual),
        (feedback.error, errors),
    ):
        for label, values in zip(PARTS, arrays, strict=False):
            setattr(point, label, array("d", values.tobytes()))


@dataclass
class _Goal:
    """A goal under way."""

    handle: ServerGoalHandle
    motion: LoggedMotion
    monitor: GoalMonitor  #: Monitor of its tolerances


def action_type() -> Any:
    """Return control_msgs/action/FollowJointTrajectory, or None without control_msgs."""
    try:
        from control_msgs.action import FollowJointTrajectory
    except ImportError:
        return None
    return FollowJointTrajectory


def serve_actions(
    node: OmnimanNode,
    executors: Mapping[str, JointInterface],
    options: TrajectoryActionOptions,
) -> tuple["TrajectoryAction", ...]:
    """Serve an action for each executor, by action names; none without control_msgs."""
    kind = action_type()
    if kind is None:
        node.get_logger().info("no follow_joint_trajectory action: control_msgs is not installed")
        return ()
    return tuple(
        TrajectoryAction(node, kind, name, executor, options)
        for name, executor in executors.items()
    )


class TrajectoryAction:
    """Action `follow_joint_trajectory` of one executor.

    An invalid goal is rejected, with the reason in the log. A valid goal that the executor refuses
    is aborted with the reason as its result, and the motion under way goes on. An accepted goal
    replaces the last one, which is aborted. A goal that is cancelled, or violates a path
    tolerance, ends when the axes have come to rest on its path.
    """

    def __init__(
        self,
        node: OmnimanNode,
        kind: Any,
        name: str,
        executor: JointInterface,
        options: TrajectoryActionOptions,
    ) -> None:
        self._node, self._kind, self._name, self._executor = node, kind, name, executor
        self.options = options
        self._goal: _Goal | None = None
        self._feedback = kind.Feedback(joint_names=list(executor.names))
        self._server = DeferredActionServer(
            node,
            kind,
            name,
            goal_callback=self._on_goal,
            handle_accepted_callback=self._on_accepted,
            cancel_callback=self._on_cancel,
        )
        self._timer = node.create_timer(options.period, self.update, clock=node.clock)

    @property
    def idle(self) -> bool:
        """Whether no goal is under way."""
        return self._goal is None

    def destroy(self) -> None:
        """Destroy the action server, which must happen before its node is destroyed."""
        self._node.destroy_timer(self._timer)
        self._server.destroy()

    def _on_goal(self, goal: Any) -> GoalResponse:
        try:
            self._monitor(goal)
        except InputError as error:
            self._node.warn(self._name, f"{self._name}: a goal was rejected: {error}")
            return GoalResponse.REJECT
        return GoalResponse.ACCEPT

    def _monitor(self, goal: Any) -> GoalMonitor:
        goal.trajectory.joint_names = axis_names(goal.trajectory.joint_names)
        for tolerance in (*goal.path_tolerance, *goal.goal_tolerance):
            (tolerance.name,) = axis_names([tolerance.name])
        now = self._node.get_clock().now().nanoseconds * 1e-9
        return goal_monitor(goal, self._executor.names, self.options, now)

    def _on_accepted(self, handle: ServerGoalHandle) -> None:
        handle.execute()
        try:
            monitor = self._monitor(handle.request)
            motion = self._executor.send(handle.request.trajectory)
        except InputError as error:
            self._finish(handle, GoalResult(Ending.ABORTED, ErrorCode.INVALID_GOAL, str(error)))
            return
        last, self._goal = self._goal, _Goal(handle, motion, monitor)
        if last is not None:
            verdict = last.monitor.update(self._node.now(), None, None, "replaced by a new goal")
            assert verdict is not None
            self._finish(last.handle, verdict)
        self._timer.reset()

    def _on_cancel(self, handle: ServerGoalHandle) -> CancelResponse:
        goal = self._goal
        if goal is None or goal.handle != handle:
            return CancelResponse.REJECT
        goal.monitor.cancel()
        self._executor.cancel(goal.motion)
        return CancelResponse.ACCEPT

    def update(self) -> None:
        """Check the goal under way; publish its feedback, or its result if it has ended."""
        goal = self._goal
        if goal is None:
            self._timer.cancel()  # until the next goal
            return
        desired, actual = self._executor.desired(), self._executor.actual()
        outcome, stopping = goal.motion.outcome, goal.monitor.stop
        verdict = goal.monitor.update(self._node.now(), desired, actual, outcome)
        if desired is not None and actual is not None:
            self._publish(goal, desired, actual)
        if verdict is not None:
            self._goal = None
            self._finish(goal.handle, verdict)
        elif goal.monitor.stop and not stopping:
            self._executor.cancel(goal.motion)

    def _publish(self, goal: _Goal, desired: tuple[Array, ...], actual: tuple[Array, ...]) -> None:
        errors = goal.monitor.error(desired[0], actual[0]), desired[1] - actual[1]
        fill_feedback(self._feedback, self._node.stamp(), desired, actual, errors)
        goal.handle.publish_feedback(self._feedback)

    def _finish(self, handle: ServerGoalHandle, verdict: GoalResult) -> None:
        end = {
            Ending.SUCCEEDED: handle.succeed,
            Ending.ABORTED: handle.abort,
            Ending.CANCELED: handle.canceled,
        }
        end[verdict.ending]()
        text = f"{self._name}: a goal is {verdict.ending.value}"
        if verdict.ending is Ending.ABORTED:
            self._node.warn(self._name, f"{text}: {verdict.text}")
        else:
            self._node.get_logger().info(text)
        result = self._kind.Result(error_code=int(verdict.code), error_string=verdict.text)
        self._server.finish(handle, result)
