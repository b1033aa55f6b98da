"""Paths of the platform, and trajectories of the arm and of the whole body."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
from builtin_interfaces.msg import Time
from nav_msgs.msg import Path
from trajectory_msgs.msg import JointTrajectory

from omniman_ros.collision.self_collision import SelfCollisionCheck
from omniman_ros.conversions import arm as arm_conversions
from omniman_ros.conversions.headers import is_stamped, time_seconds
from omniman_ros.conversions.joints import axis_names
from omniman_ros.conversions.poses import path_poses
from omniman_ros.core import round_off, se2
from omniman_ros.core.arbiter import Source
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.motion.axes import HEADING_COLUMN, JOINT_COLUMNS, PLATFORM_COLUMNS
from omniman_ros.motion.path.axis_limits import AxisLimits
from omniman_ros.motion.path.interpolator import PathInterpolator, PathProposal, PathState
from omniman_ros.motion.path.joint_interpolator import JointInterpolator, JointProposal
from omniman_ros.motion.path.joint_points import JointPlanner, JointPoints
from omniman_ros.motion.path.moving_target import STREAM_LEAD, MovingTarget, PointStream
from omniman_ros.motion.path.pace import Window
from omniman_ros.motion.whole_body.limits import WholeBodyLimits
from omniman_ros.motion.whole_body.tool_planner import ToolPlan, ToolPlanner
from omniman_ros.nodes.motion_log import LoggedMotion, MotionInput, PendingMotion
from omniman_ros.nodes.path_interpolator.motions import MotionCoordinator, MotionInterface
from omniman_ros.nodes.path_interpolator.parameters import PathInterpolatorParameters
from omniman_ros.nodes.path_interpolator.tool import BodyInterface, PathInput

#: Number of attempts to plan from a motion under way, each with twice the time of the last
PLANNING_ATTEMPTS = 3
MIN_PLANNING_TIME = 0.03  #: Shortest planning time that is expected of a motion [s]
PLANNING_TIME_PER_POSE = 1e-4  #: Planning time that is expected for each pose of a path [s]
#: Planning time that is expected for each point of a trajectory [s]
PLANNING_TIME_PER_POINT = 1e-3
#: Planning time that is expected of the motion to a point of a stream [s]
STREAM_PLANNING_TIME = 0.01
SAMPLES = 100  #: Number of poses by which the length of the rest of a path is measured
MAX_STAMP_AGE = 0.5  #: Age of a stamp up to which a trajectory is accepted, and starts at once [s]

Proposal = TypeVar("Proposal")
#: The motions of `path_interpolator`
Motions = MotionCoordinator[PathInterpolatorParameters]


def propose_in_time(
    motions: Motions,
    propose: Callable[[float], Proposal],
    take: Callable[[Proposal, float], bool],
    planning_time: float,
) -> Proposal:
    """Plan a motion while the one under way goes on, and start it.

    Before each attempt, previews are published that last longer than the planning.

    Raises:
        InputError: The motion cannot be driven, or cannot be planned in time.
    """
    for _ in range(PLANNING_ATTEMPTS):
        motions.publish_all(2.0 * planning_time + motions.options.horizon)
        proposal = propose(planning_time)
        if take(proposal, motions.time_base.now()):
            return proposal
        planning_time *= 2.0
    raise InputError("the motion could not be planned in time; pause first")


class PathInterface(MotionInterface, PathInput):
    """Paths of the platform: `path` in, `path/reference` out."""

    _motions: Motions
    core: PathInterpolator
    pending: PendingMotion
    under_way = "a path is under way; ~/cancel ends it"

    def __init__(self, motions: Motions, core: PathInterpolator) -> None:
        super().__init__(motions, core, PLATFORM_COLUMNS, MotionInput.PATH)
        self.pending = self._pending_motion(self._blocking_reason)
        self._subscribe(motions, "path")

    @property
    def _max_poses(self) -> int:
        return self._motions.options.core.path.max_poses

    def _accept(self, motion: LoggedMotion, message: Path) -> str:
        """Start a path, placed in odom now, or let it wait; return or raise why it is refused."""
        p, frames = self._motions.options, self._motions.frames
        try:
            place = frames.into_odom(message.header).planar()
            names = p.frames.odom.beside(message.header.frame_id)
            poses = path_poses(message, names, p.core.path.heading == "poses")
            poses = se2.displaced(poses, place)
            if self._motions.is_ending:
                raise InputError("the node is shutting down")
        except InputError as error:
            raise self.log.refuse(motion, str(error)) from error
        return self.pending.accept(motion, lambda: self._start(motion, poses))

    def _blocking_reason(self) -> str:
        if not self.idle:
            return ""
        why = self._motions.odom.blocking_reason(self._motions.options.odom_timeout)
        return why or self._motions.control_wait_reason()

    def _start(self, motion: LoggedMotion, poses: Array) -> None:
        motions = self._motions
        pose = motions.odom.pose
        assert pose is not None

        def propose(lead: float) -> PathProposal:
            return self.core.propose(poses, pose, motions.time_base.now(), lead)

        planning_time = MIN_PLANNING_TIME + PLANNING_TIME_PER_POSE * len(poses)
        proposal = propose_in_time(motions, propose, self.core.take, planning_time)
        plan = proposal.plan
        self.output.begin(from_rest=proposal.since is None)
        text = (
            f"{len(poses)} poses in {plan.duration:.2f} s, {plan.duration / plan.bound:.3f} times "
            "the shortest duration without jerk limits"
        )
        self._announce(motion, text)

    def _update(self, motion_time: float) -> str:
        """Update the state of the motion; see the base class."""
        before = self.core.state
        try:
            self.core.update(motion_time)
        except InputError as error:
            self._node.warn("path paused", f"a path was paused: {error}")
            return str(error)
        if before is PathState.SLOWING and self.core.state is PathState.FOLLOWING:
            self.publish(self._motions.options.horizon)  # it continues before the next tick
        return ""

    def publish(self, horizon: float) -> None:
        """Publish a preview of the path under way that is `horizon` long [s]."""
        if not self._motions.time_base.pace.plain:
            super().publish(horizon)
        elif window := self.core.window(self._node.now(), horizon):
            self.output.send(window)

    def send(self, request: Any) -> LoggedMotion:
        """Follow the path of a goal of the action `follow_path`.

        `controller_id` and the checkers of goal and progress name plugins of Nav2, and count for
        nothing here.
        """
        motion = self.log.receive(request.path.header.stamp)
        if refusal := self._accept(motion, request.path):
            raise InputError(refusal)
        return motion

    def fill_feedback(self, feedback: Any) -> bool:
        """Write the length of the rest of the path, and the speed, into the feedback."""
        now = self._motions.time_base.now()
        if self.idle:
            return False
        ahead = self.core.sample(np.linspace(now, now + self.core.remaining(now), SAMPLES))[0]
        steps = np.diff(ahead[:, :2], axis=0)
        feedback.distance_to_goal = float(np.hypot(steps[:, 0], steps[:, 1]).sum())
        feedback.speed = float(np.hypot(*self._motions.odom.velocity[:2]))
        return True


class JointInterface(MotionInterface, ABC):
    """Connects a `JointInterpolator` to the messages of the node.

    Attributes:
        self_collision: Check of motions for collisions of the robot with itself.
    """

    _motions: Motions
    core: JointInterpolator
    self_collision: SelfCollisionCheck

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the axes."""
        return self.core.planner.limits.names

    def normalise(self, message: JointTrajectory) -> None:
        """Give the axes of a trajectory their own names."""
        message.joint_names = axis_names(message.joint_names)

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
        return None if self.idle else self._desired_at(self._motions.arm_feed.time)

    def points(self, message: JointTrajectory) -> JointPoints:
        """Convert the points of a trajectory of these axes, or raise InputError."""
        max_points = self._motions.options.joint_trajectory.max_points
        return arm_conversions.joint_points(message, self.names, max_points)

    def start(self, motion: LoggedMotion, points: JointPoints, delay: float | None) -> None:
        """Plan a trajectory, or raise InputError; start it after a delay [s], None: at once."""
        begin, time_base = self._node.now(), self._motions.time_base

        def propose(lead: float) -> JointProposal:
            now = time_base.now()
            start = None if delay is None else max(time_base.pace.motion(begin + delay), now)
            proposal = self.core.propose(points, self.rest_position(), now, lead, start)
            self.self_collision.require_clear(proposal.curve)
            return proposal

        count = len(points.positions)
        proposal = self._take(propose, MIN_PLANNING_TIME + PLANNING_TIME_PER_POINT * count)
        times = "given" if points.times is not None else "computed"
        self._announce(motion, f"{count} points in {proposal.curve.duration:.2f} s, times {times}")

    def _take(
        self, propose: Callable[[float], JointProposal], planning_time: float
    ) -> JointProposal:
        from_rest = self.idle
        proposal = propose_in_time(self._motions, propose, self.core.take, planning_time)
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
            if self._motions.is_ending:
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

    def start_delay(self, stamp: Time) -> float | None:
        """Return the time until a stamp [s]; None: now; InputError if it is far from now."""
        if not is_stamped(stamp):
            return None
        delay = self.time_to(stamp)
        max_delay = self._motions.options.joint_trajectory.max_delay
        if delay < -MAX_STAMP_AGE:
            raise InputError(f"the stamp is {-delay:.2f} s old")
        if delay > max_delay:
            raise InputError(f"the stamp is {delay:.2f} s ahead, at most {max_delay:g} s")
        return delay if delay > 0.0 else None

    def time_to(self, stamp: Time) -> float:
        """Return the time from now to a stamp [s]; 0 for a zero stamp, which means now."""
        if not is_stamped(stamp):
            return 0.0
        now = self._node.get_clock().now().nanoseconds
        return float((stamp.sec * 1_000_000_000 + stamp.nanosec - now) * 1e-9)

    def _stop_window(self, now: float) -> Window | None:
        """Return the last preview of a motion that is given up; see the base class."""
        return self.core.paced_stop_window(now, self._motions.time_base.pace)


class ArmInterface(JointInterface):
    """Trajectories of the arm, which may run next to paths of the platform."""

    under_way = "a trajectory of the arm is under way; ~/cancel ends it"

    def __init__(
        self, motions: Motions, core: JointInterpolator, self_collision: SelfCollisionCheck
    ) -> None:
        super().__init__(motions, core, JOINT_COLUMNS, MotionInput.ARM)
        self.self_collision, self._stream = self_collision, PointStream()

    def configure(self, new: PathInterpolatorParameters) -> None:
        """Set new parameters, which apply from the next trajectory on."""
        self.core.planner = JointPlanner(AxisLimits.of_arm(new.arm), new.joint_trajectory)

    def trajectory(self, motion: LoggedMotion, message: JointTrajectory) -> str:
        """Start a trajectory; see the base class."""
        points, delay = self.points(message), self.start_delay(message.header.stamp)
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
        delay = max(self.time_to(message.header.stamp), 0.0)
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
        points, motions = self.points(message), self._motions
        target = MovingTarget.last_of(points, self.time_to(message.header.stamp))
        why = self._blocking_reason() or self._held_reason
        why = self._stream.offer(self._node.now(), why, motions.options.restart)
        if why:
            return why
        now = motions.time_base.now()
        lead = STREAM_PLANNING_TIME
        proposal = self.core.propose_meeting(target, self.rest_position(), now, lead)
        self.self_collision.require_clear(proposal.curve)
        from_rest, begins = self.idle, not self._stream.active
        if not self.core.take(proposal, motions.time_base.now()):
            return "the point could not be planned in time"
        timeout = motions.options.joint_trajectory.stream_timeout
        self._stream.follow(self._node.now() + max(timeout, target.due))
        self.output.begin(from_rest=from_rest)
        if begins:
            self._announce(motion, "a stream of points")
        else:
            self.publish(motions.options.horizon)
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
            now = self._motions.time_base.now()
            if self.core.remaining(now) > 0.0:
                self._node.get_logger().info("trajectory: the stream of points fell silent")
                self.core.cancel(now)
        super().tick()
        if self.idle:
            self._stream.end()

    def _blocking_reason(self) -> str:
        options, motions = self._motions.options.joint_trajectory, self._motions
        why = motions.stream_monitor.stop_reason or motions.conflict(self)
        if not why and motions.stream_monitor.source == Source.BODY.value:
            why = "whole_body_planner moves the arm"
        return why or motions.arm_feed.blocking_reason(options, idle=self.idle)

    def actual(self) -> tuple[Array, Array] | None:
        """Return measured joint angles and rates (6,); see the base class."""
        return self._motions.arm_feed.state()

    def rest_position(self) -> Array:
        """Return the joint angles (6,) at which the arm is at rest [rad]."""
        tolerance = self._motions.options.joint_trajectory.start_tolerance
        position = self._motions.arm_feed.start_position(tolerance)
        assert position is not None
        return position


class WholeBodyInterface(BodyInterface[ToolPlan], JointInterface):
    """Trajectories of odom_x, odom_y, odom_t and the arm's joints, and planned tool paths."""

    _motions: Motions
    core: JointInterpolator  #: Interpolator of the nine axes
    pending: PendingMotion

    def __init__(
        self, motions: Motions, core: JointInterpolator, self_collision: SelfCollisionCheck
    ) -> None:
        super().__init__(motions, core, MotionInput.BODY)
        self.self_collision = self_collision
        self.pending = self._pending_motion(self.blocking_reason)

    def configure(self, new: PathInterpolatorParameters) -> None:
        """Set new parameters, which apply from the next trajectory on."""
        limits = WholeBodyLimits.of_whole_body(new.core, new.arm)
        self.core.planner = JointPlanner(limits, new.joint_trajectory)
        self.configure_tool(new)

    def trajectory(self, motion: LoggedMotion, message: JointTrajectory) -> str:
        """Start a trajectory, or let it wait for the robot; see the base class."""
        points = self.points(message)
        delay = self.start_delay(message.header.stamp)
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
            now = np.array([self._motions.time_base.now()])
            heading = self.core.sample(now)[0][0, HEADING_COLUMN]
        return points.unwrapped(HEADING_COLUMN, float(heading))

    def _take(
        self, propose: Callable[[float], JointProposal], planning_time: float
    ) -> JointProposal:
        """Start a motion, which is one of the tool only if that is said afterwards."""
        proposal = super()._take(propose, planning_time)
        self._tool = self._platform = None
        return proposal

    def planner(self, poses: Array, start: Array) -> Callable[[], ToolPlan]:
        """Return what plans a motion, and checks it for collisions of the robot with itself."""
        p, check = self._motions.options, self.self_collision
        limits = WholeBodyLimits.of_whole_body(p.core, p.arm)
        planner = ToolPlanner(self.model, limits, p.tool_path)

        def plan() -> ToolPlan:
            result = planner.plan(poses, start)
            check.require_clear(result.curve)
            return result

        return plan

    def drive(self, motion: LoggedMotion, plan: ToolPlan) -> None:
        """Start a path of the tool that was planned from the robot's present position."""
        self._take(lambda _: JointProposal(plan.curve, None, None), 0.0)
        self._lead(plan)
        self._announce(motion, f"{plan.length:.2f} m of the tool in {plan.curve.duration:.2f} s")
