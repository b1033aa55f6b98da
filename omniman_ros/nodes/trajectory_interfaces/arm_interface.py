"""Trajectories of the arm alone: `joint_trajectory` in, `arm/joint_reference` out."""

import numpy as np
from trajectory_msgs.msg import JointTrajectory

from omniman_ros.conversions.headers import time_seconds
from omniman_ros.core import round_off
from omniman_ros.core.arbiter import Source
from omniman_ros.core.arm_parameters import ArmParameters
from omniman_ros.core.arrays import Array
from omniman_ros.motion.path.axis_limits import AxisLimits
from omniman_ros.motion.path.interpolator import PathState
from omniman_ros.motion.path.joint_interpolator import JointInterpolator
from omniman_ros.motion.path.joint_parameters import JointTrajectoryOptions
from omniman_ros.motion.path.joint_points import JointPlanner
from omniman_ros.motion.path.moving_target import STREAM_LEAD, MovingTarget
from omniman_ros.motion.path.point_stream import PointStream
from omniman_ros.nodes.motion_log import LoggedMotion, MotionInput
from omniman_ros.nodes.trajectory_interfaces.joint_interface import JointInterface
from omniman_ros.nodes.trajectory_interfaces.motion_context import MotionContext
from omniman_ros.nodes.trajectory_interfaces.motion_interface import ArmOutput

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
