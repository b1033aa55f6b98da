"""Topic `joint_trajectory`, for the interface of the arm and that of the whole body."""

from trajectory_msgs.msg import JointTrajectory

from omniman_ros.conversions.joints import axis_names
from omniman_ros.core.errors import InputError
from omniman_ros.motion.axes import AXES, PLATFORM_AXES
from omniman_ros.nodes.serialized import deserialized
from omniman_ros.nodes.trajectory_interfaces.arm_interface import ArmInterface
from omniman_ros.nodes.trajectory_interfaces.motion_context import MotionContext
from omniman_ros.nodes.trajectory_interfaces.whole_body_interface import WholeBodyInterface

POINT_BYTES = 64  #: Upper bound of the size of a serialized point without its numbers [bytes]

#: What is said of single points with the platform that no trajectory can keep
NO_STREAM = "; streams of points move the arm alone, the platform takes cmd_vel"


class TrajectoryInput:
    """Passes each received trajectory to the interface that it concerns."""

    def __init__(
        self, context: MotionContext, arm: ArmInterface, whole_body: WholeBodyInterface
    ) -> None:
        self._context, self._arm, self._whole_body = context, arm, whole_body
        # The message stays serialized, so that a huge trajectory is refused unread.
        on_trajectory = context.node.guarded("joint_trajectory", self._on_data)
        context.node.create_subscription(
            JointTrajectory, "joint_trajectory", on_trajectory, 10, raw=True
        )

    def _on_data(self, data: bytes) -> str:
        max_points = self._context.options.joint_trajectory.max_points
        if len(data) > (POINT_BYTES + 32 * AXES) * (max_points + 100):
            raise self._arm.log.refuse(
                f"{len(data) / 1e6:.0f} MB, at most {max_points} points are accepted"
            )
        message = deserialized(data, JointTrajectory)
        message.joint_names = axis_names(message.joint_names)
        if not message.points:
            self._arm.stop()
            self._whole_body.discard_pending()
            self._whole_body.stop()
            return ""
        return self._start(message)

    def _start(self, message: JointTrajectory) -> str:
        is_stream = self._arm.is_stream(message)
        has_platform = any(name in PLATFORM_AXES for name in message.joint_names)
        follows = is_stream and not has_platform
        hint = NO_STREAM if is_stream and has_platform else ""
        interface = self._arm if follows else self._interface_of(message)
        try:
            if self._context.is_ending():
                raise InputError("the node is shutting down")
            why = self._arm.follow_point(message) if follows else interface.trajectory(message)
        except InputError as error:
            raise interface.log.refuse(f"{error}{hint}") from error
        if why:
            why += hint
            interface.log.refuse(why)
        return why

    def _interface_of(self, message: JointTrajectory) -> ArmInterface | WholeBodyInterface:
        """Return the interface for a trajectory; the whole body's while the whole body moves."""
        has_platform = any(name in PLATFORM_AXES for name in message.joint_names)
        return self._whole_body if has_platform or not self._whole_body.idle else self._arm
