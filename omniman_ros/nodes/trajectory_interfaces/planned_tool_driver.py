"""Paths of the tool that keep the arm's shape: planned as a whole, then driven."""

from collections.abc import Callable

from omniman_ros.core.arrays import Array
from omniman_ros.motion.whole_body.limits import WholeBodyLimits
from omniman_ros.motion.whole_body.model import WholeBodyModel
from omniman_ros.motion.whole_body.tool_planner import ToolPlan, ToolPlanner
from omniman_ros.nodes.trajectory_interfaces.motion_context import MotionContext
from omniman_ros.nodes.trajectory_interfaces.tool_interface import ToolInterface
from omniman_ros.nodes.trajectory_interfaces.tool_stream import ToolStream
from omniman_ros.nodes.trajectory_interfaces.whole_body_interface import WholeBodyInterface


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

    def drive(self, plan: ToolPlan) -> None:
        """Start a planned motion."""
        p = self._context.options
        stream = ToolStream(self._model, plan, p.tool_path, p.arm.each("velocity"))
        self._whole_body.follow_tool_path(plan, stream)


def planned_tool_paths(
    context: MotionContext, whole_body: WholeBodyInterface
) -> ToolInterface[ToolPlan] | None:
    """Return the interface for paths of the tool, or None if another node takes them."""
    if not context.options.takes_tool_paths:
        return None
    return ToolInterface(context, whole_body, PlannedToolDriver(context, whole_body))
