"""Action `follow_joint_trajectory` in front of what takes trajectories, where it is installed.

Nothing else imports control_msgs, and this module does only when an action is to be served.
"""

from array import array
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from omniman_ros.conversions import some_names, time_seconds
from omniman_ros.core import plausible
from omniman_ros.core.errors import InputError
from omniman_ros.core.path.trajectory_goal import (
    Ending,
    ErrorCode,
    GoalMonitor,
    GoalTolerances,
    TrajectoryActionOptions,
    Verdict,
)
from omniman_ros.nodes.runtime import OmnimanNode

Array = NDArray[np.float64]

RESULT_KEPT = 60
"""How long a result can be fetched [s]."""


class TrajectoryPort(Protocol):
    """What takes trajectories; motions are known by numbers."""

    names: tuple[str, ...]
    """Axes (n) that it takes."""

    def send(self, message: JointTrajectory) -> int:
        """Begin a motion, and return its number.

        Raises:
            InputError: It is refused; what was under way goes on.
        """
        ...

    def outcome(self, motion: int) -> str | None:
        """None while a motion goes on; empty: it has arrived; else why it ended before."""
        ...

    def cancel(self, motion: int) -> None:
        """Bring a motion to rest on its path; one that has ended is left alone."""
        ...

    def desired(self) -> tuple[Array, Array, Array] | None:
        """Where the axes are to be: positions, velocities and accelerations (n,), if known."""
        ...

    def actual(self) -> tuple[Array, Array] | None:
        """Measured positions and velocities (n,), if known."""
        ...


class _Server(ActionServer):
    """A server whose goals end when they are told to: no callback or coroutine waits for it.

    A coroutine that waits is called again and again by rclpy's executors.
    """

    def notify_execute(self, goal_handle: Any, execute_callback: Any) -> None:
        """Do nothing: the motion has begun."""

    def finish(self, handle: ServerGoalHandle, result: Any) -> None:
        """Send the result of a goal that is in its last state."""
        super().notify_execute(handle, lambda _: result)


@dataclass
class _Goal:
    """A goal under way: its handle, the number of its motion and what watches it."""

    handle: ServerGoalHandle
    motion: int
    monitor: GoalMonitor


def action_type() -> Any:
    """control_msgs/action/FollowJointTrajectory, or None where control_msgs is not installed."""
    try:
        from control_msgs.action import FollowJointTrajectory
    except ImportError:
        return None
    return FollowJointTrajectory


def serve_actions(
    node: OmnimanNode, ports: Mapping[str, TrajectoryPort], options: TrajectoryActionOptions
) -> tuple["TrajectoryAction", ...]:
    """One action a port, by names; none, and a line in the log, without control_msgs."""
    kind = action_type()
    if kind is None:
        node.get_logger().info("no control_msgs: no follow_joint_trajectory action")
        return ()
    return tuple(TrajectoryAction(node, kind, *item, options) for item in ports.items())


class TrajectoryAction:
    """The action of one port.

    A goal that cannot be read is rejected, and the log has the reason. One that can be read but
    is not taken is aborted with the reason as its result, and what was under way goes on. A goal
    that is taken takes the place of the last, which is aborted. A goal that is cancelled, or
    beyond a tolerance on the way, ends when the axes have come to rest on its path.

    Args:
        node: Where the action is.
        kind: Type of the action, see :func:`action_type`.
        name: Name of the action.
        port: What takes the trajectories.
        options: What goals that do not say otherwise are held to.
    """

    def __init__(
        self, node: OmnimanNode, kind: Any, name: str, port: TrajectoryPort,
        options: TrajectoryActionOptions,
    ) -> None:  # fmt: skip
        self._node, self._kind, self._name, self._port = node, kind, name, port
        self.options = options
        self._goal: _Goal | None = None
        self._feedback = kind.Feedback(joint_names=list(port.names))
        self._server = _Server(
            node, kind, name, lambda _: None, goal_callback=self._on_goal,
            handle_accepted_callback=self._on_accepted, cancel_callback=self._on_cancel,
            result_timeout=RESULT_KEPT,
        )  # fmt: skip
        self._timer = node.create_timer(options.period, self.update, clock=node.clock)

    @property
    def idle(self) -> bool:
        """Whether no goal is under way."""
        return self._goal is None

    def destroy(self) -> None:
        """Take the action down; before its node, which does not."""
        self._node.destroy_timer(self._timer)
        self._server.destroy()

    # ---- goals --------------------------------------------------------------------------------

    def _on_goal(self, goal: Any) -> GoalResponse:
        try:
            self._monitor(goal)
        except InputError as error:
            self._node.warn(self._name, f"{self._name}: a goal was rejected: {error}")
            return GoalResponse.REJECT
        return GoalResponse.ACCEPT

    def _monitor(self, goal: Any) -> GoalMonitor:
        """What watches a goal.

        Raises:
            InputError: The goal cannot be read, or lies in the past.
        """
        many = goal.multi_dof_trajectory
        if many.joint_names or many.points:
            raise InputError("it has a multi_dof_trajectory; the platform's axes are joints here")
        if goal.component_path_tolerance or goal.component_goal_tolerance:
            raise InputError("it has tolerances of a multi_dof_trajectory")
        names, given = self._port.names, list(goal.trajectory.joint_names)
        unknown = [name for name in given if name not in names]
        if unknown:
            raise InputError(f"no joint {some_names(unknown)}; the joints are {some_names(names)}")
        if not given or len(set(given)) != len(given):
            raise InputError(f"no joint, or one twice, among the names {some_names(given)}")
        tolerances = GoalTolerances.of_goal(
            names, self.options, goal.path_tolerance, goal.goal_tolerance,
            time_seconds(goal.goal_time_tolerance),
        )  # fmt: skip
        place = np.full(len(names), np.nan)
        place[[names.index(name) for name in given]] = self._last_positions(goal.trajectory)
        return GoalMonitor(names, place, tolerances)

    def _last_positions(self, trajectory: JointTrajectory) -> Array:
        if not trajectory.points:
            raise InputError("a trajectory without points")
        last, stamp = trajectory.points[-1], time_seconds(trajectory.header.stamp)
        end = stamp + time_seconds(last.time_from_start)
        ago = self._node.get_clock().now().nanoseconds * 1e-9 - end
        if stamp and ago > 0.0:
            raise InputError(f"it ended {ago:.2f} s ago")
        if len(last.positions) != len(trajectory.joint_names):
            raise InputError(
                f"{len(last.positions)} positions for {len(trajectory.joint_names)} joints"
            )
        positions = np.array(last.positions)
        plausible.demand(positions, plausible.ANGLE, "positions")
        return positions

    def _on_accepted(self, handle: ServerGoalHandle) -> None:
        handle.execute()
        try:
            monitor = self._monitor(handle.request)
            motion = self._port.send(handle.request.trajectory)
        except InputError as error:
            self._finish(handle, Verdict(Ending.ABORTED, ErrorCode.INVALID_GOAL, str(error)))
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
        self._port.cancel(goal.motion)
        return CancelResponse.ACCEPT

    # ---- on the way ---------------------------------------------------------------------------

    def update(self) -> None:
        """Look at the goal under way: end it, or tell its client where the axes are."""
        goal = self._goal
        if goal is None:
            self._timer.cancel()  # until the next goal
            return
        desired, actual = self._port.desired(), self._port.actual()
        outcome, stopped = self._port.outcome(goal.motion), goal.monitor.stop
        verdict = goal.monitor.update(self._node.now(), desired, actual, outcome)
        if desired is not None and actual is not None:
            self._publish(goal, desired, actual)
        if verdict is not None:
            self._goal = None
            self._finish(goal.handle, verdict)
        elif goal.monitor.stop and not stopped:
            self._port.cancel(goal.motion)

    def _publish(self, goal: _Goal, desired: tuple[Array, ...], actual: tuple[Array, ...]) -> None:
        feedback = self._feedback
        feedback.header.stamp = self._node.stamp()
        errors = goal.monitor.error(desired[0], actual[0]), desired[1] - actual[1]
        for point, arrays in (
            (feedback.desired, desired), (feedback.actual, actual), (feedback.error, errors)
        ):  # fmt: skip
            _fill(point, arrays)
        goal.handle.publish_feedback(feedback)

    def _finish(self, handle: ServerGoalHandle, verdict: Verdict) -> None:
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


def _fill(point: JointTrajectoryPoint, arrays: tuple[Array, ...]) -> None:
    for label, values in zip(("positions", "velocities", "accelerations"), arrays, strict=False):
        setattr(point, label, array("d", values.tobytes()))
