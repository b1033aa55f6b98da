"""Coordination of the node's motions: their inputs, their cycle and the requests to them."""

from typing import TYPE_CHECKING

from std_msgs.msg import Float64

from omniman_ros.core.stamps import TIME_JUMP
from omniman_ros.core.stream_monitor import StreamMonitor
from omniman_ros.motion.path.interpolator import RefusedError
from omniman_ros.motion.path.parameters import TICK
from omniman_ros.motion.whole_body.limits import WholeBodyLimits
from omniman_ros.nodes.frame_transforms import FrameTransforms
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.parameters import ParameterSet
from omniman_ros.nodes.stream_monitor_interface import StreamMonitorInterface
from omniman_ros.nodes.surroundings_interface import SurroundingsInterface
from omniman_ros.nodes.trajectory_interfaces.arm_feed import ArmFeed
from omniman_ros.nodes.trajectory_interfaces.limit_interface import HealthInput, LimitInterface
from omniman_ros.nodes.trajectory_interfaces.motion_context import StreamContext
from omniman_ros.nodes.trajectory_interfaces.motion_log import MotionEvent
from omniman_ros.nodes.trajectory_interfaces.motion_supervisor import MotionSupervisor
from omniman_ros.nodes.trajectory_interfaces.motion_time_base import (
    MotionTimeBase,
    ScalingInterface,
)
from omniman_ros.nodes.trajectory_interfaces.odom_feed import OdomFeed
from omniman_ros.nodes.trajectory_interfaces.previews import arm_previews, platform_previews
from omniman_ros.nodes.trajectory_interfaces.tool_interface import ToolInterface
from omniman_ros.nodes.whole_body_interfaces.dodge_interface import DodgeInterface
from omniman_ros.nodes.whole_body_interfaces.parameters import WholeBodyPlannerParameters

if TYPE_CHECKING:
    from omniman_ros.planning.whole_body.task import BodyTask

SOURCE = "body"  #: Value of `active_source` while the node drives the platform


class BodyCoordinator:
    """Runs the paths of the tool."""

    def __init__(
        self,
        node: OmnimanNode,
        settings: ParameterSet[WholeBodyPlannerParameters],
        period: float,
    ) -> None:
        # Imported here, so that the parameters of the node can be read without casadi.
        from omniman_ros.planning.whole_body.dodging_motion import DodgingMotion

        p, odom_frame = settings.value, settings.value.frames.odom.odom_frame
        self._node, self.is_ending = node, False
        self._progress = node.create_publisher(Float64, "path_progress", 10)
        self.scaling = ScalingInterface(node, self._on_slowed)
        motion = DodgingMotion(WholeBodyLimits.of_whole_body(p.core, p.arm))
        self.context: StreamContext[WholeBodyPlannerParameters] = StreamContext(
            node=node,
            read_options=lambda: settings.value,
            frames=FrameTransforms(node, lambda: settings.value.frames),
            stream_monitor=StreamMonitor(p.restart, SOURCE),
            odom=OdomFeed(node, "odom", odom_frame, lambda *it: self.whole_body.update_pose(*it)),
            arm_feed=ArmFeed(
                node,
                p.arm.joints,
                lambda: not self.whole_body.idle,
                lambda: self._supervisor.check_arm(),
            ),
            time_base=MotionTimeBase(
                (motion,), node.now, self.scaling, lambda: settings.value.scaling_timeout
            ),
            platform_previews=platform_previews(
                node, f"{SOURCE}/reference", odom_frame, p.horizon
            ),
            arm_previews=arm_previews(node, p.arm.joints, p.horizon),
            publish_all=lambda horizon: self.whole_body.publish(horizon),
            on_started=self._on_started,
            conflict=lambda _: "",
            is_ending=lambda: self.is_ending,
        )
        self.limits = LimitInterface(
            node, lambda: settings.value, ((motion, slice(None)),), self._on_slowed
        )
        self.surroundings = SurroundingsInterface(node, self.context.frames, p.surroundings)
        self.whole_body = DodgeInterface(self.context, motion, self.surroundings)
        self.tool: ToolInterface[BodyTask] = ToolInterface(
            self.context,
            self.whole_body,
            self.whole_body,
            self.surroundings.dismiss_silent_source,
        )
        HealthInput(self.context, self._scale_limits)
        self._supervisor = MotionSupervisor(self.context, self.scaling, period, self.whole_body)
        StreamMonitorInterface(node, self.context.stream_monitor, self._supervisor.check_control)
        self._scaled_at, self._ticked_at = float("-inf"), node.now()

    def configure(self, new: WholeBodyPlannerParameters) -> None:
        """Set new parameters, which apply from the next path on."""
        self.whole_body.configure(new)
        self.surroundings.configure(new.surroundings)
        self.limits.configure(new)
        self.context.stream_monitor.silence = new.restart

    def _on_slowed(self) -> None:
        """Slow down at once; further changes within a tick of the stream wait for the next."""
        if self._node.now() - self._scaled_at >= TICK:
            self._scaled_at = self._node.now()
            self.send()

    def _scale_limits(self, scale: float) -> None:
        self.whole_body.limit_scale = scale
        self._on_slowed()

    def _on_started(self) -> None:
        self.context.time_base.release()
        self.send()

    def hold(self) -> None:
        """Hold the tool where it is, or raise RefusedError if no motion may begin."""
        if self.is_ending:
            raise RefusedError("the node is shutting down")
        if why := self.tool.take(self.whole_body.hold_planner, "a hold of the tool"):
            raise RefusedError(why)

    def cancel(self) -> None:
        """Discard what waits or brake what moves; raise RefusedError if there is nothing."""
        is_discarded = self.tool.discard_pending()
        if is_discarded:
            self.tool.status.report(MotionEvent.CANCELLED, MotionEvent.CANCELLED.value)
        if not self.context.time_base.idle or not is_discarded:
            self.context.time_base.cancel()

    def begin_shutdown(self) -> None:
        """Bring the robot to rest on its path, and accept nothing new."""
        self.is_ending = True
        self.tool.discard_pending()
        if not self.context.time_base.idle:
            self.context.time_base.cancel()
            self.send()

    def tick(self) -> None:
        """Supervise the motion, start a path that waits, plan, and publish previews."""
        since_tick, self._ticked_at = self._node.now() - self._ticked_at, self._node.now()
        self._supervisor.check_time(since_tick)
        if since_tick < -TIME_JUMP:
            self.tool.pending.restart_timeout()
        self._supervisor.check_control()
        if self.context.odom.pose is not None:
            self.surroundings.update_map(self.context.odom.pose)
        if refusal := self.tool.start_pending():
            self._node.warn("tool path refused", f"tool path not used: {refusal}")
        if self.context.time_base.idle:
            return
        self.whole_body.plan()
        self.send()

    def send(self) -> None:
        """Publish progress, the demand, and previews at the pace that is allowed now."""
        time_base = self.context.time_base
        if time_base.idle:
            return
        self._progress.publish(Float64(data=time_base.progress()))
        motion_time = time_base.now()
        self.limits.publish_demand(motion_time)
        pace = min(self.whole_body.max_pace, self.limits.max_pace(motion_time))
        self._supervisor.limit_pace(pace)
        self.whole_body.tick()
