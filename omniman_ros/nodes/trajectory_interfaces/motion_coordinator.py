"""Coordination of all motions of the node: their inputs, their cycle and their common requests."""

import math

from std_msgs.msg import Float64
from trajectory_msgs.msg import JointTrajectory

from omniman_ros.conversions.joints import axis_names
from omniman_ros.core.errors import InputError
from omniman_ros.core.stamps import TIME_JUMP
from omniman_ros.core.stream_monitor import StreamMonitor
from omniman_ros.motion.axes import AXES, JOINT_COLUMNS, PLATFORM_AXES, PLATFORM_COLUMNS
from omniman_ros.motion.path.axis_limits import AxisLimits
from omniman_ros.motion.path.interpolator import PathInterpolator
from omniman_ros.motion.path.joint_interpolator import JointInterpolator
from omniman_ros.motion.path.parameters import TICK
from omniman_ros.motion.whole_body.limits import WholeBodyLimits
from omniman_ros.motion.whole_body.tool_planner import ToolPlan
from omniman_ros.nodes.frame_transforms import FrameTransforms
from omniman_ros.nodes.motion_events import MotionEvents
from omniman_ros.nodes.motion_log import MotionInput
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.parameters import ParameterSet
from omniman_ros.nodes.pending_motion import PendingMotion
from omniman_ros.nodes.serialized import deserialized, serialized_stamp
from omniman_ros.nodes.stream_monitor_interface import StreamMonitorInterface
from omniman_ros.nodes.trajectory_interfaces.arm_feed import ArmFeed
from omniman_ros.nodes.trajectory_interfaces.arm_interface import ArmInterface
from omniman_ros.nodes.trajectory_interfaces.limit_interface import HealthInput, LimitInterface
from omniman_ros.nodes.trajectory_interfaces.motion_context import MotionContext
from omniman_ros.nodes.trajectory_interfaces.motion_supervisor import MotionSupervisor
from omniman_ros.nodes.trajectory_interfaces.motion_time_base import (
    MotionTimeBase,
    ScalingInterface,
)
from omniman_ros.nodes.trajectory_interfaces.odom_feed import OdomFeed
from omniman_ros.nodes.trajectory_interfaces.parameters import PathInterpolatorParameters
from omniman_ros.nodes.trajectory_interfaces.path_interface import PathInterface
from omniman_ros.nodes.trajectory_interfaces.previews import arm_previews, platform_previews
from omniman_ros.nodes.trajectory_interfaces.tool_interface import ToolInterface
from omniman_ros.nodes.trajectory_interfaces.whole_body_interface import (
    WholeBodyInterface,
    planned_tool_paths,
)

POINT_BYTES = 64  #: Upper bound of the size of a serialized point without its numbers [bytes]

#: What is said of single points with the platform that no trajectory can keep
NO_STREAM = "; streams of points move the arm alone, the platform takes cmd_vel"


class TrajectoryInput:
    """Passes each received trajectory to the interface that it concerns."""

    def __init__(
        self, context: MotionContext, arm: ArmInterface, whole_body: WholeBodyInterface
    ) -> None:
        self._context, self._arm, self._whole_body = context, arm, whole_body
        self._refused_at = -math.inf  # time of the last refused point of a stream [s]
        # The message stays serialized, so that a huge trajectory is refused unread.
        on_trajectory = context.node.guarded("joint_trajectory", self._on_data)
        context.node.create_subscription(
            JointTrajectory, "joint_trajectory", on_trajectory, 10, raw=True
        )

    def _on_data(self, data: bytes) -> str:
        max_points, log = self._context.options.joint_trajectory.max_points, self._arm.log
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
        is_stream, now = self._arm.is_stream(message), self._context.node.now()
        has_platform = any(name in PLATFORM_AXES for name in message.joint_names)
        follows = is_stream and not has_platform
        is_for_arm = follows or (self._whole_body.idle and not has_platform)
        interface = self._arm if is_for_arm else self._whole_body
        was_refused = now - self._refused_at <= self._context.options.restart
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


class MotionCoordinator:
    """Runs the motions of platform, arm and whole body side by side."""

    def __init__(
        self, node: OmnimanNode, settings: ParameterSet[PathInterpolatorParameters]
    ) -> None:
        p, odom_frame = settings.value, settings.value.frames.odom.odom_frame
        self._node, self.is_ending = node, False
        self._progress = node.create_publisher(Float64, "path_progress", 10)
        self.scaling = ScalingInterface(node, self._on_slowed)
        path, options = PathInterpolator(p.core), p.joint_trajectory
        self._self_collision = p.self_collision_check()
        arm = JointInterpolator(AxisLimits.of_arm(p.arm), options)
        whole_body = JointInterpolator(WholeBodyLimits.of_whole_body(p.core, p.arm), options)
        self.context = MotionContext(
            node=node,
            events=MotionEvents(node),
            read_options=lambda: settings.value,
            frames=FrameTransforms(node, lambda: settings.value.frames),
            stream_monitor=StreamMonitor(p.restart),
            odom=OdomFeed(node, "odom", odom_frame, lambda *it: self.whole_body.update_pose(*it)),
            arm_feed=ArmFeed(
                node,
                p.arm.joints,
                lambda: not (self.arm.idle and self.whole_body.idle),
                lambda: self._supervisor.check_arm(),
            ),
            time_base=MotionTimeBase(
                (path, arm, whole_body),
                node.now,
                self.scaling,
                lambda: settings.value.scaling_timeout,
            ),
            self_collision=lambda: self._self_collision,
            platform_previews=platform_previews(node, "path/reference", odom_frame, p.horizon),
            arm_previews=arm_previews(node, p.arm.joints, p.horizon),
            publish_all=self._publish_all,
            on_started=self._on_started,
            conflict=self._conflict,
            is_ending=lambda: self.is_ending,
        )
        motions = ((path, PLATFORM_COLUMNS), (arm, JOINT_COLUMNS), (whole_body, slice(None)))
        self.limits = LimitInterface(node, lambda: settings.value, motions, self._on_slowed)
        self.path = PathInterface(self.context, path)
        self.arm = ArmInterface(self.context, arm)
        self.whole_body = WholeBodyInterface(self.context, whole_body)
        TrajectoryInput(self.context, self.arm, self.whole_body)
        self._startable: dict[str, PendingMotion | ToolInterface[ToolPlan]]
        self._startable = {"path": self.path.pending, "trajectory": self.whole_body.pending}
        self.tool = planned_tool_paths(self.context, self.whole_body)
        self._startable |= {} if self.tool is None else {"tool path": self.tool}
        HealthInput(self.context, self._scale_limits)
        self._supervisor = MotionSupervisor(
            self.context, self.scaling, p.period, self.whole_body, self.path, self.arm
        )
        StreamMonitorInterface(node, self.context.stream_monitor, self._supervisor.check_control)
        self._scaled_at, self._ticked_at = float("-inf"), node.now()

    def configure(self, new: PathInterpolatorParameters) -> None:
        """Set parameters for the next motions; raise ParameterError if none fits them."""
        new.core.planner()  # raises
        self._self_collision = new.self_collision_check()
        self.arm.configure(new.arm, new.joint_trajectory)
        self.whole_body.configure(new)
        self.path.core.parameters = new.core
        self.limits.configure(new)
        self.context.stream_monitor.silence = new.restart

    def _on_slowed(self) -> None:
        """Slow down at once; further changes within a tick wait for the next one."""
        if not self.context.time_base.idle and self._node.now() - self._scaled_at >= TICK:
            self._scaled_at = self._node.now()
            self.tick()

    def _scale_limits(self, scale: float) -> None:
        self.whole_body.limit_scale = scale
        self.path.core.scale_limits(scale, self.context.time_base.now())
        self.tick()

    def _conflict(self, interface: object) -> str:
        if interface is not self.whole_body:
            rival = "" if self.whole_body.idle else "a motion of the whole body"
        elif not self.path.idle:
            rival = "a path"
        else:
            rival = "" if self.arm.idle else "a trajectory of the arm"
        return rival and f"{rival} is under way; ~/cancel ends it"

    def _publish_all(self, horizon: float) -> None:
        for interface in (self.path, self.arm, self.whole_body):
            if not interface.idle:
                interface.publish(horizon)

    def _on_started(self) -> None:
        self.context.time_base.release()
        self.tick()

    def cancel(self) -> None:
        """Discard what waits and brake what moves; raise RefusedError if there is nothing."""
        discarded = [motion for motion in self._startable.values() if motion.discard()]
        if not self.context.time_base.idle or not discarded:
            self.context.time_base.cancel()

    def begin_shutdown(self) -> None:
        """Bring all motions to rest on their paths, and accept nothing new."""
        self.is_ending = True
        self.context.frames.end_waiting()
        for motion in self._startable.values():
            motion.discard()
        if not self.context.time_base.idle:
            self.context.time_base.cancel()
            self.tick()

    def tick(self) -> None:
        """Supervise all motions, start pending ones, and publish previews and progress."""
        since_tick, self._ticked_at = self._node.now() - self._ticked_at, self._node.now()
        self._supervisor.check_time(since_tick)
        if since_tick < -TIME_JUMP:
            for motion in self._startable.values():
                motion.restart_timeout()
        self._supervisor.check_control()
        for kind, motion in self._startable.items():
            if refusal := motion.start():
                self._node.warn(f"{kind} refused", f"{kind} not used: {refusal}")
        time_base = self.context.time_base
        if time_base.idle:
            return
        self._progress.publish(Float64(data=time_base.progress()))
        motion_time = time_base.now()
        self.limits.publish_demand(motion_time)
        pace = min(self.whole_body.max_pace, self.limits.max_pace(motion_time))
        self._supervisor.limit_pace(pace)
        for interface in (self.path, self.arm, self.whole_body):
            interface.tick()
