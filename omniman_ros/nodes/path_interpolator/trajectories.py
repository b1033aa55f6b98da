"""Paths of the platform, and trajectories of the arm and of the whole body."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any

import numpy as np
from nav_msgs.msg import Path
from trajectory_msgs.msg import JointTrajectory

from omniman_ros.conversions import arm as arm_conversions
from omniman_ros.conversions.headers import time_seconds
from omniman_ros.conversions.poses import path_poses
from omniman_ros.core import round_off, se2
from omniman_ros.core.arbiter import Source
from omniman_ros.core.arm_parameters import ArmParameters
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.core.stamps import TIME_JUMP
from omniman_ros.motion.axes import HEADING_COLUMN, JOINT_COLUMNS, PLATFORM_COLUMNS
from omniman_ros.motion.path.axis_limits import AxisLimits
from omniman_ros.motion.path.interpolator import PathInterpolator, PathProposal, PathState
from omniman_ros.motion.path.joint_interpolator import JointInterpolator, JointProposal
from omniman_ros.motion.path.joint_parameters import JointTrajectoryOptions
from omniman_ros.motion.path.joint_points import JointPlanner, JointPoints
from omniman_ros.motion.path.moving_target import STREAM_LEAD, MovingTarget
from omniman_ros.motion.path.point_stream import PointStream
from omniman_ros.motion.path.window import Window, paced_window
from omniman_ros.motion.whole_body.limits import WholeBodyLimits
from omniman_ros.motion.whole_body.model import WholeBodyModel
from omniman_ros.motion.whole_body.tool_planner import ToolPlan, ToolPlanner
from omniman_ros.nodes.motion_log import LoggedMotion, MotionEvent, MotionInput, PendingMotion
from omniman_ros.nodes.motion_time_base import ScalingInterface
from omniman_ros.nodes.path_interpolator.motions import (
    MIN_PLANNING_TIME,
    ArmOutput,
    BodyContext,
    MotionContext,
    MotionInterface,
    note_pause,
)
from omniman_ros.nodes.path_interpolator.parameters import PathInterpolatorParameters
from omniman_ros.nodes.path_interpolator.tool import (
    BodyInterface,
    PathInput,
    ToolInterface,
    ToolStream,
)

SAMPLES = 100  #: Number of poses by which the length of the rest of a path is measured
PLANNING_TIME_PER_POSE = 1e-4  #: Planning time that is expected for each pose of a path [s]


class PathInterface:
    """Connects a `PathInterpolator` to the messages of the node."""

    def __init__(self, context: MotionContext, core: PathInterpolator) -> None:
        self._context, self._node = context, context.node
        self.core = core
        self.log = context.events.log(MotionInput.PATH)
        self.pending = PendingMotion(
            self._node,
            context.stream_monitor,
            self.log,
            self._blocking_reason,
            conflict=lambda: context.conflict(self),
        )
        PathInput(
            context,
            "path",
            self.log,
            max_poses=lambda: context.options.core.path.max_poses,
            refusal=lambda: "",
            accept=self._accept,
        )

    @property
    def idle(self) -> bool:
        """Whether no path is under way."""
        return self.core.state is PathState.IDLE

    def _accept(self, motion: LoggedMotion, message: Path) -> str:
        """Start a path, placed in odom now, or let it wait; return or raise why it is refused."""
        p, frames = self._context.options, self._context.frames
        try:
            place = frames.into_odom(message.header).planar()
            names = p.frames.odom.beside(message.header.frame_id)
            poses = path_poses(message, names, p.core.path.heading == "poses")
            poses = se2.displaced(poses, place)
            if self._context.is_ending():
                raise InputError("the node is shutting down")
        except InputError as error:
            raise self.log.refuse(motion, str(error)) from error
        return self.pending.accept(motion, lambda: self._start(motion, poses))

    def _blocking_reason(self) -> str:
        if not self.idle:
            return ""
        why = self._context.odom.blocking_reason(self._context.options.odom_timeout)
        return why or self._context.control_wait_reason()

    def _start(self, motion: LoggedMotion, poses: Array) -> None:
        context = self._context
        pose = context.odom.pose
        assert pose is not None

        def propose(lead: float) -> PathProposal:
            return self.core.propose(poses, pose, context.time_base.now(), lead)

        planning_time = MIN_PLANNING_TIME + PLANNING_TIME_PER_POSE * len(poses)
        proposal = context.propose_in_time(propose, self.core.take, planning_time)
        plan = proposal.plan
        if proposal.since is None:
            context.odom.silence = 0.0
            context.platform_previews.covered_until = float("inf")
        context.stream_monitor.begin(self._node.now())
        text = (
            f"{len(poses)} poses in {plan.duration:.2f} s, {plan.duration / plan.bound:.3f} times "
            "the shortest duration without jerk limits"
        )
        self.log.start(motion, text)
        context.on_started()

    def give_up(self, why: str) -> None:
        """Discard the path, because the platform no longer follows it."""
        if not self.idle:
            self.log.note(MotionEvent.GIVEN_UP, why)
            self.core.abort()
            self._context.stream_monitor.end(lost=True)

    def tick(self) -> None:
        """Publish the next preview, and report the end of the path."""
        time_base, before = self._context.time_base, self.core.state
        motion_time, why = time_base.now(), ""
        if before is PathState.IDLE:
            return
        horizon = self._context.options.horizon
        self.publish(horizon)
        try:
            self.core.update(motion_time)
        except InputError as error:
            why = str(error)
            self._node.warn("path paused", f"a path was paused: {why}")
        note_pause(self.log, self.core.state, why)
        if before is PathState.SLOWING and self.core.state is PathState.FOLLOWING:
            self.publish(horizon)  # the path continues before the next tick
        if before is PathState.CANCELLING and time_base.pace.stands(self._node.now()):
            self.core.abort()
        if self.idle:
            self._context.stream_monitor.end(lost=False)
            is_cancelled = before is PathState.CANCELLING
            self.log.note(MotionEvent.CANCELLED if is_cancelled else MotionEvent.ARRIVED)

    def publish(self, horizon: float) -> None:
        """Publish a preview of the path under way that is `horizon` long [s]."""
        window = self._window(horizon)
        if window is not None:
            self._context.platform_previews.send(window)
            self._context.stream_monitor.sent(self._node.now())

    def _window(self, horizon: float) -> Window | None:
        """Return the stream from now on; None while the platform rests."""
        time_base = self._context.time_base
        if time_base.pace.plain or self.idle:
            return self.core.window(self._node.now(), horizon)
        times = time_base.sample_times(horizon)
        return paced_window(time_base.pace, self.core.sample, times)

    def send(self, request: Any) -> LoggedMotion:
        """Follow the path of a goal of the action `follow_path`.

        `controller_id` and the checkers of goal and progress name plugins of Nav2, and count for
        nothing here.
        """
        motion = self.log.receive(request.path.header.stamp)
        refusal = self._accept(motion, request.path)
        if refusal:
            raise InputError(refusal)
        return motion

    def cancel(self, motion: LoggedMotion) -> None:
        """Discard the path if it waits, or bring the platform to rest on it."""
        if motion is self.pending.motion:
            self.pending.discard()
        elif motion is self.log.driven:
            self.core.cancel(self._context.time_base.now())
            self._context.on_started()

    def fill_feedback(self, feedback: Any) -> bool:
        """Write the length of the rest of the path, and the speed, into the feedback."""
        now = self._context.time_base.now()
        if self.idle:
            return False
        ahead = self.core.sample(np.linspace(now, now + self.core.remaining(now), SAMPLES))[0]
        steps = np.diff(ahead[:, :2], axis=0)
        feedback.distance_to_goal = float(np.hypot(steps[:, 0], steps[:, 1]).sum())
        feedback.speed = float(np.hypot(*self._context.odom.velocity[:2]))
        return True


class MotionSupervisor:
    """Gives motions up whose robot is stopped, silent, overruled or too far from its reference.

    A motion brakes on its path where its receivers still listen. Receivers that are stopped, or
    have been without a preview, come to rest by themselves.
    """

    def __init__(
        self,
        context: BodyContext,
        scaling: ScalingInterface,
        period: float,
        whole_body: BodyInterface,
        path: PathInterface | None = None,
        arm: MotionInterface | None = None,
    ) -> None:
        self._context, self._node, self._scaling = context, context.node, scaling
        self._period, self._path, self._whole_body = period, path, whole_body
        self._with_arm = (whole_body,) if arm is None else (arm, whole_body)

    def check_control(self) -> None:
        """Give up motions whose robot is stopped or no longer follows."""
        monitor = self._context.stream_monitor
        why = monitor.loss_reason(self._node.now())
        if why:
            self._give_up_platform(why, brake=not monitor.stop_reason)
        for motion in self._with_arm:
            self._check_arm(motion)

    def _give_up_platform(self, why: str, *, brake: bool) -> None:
        """Give up the motions that move the platform; see `MotionInterface.give_up`."""
        if self._path is not None:
            self._path.give_up(why)
        self._whole_body.give_up(why, brake=brake)

    def _check_arm(self, motion: MotionInterface) -> None:
        """Give a motion up whose previews the arm does not get, or that it does not report on."""
        context, silence = self._context, self._context.arm_feed.silence
        if motion.idle:
            return
        if context.stream_monitor.stop_reason:
            motion.give_up(context.stream_monitor.stop_reason, brake=False)
        elif not motion.output.is_covered(self._node.now()):
            motion.give_up("no preview was sent in time", brake=False)
        elif silence > context.options.joint_trajectory.states_timeout:
            motion.give_up(f"no arm/joint_states for {silence:.2f} s", brake=True)

    def limit_pace(self, max_pace: float) -> None:
        """Limit the pace; a motion of platform and arm waits on its path while odom is late."""
        waits = self._is_platform_silent
        self._context.time_base.limit_pace(0.0 if waits else max_pace, at_once=waits)

    @property
    def _is_platform_silent(self) -> bool:
        context = self._context
        return not self._whole_body.idle and context.odom.age > context.options.odom_pause

    def check_arm(self) -> None:
        """Give up motions whose arm is too far from its reference; halt one without platform."""
        max_error = self._context.options.joint_trajectory.following_error
        for motion in self._with_arm:
            error = "" if motion.idle else self._context.arm_feed.following_error(max_error)
            if error:
                motion.give_up(error, brake=True)
        if self._is_platform_silent and self._context.time_base.pace.target > 0.0:
            self.limit_pace(0.0)
            self._context.publish_all(self._context.options.horizon)

    def check_time(self, since_tick: float) -> None:
        """Give up motions that a time [s] ends, and let it pass for inputs."""
        context = self._context
        if since_tick < -TIME_JUMP:
            self._restart()
        else:
            self._check_platform(since_tick)
        # While this node is held up, the other nodes are not silent.
        elapsed = min(max(since_tick, 0.0), 2.0 * self._period)
        for feed in (context.odom, self._scaling, context.arm_feed):
            feed.pass_time(elapsed)
        if self._scaling.silence > context.options.scaling_timeout:
            why = f"no arm/speed_scaling for {self._scaling.silence:.2f} s"
            for motion in self._with_arm:
                motion.give_up(why, brake=True)

    def _check_platform(self, since_tick: float) -> None:
        """Give up motions whose previews the platform does not get, or that it is silent about."""
        context = self._context
        if self._node.now() > context.platform_previews.covered_until:
            why, can_brake = f"no preview for {since_tick:.2f} s", False
        elif context.odom.silence > context.options.odom_timeout:
            why, can_brake = f"no odom for {context.odom.silence:.2f} s", True
        else:
            return
        self._give_up_platform(why, brake=can_brake)

    def _restart(self) -> None:
        """Forget all that was received, because time went back."""
        why = "time went back"
        self._give_up_platform(why, brake=False)
        for motion in self._with_arm:
            motion.give_up(why, brake=False)
        self._context.stream_monitor.restart(self._node.now())
        self._context.odom.forget()
        self._context.arm_feed.forget()


#: Planning time that is expected for each point of a trajectory [s]
PLANNING_TIME_PER_POINT = 1e-3


class JointInterface(MotionInterface, ABC):
    """Connects a `JointInterpolator` to the messages of the node."""

    _context: MotionContext
    core: JointInterpolator
    pending: PendingMotion | None = None  #: Motion that waits, where one can

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the axes."""
        return self.core.planner.limits.names

    @abstractmethod
    def trajectory(self, motion: LoggedMotion, message: JointTrajectory) -> str:
        """Start a trajectory, or let it wait; return or raise (InputError) why it is refused."""

    @abstractmethod
    def rest_position(self) -> Array:
        """Return the positions (d,) at which the axes are at rest."""

    @abstractmethod
    def actual(self) -> tuple[Array, Array] | None:
        """Return measured positions and velocities (d,) of the axes; None if they are unknown."""

    def desired(self) -> tuple[Array, Array, Array] | None:
        """Return references (d,) and their rates at the instant of :meth:`actual`, if any."""
        return None if self.idle else self._desired_at(self._context.arm_feed.time)

    def points(self, message: JointTrajectory) -> JointPoints:
        """Convert the points of a trajectory of these axes, or raise InputError."""
        max_points = self._context.options.joint_trajectory.max_points
        return arm_conversions.joint_points(message, self.names, max_points)

    def stop(self) -> None:
        """Bring the motion to rest on its path, as a trajectory without points asks for."""
        if not self.idle:
            self.core.cancel(self._context.time_base.now())

    def start(self, motion: LoggedMotion, points: JointPoints, delay: float | None) -> None:
        """Plan a trajectory, or raise InputError; start it after a delay [s], None: at once."""
        begin, time_base = self._node.now(), self._context.time_base

        def propose(lead: float) -> JointProposal:
            now = time_base.now()
            start = None if delay is None else max(time_base.pace.motion(begin + delay), now)
            proposal = self.core.propose(points, self.rest_position(), now, lead, start)
            self._context.self_collision().require_clear(proposal.curve)
            return proposal

        count = len(points.positions)
        proposal = self._take(propose, MIN_PLANNING_TIME + PLANNING_TIME_PER_POINT * count)
        times = "given" if points.times is not None else "computed"
        self._announce(motion, f"{count} points in {proposal.curve.duration:.2f} s, times {times}")

    def _take(
        self, propose: Callable[[float], JointProposal], planning_time: float
    ) -> JointProposal:
        from_rest = self.idle
        proposal = self._context.propose_in_time(propose, self.core.take, planning_time)
        self.output.begin(from_rest=from_rest)
        return proposal

    def submit(
        self,
        motion: LoggedMotion,
        message: JointTrajectory,
        start: Callable[[LoggedMotion, JointTrajectory], str],
        hint: str = "",
    ) -> str:
        """Start a motion; record and return or raise why it is refused, with a hint."""
        try:
            if self._context.is_ending():
                raise InputError("the node is shutting down")
            why = start(motion, message)
        except InputError as error:
            raise self.log.refuse(motion, f"{error}{hint}") from error
        if why:
            why += hint
            self.log.refuse(motion, why)
        return why

    def send(self, message: JointTrajectory) -> LoggedMotion:
        """Accept a trajectory, or raise InputError; then the motion under way goes on."""
        motion = self.log.receive(message.header.stamp)
        why = self.submit(motion, message, self.trajectory)
        if why:
            raise InputError(why)
        return motion

    def cancel(self, motion: LoggedMotion) -> None:
        """Discard a motion that waits, or bring the one under way to rest on its path."""
        if self.pending is not None and motion is self.pending.motion:
            self.pending.discard()
        elif motion is self.log.driven:
            self.stop()
            self._context.on_started()


#: Planning time that is expected of the motion to a point of a stream [s]
STREAM_PLANNING_TIME = 0.01
BODY = Source.BODY.value  #: Value of `active_source` while another node moves platform and arm


class ArmInterface(JointInterface):
    """Trajectories of the arm, which may run next to paths of the platform."""

    def __init__(self, context: MotionContext, core: JointInterpolator) -> None:
        super().__init__(context, core, ArmOutput(context), MotionInput.ARM)
        self._stream = PointStream()

    def configure(self, arm: ArmParameters, options: JointTrajectoryOptions) -> None:
        """Set new parameters, which apply from the next trajectory on."""
        self.core.planner = JointPlanner(AxisLimits.of_arm(arm), options)

    def trajectory(self, motion: LoggedMotion, message: JointTrajectory) -> str:
        """Start a trajectory; see the base class."""
        points, delay = self.points(message), self._context.start_delay(message.header.stamp)
        why = self._blocking_reason()
        if not why:
            self.start(motion, points, delay)
            self._stream.lose("a trajectory took over")
        return why

    def is_stream(self, message: JointTrajectory) -> bool:
        """Return whether a message belongs to a stream: a single point, due soon.

        The same is a short window of points that ends in motion, or comes while a stream moves the
        arm: of these the last point counts.
        """
        last = message.points[-1]
        lead = time_seconds(last.time_from_start)
        delay = max(self._context.time_to(message.header.stamp), 0.0)
        if not 0.0 < lead <= STREAM_LEAD - delay:
            return False
        in_motion = not round_off.is_rest(np.array(last.velocities))
        return len(message.points) == 1 or in_motion or self._stream.active

    @property
    def is_streaming(self) -> bool:
        """Whether a stream moves the arm; its points are no motions of their own."""
        return self._stream.active

    def follow_point(self, motion: LoggedMotion, message: JointTrajectory) -> str:
        """Move the arm to the last point of a message, which may begin a stream, as a motion."""
        points, context = self.points(message), self._context
        target = MovingTarget.last_of(points, context.time_to(message.header.stamp))
        why = self._blocking_reason() or self._held_reason
        why = self._stream.offer(self._node.now(), why, context.options.restart)
        if why:
            return why
        now = context.time_base.now()
        lead = STREAM_PLANNING_TIME
        proposal = self.core.propose_meeting(target, self.rest_position(), now, lead)
        context.self_collision().require_clear(proposal.curve)
        from_rest, begins = self.idle, not self._stream.active
        if not self.core.take(proposal, context.time_base.now()):
            return "the point could not be planned in time"
        timeout = context.options.joint_trajectory.stream_timeout
        self._stream.follow(self._node.now() + max(timeout, target.due))
        self.output.begin(from_rest=from_rest)
        if begins:
            self._announce(motion, "a stream of points")
        else:
            self.publish(context.options.horizon)
        return ""

    @property
    def _held_reason(self) -> str:
        """Why a stream must not move the arm, though nothing is stopped; may be empty."""
        state = self.core.state
        is_paused = state in (PathState.PAUSING, PathState.PAUSED)
        is_cancelled = state is PathState.CANCELLING and self._stream.active
        return f"the arm's motion is {state.value}" if is_paused or is_cancelled else ""

    def give_up(self, why: str, *, brake: bool) -> None:
        """End the motion under way; see the base class."""
        super().give_up(why, brake=brake)
        self._stream.lose(why)

    def tick(self) -> None:
        """Publish the next preview; stop a stream that fell silent. See the base class."""
        if self._held_reason:
            self._stream.lose(self._held_reason)
        if self._stream.is_silent(self._node.now()):
            self._stream.end()
            now = self._context.time_base.now()
            if self.core.remaining(now) > 0.0:
                self._node.get_logger().info("trajectory: the stream of points fell silent")
                self.core.cancel(now)
        super().tick()
        if self.idle:
            self._stream.end()

    def _blocking_reason(self) -> str:
        options, context = self._context.options.joint_trajectory, self._context
        why = context.stream_monitor.stop_reason or context.conflict(self)
        if not why and context.stream_monitor.source == BODY:
            why = "whole_body_planner moves the arm"
        return why or context.arm_feed.blocking_reason(options, idle=self.idle)

    def actual(self) -> tuple[Array, Array] | None:
        """Return measured joint angles and rates (6,); see the base class."""
        return self._context.arm_feed.state()

    def rest_position(self) -> Array:
        """Return the joint angles (6,) at which the arm is at rest [rad]."""
        tolerance = self._context.options.joint_trajectory.start_tolerance
        position = self._context.arm_feed.start_position(tolerance)
        assert position is not None
        return position


class WholeBodyInterface(BodyInterface, JointInterface):
    """Trajectories of odom_x, odom_y, odom_t and the arm's joints."""

    _context: MotionContext
    core: JointInterpolator  #: Interpolator of the nine axes
    pending: PendingMotion

    def __init__(self, context: MotionContext, core: JointInterpolator) -> None:
        super().__init__(context, core, MotionInput.BODY)
        self.pending = PendingMotion(
            self._node,
            context.stream_monitor,
            self.log,
            self.blocking_reason,
            conflict=lambda: context.conflict(self),
        )

    def configure(self, new: PathInterpolatorParameters) -> None:
        """Set new parameters, which apply from the next trajectory on."""
        limits = WholeBodyLimits.of_whole_body(new.core, new.arm)
        self.core.planner = JointPlanner(limits, new.joint_trajectory)
        if self._tool is not None:
            self._tool.correction.options = new.tool_path

    def trajectory(self, motion: LoggedMotion, message: JointTrajectory) -> str:
        """Start a trajectory, or let it wait for the robot; see the base class."""
        points = self.points(message)
        delay = self._context.start_delay(message.header.stamp)
        start = None if delay is None else self._node.now() + delay
        if self._tool is not None and not self.idle:
            return "a path of the tool is under way; ~/cancel ends it"
        return self.pending.accept(motion, lambda: self._start(motion, points, start))

    def _start(self, motion: LoggedMotion, points: JointPoints, start: float | None) -> None:
        """Start a trajectory at a time [s]; at once if it has passed while the motion waited."""
        delay = 0.0 if start is None else max(start - self._node.now(), 0.0)
        self.start(motion, self._unwrapped(points), delay or None)

    def _unwrapped(self, points: JointPoints) -> JointPoints:
        """Shift the heading by whole revolutions, from the robot's heading on."""
        if self.idle:
            heading = self.rest_position()[HEADING_COLUMN]
        else:
            now = np.array([self._context.time_base.now()])
            heading = self.core.sample(now)[0][0, HEADING_COLUMN]
        return points.unwrapped(HEADING_COLUMN, float(heading))

    def desired(self) -> tuple[Array, Array, Array] | None:
        """Return each part's references at its own time of measurement; see the base class."""
        if self.idle:
            return None
        platform = self._desired_at(self._context.odom.time)
        arm = self._desired_at(self._context.arm_feed.time)
        x, v, a = (
            np.concatenate([p[PLATFORM_COLUMNS], q[JOINT_COLUMNS]])
            for p, q in zip(platform, arm, strict=True)
        )
        return x, v, a

    def follow_tool_path(self, motion: LoggedMotion, plan: ToolPlan, tool: ToolStream) -> None:
        """Start a path of the tool that was planned from the robot's present position."""
        self._take(lambda _: JointProposal(plan.curve, None, None), 0.0)
        self._tool = tool
        self._announce(motion, f"{plan.length:.2f} m of the tool in {plan.curve.duration:.2f} s")

    def _take(
        self, propose: Callable[[float], JointProposal], planning_time: float
    ) -> JointProposal:
        """Start a motion, which is one of the tool only if that is said afterwards."""
        proposal = super()._take(propose, planning_time)
        self._tool = None
        return proposal


class PlannedToolDriver:
    """Plans with a `ToolPlanner`; see `ToolDriver`."""

    def __init__(self, context: MotionContext, whole_body: WholeBodyInterface) -> None:
        self._context, self._whole_body = context, whole_body
        self._model = WholeBodyModel(context.options.mount)

    def planner(self, poses: Array, start: Array) -> Callable[[], ToolPlan]:
        """Return what plans a motion, and checks it for collisions of the robot with itself."""
        p = self._context.options
        limits = WholeBodyLimits.of_whole_body(p.core, p.arm)
        planner = ToolPlanner(self._model, limits, p.tool_path)
        self_collision = self._context.self_collision()

        def plan() -> ToolPlan:
            result = planner.plan(poses, start)
            self_collision.require_clear(result.curve)
            return result

        return plan

    def drive(self, motion: LoggedMotion, plan: ToolPlan) -> None:
        """Start a planned motion."""
        p = self._context.options
        stream = ToolStream(self._model, plan, p.tool_path, p.arm.each("velocity"))
        self._whole_body.follow_tool_path(motion, plan, stream)


def planned_tool_paths(
    context: MotionContext, whole_body: WholeBodyInterface
) -> ToolInterface[ToolPlan] | None:
    """Return the interface for paths of the tool, or None if another node takes them."""
    if not context.options.takes_tool_paths:
        return None
    return ToolInterface(context, whole_body, PlannedToolDriver(context, whole_body))
