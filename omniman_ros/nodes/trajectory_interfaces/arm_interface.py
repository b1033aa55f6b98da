"""Trajectories of the arm alone: `joint_trajectory` in, `arm/joint_reference` out."""

from trajectory_msgs.msg import JointTrajectory

from omniman_ros.core.arbiter import Source
from omniman_ros.core.arm_parameters import ArmParameters
from omniman_ros.core.arrays import Array
from omniman_ros.motion.path.axis_limits import AxisLimits
from omniman_ros.motion.path.joint_interpolator import JointInterpolator
from omniman_ros.motion.path.joint_parameters import JointTrajectoryOptions
from omniman_ros.motion.path.joint_points import JointPlanner
from omniman_ros.motion.path.parameters import TICK
from omniman_ros.nodes.trajectory_interfaces.joint_interface import JointInterface
from omniman_ros.nodes.trajectory_interfaces.motion_context import MotionContext
from omniman_ros.nodes.trajectory_interfaces.motion_outputs import ArmOutput

BODY = Source.BODY.value
"""Value of `active_source` while another node moves platform and arm."""


class ArmInterface(JointInterface):
    """Trajectories of the arm, which may run beside paths of the platform.

    Args:
        context: Services of the node.
        core: Interpolator of the six joints.
    """

    def __init__(self, context: MotionContext, core: JointInterpolator) -> None:
        super().__init__(context, core, ArmOutput(context))

    def configure(self, arm: ArmParameters, options: JointTrajectoryOptions) -> None:
        """Set new parameters, which apply from the next trajectory on."""
        self.core.planner = JointPlanner(AxisLimits.of_arm(arm), options, TICK)

    def trajectory(self, message: JointTrajectory) -> str:
        """Start a trajectory; see the base class."""
        points, delay = self.points(message), self._context.start_delay(message.header.stamp)
        why = self._blocking_reason()
        if not why:
            self.log.accept(replaces_pending=False)
            self.start(points, delay)
        return why

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
