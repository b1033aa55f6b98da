"""Node `path_interpolator`: paths and trajectories in, streams for platform and arm out.

control_msgs is imported here only, and only when an action is to be served, so that the package
works without it.
"""

from array import array
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.action import CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from trajectory_msgs.msg import JointTrajectory

from omniman_ros.conversions.headers import time_seconds
from omniman_ros.conversions.joints import abbreviate_names, axis_names
from omniman_ros.core import plausible
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.motion.axes import AXES, PLATFORM_AXES
from omniman_ros.motion.path.axis_limits import AxisLimits
from omniman_ros.motion.path.interpolator import PathInterpolator
from omniman_ros.motion.path.joint_interpolator import JointInterpolator
from omniman_ros.motion.path.trajectory_goal import (
    Ending,
    ErrorCode,
    GoalMonitor,
    GoalResult,
    GoalTolerances,
    TrajectoryActionOptions,
)
from omniman_ros.motion.whole_body.limits import WholeBodyLimits
from omniman_ros.nodes.deferred_action import DeferredActionServer
from omniman_ros.nodes.motion_log import LoggedMotion, MotionInput
from omniman_ros.nodes.navigation_action import NavigationAction, NavigationKind, serve_navigation
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.parameters import ParameterSet
from omniman_ros.nodes.path_interpolator.motions import MotionCoordinator
from omniman_ros.nodes.path_interpolator.parameters import PathInterpolatorParameters
from omniman_ros.nodes.path_interpolator.tool import ToolInterface
from omniman_ros.nodes.path_interpolator.trajectories import (
    MAX_STAMP_AGE,
    ArmInterface,
    Motions,
    PathInterface,
    WholeBodyInterface,
)
from omniman_ros.nodes.runtime import run
from omniman_ros.nodes.serialized import deserialized, serialized_stamp

POINT_BYTES = 64  #: Upper bound of the size of a serialized point without its numbers [bytes]
#: What is said of single points with the platform that no trajectory can keep
NO_STREAM = "; streams of points move the arm alone, the platform takes cmd_vel"
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


class TrajectoryExecutor(Protocol):
    """What moves axes to the goals of an action."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the axes."""

    def normalise(self, message: JointTrajectory) -> None:
        """Write a trajectory with the names of the axes, and in odom; raise InputError if bad."""

    def send(self, message: JointTrajectory) -> LoggedMotion:
        """Accept a trajectory and return its motion; raise InputError if it is refused."""

    def cancel(self, motion: LoggedMotion) -> None:
        """Bring a motion to rest, unless it has ended already."""

    def desired(self) -> tuple[Array, Array, Array] | None:
        """Return references (n,) and their rates at the instant of `actual`, if any."""

    def actual(self) -> tuple[Array, Array] | None:
        """Return measured positions and velocities (n,) of the axes; None if they are unknown."""


def action_type() -> Any:
    """Return control_msgs/action/FollowJointTrajectory, or None without control_msgs."""
    try:
        from control_msgs.action import FollowJointTrajectory
    except ImportError:
        return None
    return FollowJointTrajectory


def serve_actions(
    node: OmnimanNode,
    executors: Mapping[str, TrajectoryExecutor],
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
        executor: TrajectoryExecutor,
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
        self._executor.normalise(goal.trajectory)
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


class TrajectoryInput:
    """Passes each received trajectory to the interface that it concerns."""

    def __init__(
        self, motions: Motions, arm: ArmInterface, whole_body: WholeBodyInterface
    ) -> None:
        self._motions, self._arm, self._whole_body = motions, arm, whole_body
        self._refused_at = -float("inf")  # time of the last refused point of a stream [s]
        # The message stays serialized, so that a huge trajectory is refused unread.
        on_trajectory = motions.node.guarded("joint_trajectory", self._on_data)
        motions.node.create_subscription(
            JointTrajectory, "joint_trajectory", on_trajectory, 10, raw=True
        )

    def _on_data(self, data: bytes) -> str:
        max_points, log = self._motions.options.joint_trajectory.max_points, self._arm.log
        try:
            if len(data) > (POINT_BYTES + 32 * AXES) * (max_points + 100):
                megabytes = f"{len(data) / 1e6:.0f} MB"
                raise InputError(f"{megabytes}, at most {max_points} points are accepted")
            message = deserialized(data, JointTrajectory)
            message.joint_names = axis_names(message.joint_names)
        except InputError as error:
            motion = log.receive(serialized_stamp(data))
            raise log.refuse(motion, str(error)) from error
        if not message.points:
            self._arm.stop()
            self._whole_body.pending.discard()
            self._whole_body.stop()
            return ""
        return self._start(message)

    def _start(self, message: JointTrajectory) -> str:
        """Start a trajectory; of a stream, its begin and its first refused point are told."""
        is_stream, now = self._arm.is_stream(message), self._motions.node.now()
        has_platform = any(name in PLATFORM_AXES for name in message.joint_names)
        follows = is_stream and not has_platform
        is_for_arm = follows or (self._whole_body.idle and not has_platform)
        interface = self._arm if is_for_arm else self._whole_body
        was_refused = now - self._refused_at <= self._motions.options.restart
        motion = interface.log.receive(
            message.header.stamp,
            MotionInput.BODY if has_platform else MotionInput.ARM,
            quietly=is_stream and (was_refused or (follows and self._arm.is_streaming)),
        )
        start = self._arm.follow_point if follows else interface.trajectory
        hint = NO_STREAM if is_stream and has_platform else ""
        try:
            why = interface.submit(motion, message, start, hint)
        finally:
            if is_stream and motion.outcome:
                self._refused_at = now
        return why


class PathCoordinator(MotionCoordinator[PathInterpolatorParameters]):
    """Runs the motions of platform, arm and whole body side by side."""

    def __init__(
        self, node: OmnimanNode, settings: ParameterSet[PathInterpolatorParameters]
    ) -> None:
        p, check = settings.value, settings.value.self_collision_check()
        path, options = PathInterpolator(p.core), p.joint_trajectory
        arm = JointInterpolator(AxisLimits.of_arm(p.arm), options)
        both = JointInterpolator(WholeBodyLimits.of_whole_body(p.core, p.arm), options)
        super().__init__(node, settings, (path, arm, both), "path", p.period)
        self.path, self.arm = PathInterface(self, path), ArmInterface(self, arm, check)
        self.whole_body = WholeBodyInterface(self, both, check)
        self.interfaces = self.path, self.arm, self.whole_body
        TrajectoryInput(self, self.arm, self.whole_body)
        self.waiting |= {"path": self.path.pending, "trajectory": self.whole_body.pending}
        self.tool = ToolInterface(self, self.whole_body) if p.takes_tool_paths else None
        if self.tool is not None:
            self.waiting["tool path"] = self.tool

    def configure(self, new: PathInterpolatorParameters) -> None:
        """Set parameters for the next motions; raise ParameterError if none fits them."""
        new.core.planner()  # raises
        self.arm.self_collision = self.whole_body.self_collision = new.self_collision_check()
        self.arm.configure(new)
        self.whole_body.configure(new)
        self.path.core.parameters = new.core
        self.configure_streams(new)

    def scale_limits(self, scale: float) -> None:
        """Scale the limits of the platform, 0 to 1; see the base class."""
        self.whole_body.limit_scale = scale
        self.path.core.scale_limits(scale, self.time_base.now())
        self.tick()

    def refresh(self) -> None:
        """Publish previews at once; see the base class."""
        self.tick()

    def tick(self) -> None:
        """Supervise all motions, start those that wait, and publish previews and progress."""
        self.supervise()
        self.stream()


class PathInterpolatorNode(OmnimanNode):
    """Serves the motions of platform, arm and whole body as a ROS node."""

    def __init__(self, **options: object) -> None:
        super().__init__("path_interpolator", **options)
        self.settings = ParameterSet(self, PathInterpolatorParameters)
        p = self.settings.value
        self.motions = PathCoordinator(self, self.settings)
        served = {p.arm_action: self.motions.arm, p.body_action: self.motions.whole_body}
        self._trajectory_actions = serve_actions(self, served, p.trajectory_action)
        self.actions: tuple[TrajectoryAction | NavigationAction, ...] = (
            *self._trajectory_actions,
            *serve_navigation(self, NavigationKind.FOLLOW_PATH, p.path_action, self.motions.path),
        )
        self.settings.on_change(self._configure)
        self.every(p.period, self.motions.tick)

    def _configure(self, new: PathInterpolatorParameters) -> None:
        self.motions.configure(new)
        for action in self._trajectory_actions:
            action.options = new.trajectory_action

    def begin_shutdown(self, reason: str) -> None:
        """Bring all motions to rest on their paths, and accept nothing new."""
        self.motions.begin_shutdown()

    @property
    def finished(self) -> bool:
        """Whether no motion is under way, and all action clients have their results."""
        return self.motions.time_base.idle and all(action.idle for action in self.actions)

    @property
    def stop_timeout(self) -> float:
        """How long the motions may take to come to rest from now on [s], with a margin of 1 s."""
        remaining = self.motions.time_base.remaining()
        return 1.0 + remaining + self.settings.value.core.path.settle

    def status(self) -> tuple[bytes, str, list[tuple[str, object]]]:
        """Return level, message and values of the diagnostics."""
        motions, time_base = self.motions, self.motions.time_base
        now, path = time_base.now(), motions.path
        values: list[tuple[str, object]] = [
            ("state", path.core.state.value),
            ("path_progress", round(path.core.progress(now), 4)),
            ("remaining_s", round(path.core.remaining(now), 2)),
        ]
        for name, interface in (("arm", motions.arm), ("body", motions.whole_body)):
            values += [
                (name, interface.core.state.value),
                (f"{name}_progress", round(interface.core.progress(now), 4)),
                (f"{name}_event", interface.log.event.value),
                (f"{name}_last", interface.log.text),
            ]
        if motions.tool is not None:
            values += [
                ("tool_path_event", motions.tool.log.event.value),
                ("tool_path_last", motions.tool.log.text),
            ]
        values += [
            ("speed_scaling", round(motions.scaling.value, 4)),
            ("event", path.log.event.value),
            ("last", path.log.text),
        ]
        takers = [it for it in (path, motions.arm, motions.whole_body, motions.tool) if it]
        latest = max(takers, key=lambda interface: interface.log.order)
        if latest.log.is_trouble and latest.idle:
            return DiagnosticStatus.WARN, latest.log.text, values
        return DiagnosticStatus.OK, time_base.state.value, values


def main(args: list[str] | None = None) -> int:
    """Run the node: entry point of `ros2 run omniman_ros path_interpolator`."""
    return run(PathInterpolatorNode, args)
