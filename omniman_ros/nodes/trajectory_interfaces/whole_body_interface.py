"""Trajectories and paths of the tool, which platform and arm drive together."""

from collections.abc import Callable

import numpy as np
from trajectory_msgs.msg import JointTrajectory

from omniman_ros.core.arrays import Array
from omniman_ros.motion.axes import HEADING_COLUMN, JOINT_COLUMNS, PLATFORM_COLUMNS
from omniman_ros.motion.path.joint_interpolator import JointInterpolator, JointProposal
from omniman_ros.motion.path.joint_points import JointPlanner, JointPoints
from omniman_ros.motion.whole_body.limits import WholeBodyLimits
from omniman_ros.motion.whole_body.model import WholeBodyModel
from omniman_ros.motion.whole_body.tool_planner import ToolPlan, ToolPlanner
from omniman_ros.nodes.motion_log import LoggedMotion, MotionInput
from omniman_ros.nodes.pending_motion import PendingMotion
from omniman_ros.nodes.trajectory_interfaces.body_interface import BodyInterface
from omniman_ros.nodes.trajectory_interfaces.joint_interface import JointInterface
from omniman_ros.nodes.trajectory_interfaces.motion_context import MotionContext
from omniman_ros.nodes.trajectory_interfaces.parameters import PathInterpolatorParameters
from omniman_ros.nodes.trajectory_interfaces.tool_interface import ToolInterface
from omniman_ros.nodes.trajectory_interfaces.tool_stream import ToolStream


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
