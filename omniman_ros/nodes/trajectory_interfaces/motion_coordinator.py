"""Coordination of all motions of the node: their inputs, their cycle and their common requests."""

from diagnostic_msgs.msg import DiagnosticStatus
from std_msgs.msg import Float64

from omniman_ros.conversions.wheels import LimitScales, reported_limit_scales
from omniman_ros.core.arrays import Array
from omniman_ros.core.stream_monitor import StreamMonitor
from omniman_ros.motion.path.axis_limits import AxisLimits
from omniman_ros.motion.path.interpolator import PathInterpolator
from omniman_ros.motion.path.joint_interpolator import JointInterpolator
from omniman_ros.motion.path.parameters import TICK
from omniman_ros.motion.whole_body.limits import WholeBodyLimits
from omniman_ros.motion.whole_body.model import JOINT_COLUMNS, PLATFORM_COLUMNS
from omniman_ros.nodes.frame_transforms import FrameTransforms
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.parameters import ParameterSet
from omniman_ros.nodes.stop_interface import LATCHED
from omniman_ros.nodes.stream_monitor_interface import StreamMonitorInterface
from omniman_ros.nodes.timed_node import TIME_JUMP
from omniman_ros.nodes.trajectory_interfaces.arm_feed import ArmFeed
from omniman_ros.nodes.trajectory_interfaces.arm_interface import ArmInterface
from omniman_ros.nodes.trajectory_interfaces.limit_interface import LimitInterface
from omniman_ros.nodes.trajectory_interfaces.motion_context import MotionContext
from omniman_ros.nodes.trajectory_interfaces.motion_status import MotionEvent
from omniman_ros.nodes.trajectory_interfaces.motion_time_base import MotionTimeBase
from omniman_ros.nodes.trajectory_interfaces.odom_feed import OdomFeed
from omniman_ros.nodes.trajectory_interfaces.parameters import (
    PathInterpolatorParameters,
    self_collision_check,
)
from omniman_ros.nodes.trajectory_interfaces.path_interface import PathInterface
from omniman_ros.nodes.trajectory_interfaces.previews import arm_previews, platform_previews
from omniman_ros.nodes.trajectory_interfaces.scaling_interface import ScalingInterface
from omniman_ros.nodes.trajectory_interfaces.tool_interface import ToolInterface
from omniman_ros.nodes.trajectory_interfaces.trajectory_input import TrajectoryInput
from omniman_ros.nodes.trajectory_interfaces.whole_body_interface import WholeBodyInterface



class MotionCoordinator:
    """Runs the motions of platform, arm and whole body side by side.

    Args:
        node: Node that owns topics, timers and the clock.
        settings: Parameters of the node.

    Attributes:
        context: Services that the interfaces share.
        path: Paths of the platform.
        arm: Trajectories of the arm.
        whole_body: Trajectories of platform and arm together.
        tool: Paths of the tool, which the whole body drives.
        scaling: Speed scaling of the arm's controller.
        limits: Limit of the speed before contact.
        is_ending: Whether the node is shutting down, so that nothing new is accepted.
    """

    def __init__(
        self, node: OmnimanNode, settings: ParameterSet[PathInterpolatorParameters]
    ) -> None:
        p = settings.value
        odom_frame = p.frames.odom.odom_frame
        self._node, self._settings, self.is_ending = node, settings, False
        self._progress = node.create_publisher(Float64, "path_progress", 10)
        self.scaling = ScalingInterface(node, self._on_slowed)
        path, options = PathInterpolator(p.core), p.joint_trajectory
        self._self_collision = self_collision_check(p)
        arm = JointInterpolator(AxisLimits.of_arm(p.arm), options)
        whole_body = JointInterpolator(WholeBodyLimits.of_whole_body(p.core, p.arm), options)
        self.context = MotionContext(
            node=node,
            settings=settings,
            frames=FrameTransforms(node, lambda: settings.value.frames),
            stream_monitor=StreamMonitor(p.restart),
            odom=OdomFeed(node, "odom", odom_frame, self._on_pose),
            arm_feed=ArmFeed(node, p.arm.joints, self._is_arm_moving, self._on_joint_states),
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
        self.limits = LimitInterface(node, settings, motions, self._on_slowed)
        self.path = PathInterface(self.context, path)
        self.arm = ArmInterface(self.context, arm)
        self.whole_body = WholeBodyInterface(self.context, whole_body)
        self.tool = ToolInterface(self.context, self.whole_body)
        TrajectoryInput(self.context, self.arm, self.whole_body)
        self._limit_scales = LimitScales()
        on_health = node.guarded("wheel_health", self._on_health)
        node.create_subscription(DiagnosticStatus, "wheel_health", on_health, LATCHED)
        StreamMonitorInterface(node, self.context.stream_monitor, self._check_control)
        self._scaled_at, self._ticked_at = float("-inf"), node.now()

    def configure(self, new: PathInterpolatorParameters) -> None:
        """Set new parameters, which apply from the next motions on.

        Raises:
            ParameterError: No path could be planned with them.
        """
        new.core.planner()  # raises
        self._self_collision = self_collision_check(new)
        self.arm.configure(new.arm, new.joint_trajectory)
        self.whole_body.configure(new)
        self.path.core.parameters = new.core
        self.limits.configure(new)
        self.context.stream_monitor.silence = new.restart

    # ---- inputs -------------------------------------------------------------------------------

    def _on_pose(self, pose: Array, at: float) -> None:
        self.whole_body.update_pose(pose, at)

    def _is_arm_moving(self) -> bool:
        return not (self.arm.idle and self.whole_body.idle)

    def _on_joint_states(self) -> None:
        self.arm.check_following()
        self.whole_body.check_following()

    def _on_health(self, message: DiagnosticStatus) -> None:
        """Apply the fraction of the limits that dead wheels and the arm's posture leave."""
        scales, before, core = reported_limit_scales(message), self._limit_scales, self.path.core
        self._limit_scales, limit_scale = scales, scales.total
        if scales.wheels > before.wheels:  # the controller was reset, and expects a silence
            self.context.stream_monitor.restart(self._node.now())
        if limit_scale != core.limit_scale:
            self.whole_body.limit_scale = limit_scale
            core.scale_limits(limit_scale, self.context.time_base.now())
            self.tick()

    def _on_slowed(self) -> None:
        """Slow down at once; further changes within a tick wait for the next one."""
        if not self.context.time_base.idle and self._node.now() - self._scaled_at >= TICK:
            self._scaled_at = self._node.now()
            self.tick()

    # ---- services to the interfaces -----------------------------------------------------------

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

    # ---- requests -----------------------------------------------------------------------------

    def cancel(self) -> None:
        """Discard all pending motions, and bring those under way to rest on their paths.

        Raises:
            RefusedError: Nothing is pending or under way.
        """
        discarded = [
            interface
            for interface, discard in (
                (self.path, self.path.discard_pending),
                (self.whole_body, self.whole_body.discard_pending),
                (self.tool, self.tool.discard_pending),
            )
            if discard()
        ]
        for interface in discarded:
            interface.status.report(MotionEvent.CANCELLED, MotionEvent.CANCELLED.value)
        if not self.context.time_base.idle or not discarded:
            self.context.time_base.cancel()

    def begin_shutdown(self) -> None:
        """Bring all motions to rest on their paths, and accept nothing new."""
        self.is_ending = True
        self.path.discard_pending()
        self.whole_body.discard_pending()
        self.tool.discard_pending()
        if not self.context.time_base.idle:
            self.context.time_base.cancel()
            self.tick()

    # ---- cycle --------------------------------------------------------------------------------

    def tick(self) -> None:
        """Supervise all motions, start pending ones, and publish previews and progress."""
        since_tick, self._ticked_at = self._node.now() - self._ticked_at, self._node.now()
        self._check_time(since_tick)
        self._check_control()
        for motion, kind in (
            (self.path, "path"),
            (self.whole_body, "trajectory"),
            (self.tool, "tool path"),
        ):
            refusal = motion.start_pending()
            if refusal:
                self._node.warn(f"{kind} refused", f"{kind} not used: {refusal}")
        time_base = self.context.time_base
        if time_base.idle:
            return
        self._progress.publish(Float64(data=time_base.progress()))
        motion_time = time_base.now()
        self.limits.publish_demand(motion_time)
        time_base.limit_pace(min(self.whole_body.max_pace, self.limits.max_pace(motion_time)))
        for interface in (self.path, self.arm, self.whole_body):
            interface.tick()

    def _check_control(self) -> None:
        """Give up motions whose robot is stopped or no longer follows."""
        self.path.check_control()
        self.whole_body.check_control()
        self.arm.check_arm()
        self.whole_body.check_arm()

    def _check_time(self, since_tick: float) -> None:
        """Give up motions that cannot continue after the time since the last tick [s]."""
        if since_tick < -TIME_JUMP:
            self._start_over()
        else:
            self.path.check_time(since_tick)
            self.whole_body.check_time(since_tick)
        # While this node is held up, the other nodes are not silent.
        elapsed = min(max(since_tick, 0.0), 2.0 * self._settings.value.period)
        self.context.odom.pass_time(elapsed)
        self.scaling.pass_time(elapsed)
        self.context.arm_feed.pass_time(elapsed)
        if self.scaling.silence > self._settings.value.scaling_timeout:
            why = f"no arm/speed_scaling for {self.scaling.silence:.2f} s"
            for interface in (self.arm, self.whole_body):
                interface.give_up(why, brake=True)

    def _start_over(self) -> None:
        """Forget all that was received, because time went back."""
        self.path.give_up("time went back")
        for interface in (self.arm, self.whole_body):
            interface.give_up("time went back", brake=False)
        self.context.stream_monitor.restart(self._node.now())
        self.context.odom.forget()
        self.context.arm_feed.forget()
        for waiting in (self.path, self.whole_body, self.tool):
            waiting.pending.restart_timeout()
