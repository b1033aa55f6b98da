"""Goals of the joints with the platform, from a topic and an action of control_msgs."""

from collections.abc import Callable

import numpy as np
from trajectory_msgs.msg import JointTrajectory

from omniman_ros.conversions import arm as arm_conversions
from omniman_ros.conversions.joints import axis_names
from omniman_ros.core import se2
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.motion.axes import PLATFORM_AXES
from omniman_ros.nodes.motion_log import LoggedMotion, MotionInput
from omniman_ros.nodes.path_interpolator.motions import MotionCoordinator
from omniman_ros.nodes.whole_body_planner.parameters import WholeBodyPlannerParameters
from omniman_ros.nodes.whole_body_planner.tool_tasks import ToolTaskInterface


class JointGoalInterface:
    """Accepts goals of all axes, in place of what is driven; see `TrajectoryExecutor`.

    A goal is a trajectory of one point. The platform's axes are a pose in the frame of its header;
    axes that are not named stay as they are.
    """

    def __init__(
        self, motions: MotionCoordinator[WholeBodyPlannerParameters], tasks: ToolTaskInterface
    ) -> None:
        self._motions, self._tasks, self._log = motions, tasks, tasks.log
        self._odom = motions.options.frames.odom.odom_frame
        self.names = PLATFORM_AXES + motions.options.arm.joints
        self.cancel = tasks.cancel
        self.desired, self.actual = tasks.body.desired, tasks.body.actual
        self._handle = motions.frames.deferred(
            "joint_goal", lambda received: [received[1].header], self._accept
        )
        on_goal = motions.node.guarded("joint_goal", self._on_goal)
        motions.node.create_subscription(JointTrajectory, "joint_goal", on_goal, 10)

    def _on_goal(self, message: JointTrajectory) -> str | None:
        motion = self._log.receive(message.header.stamp, MotionInput.JOINT_GOAL)
        message.header.frame_id = message.header.frame_id or self._odom
        return self._handle((motion, message))

    def _accept(self, received: tuple[LoggedMotion, JointTrajectory]) -> str:
        """Take a goal, in odom as its frame is known now; return or raise why it is refused."""
        motion, message = received
        try:
            self.normalise(message)
            points = arm_conversions.joint_points(message, self.names, 1)
            if self._motions.is_ending:
                raise InputError("the node is shutting down")
        except InputError as error:
            raise self._log.refuse(motion, str(error)) from error

        def planner(start: Array) -> Callable[[], object]:
            goal = start.copy()
            goal[list(points.columns)] = points.positions[0]
            return self._tasks.body.joint_planner(goal, start)

        return self._tasks.replace(motion, planner, "the way of platform and arm to a goal")

    def send(self, message: JointTrajectory) -> LoggedMotion:
        """Move to a goal; raise InputError if it is refused."""
        motion = self._log.receive(message.header.stamp, MotionInput.JOINT_GOAL)
        if refusal := self._accept((motion, message)):
            raise InputError(refusal)
        return motion

    def normalise(self, message: JointTrajectory) -> None:
        """Write a goal with the names of the axes, and the platform's pose in odom.

        Raises:
            InputError: There is not one point, at rest; only some of the platform's axes are
                named, or the frame is unknown.
        """
        names = message.joint_names = axis_names(message.joint_names)
        if len(message.points) != 1:
            raise InputError(f"a goal is one point, not {len(message.points)}")
        (point,) = message.points
        if np.any(point.velocities):
            raise InputError("a goal is reached at rest, without velocities")
        missing = [name for name in PLATFORM_AXES if name not in names]
        if len(missing) == len(PLATFORM_AXES):
            return
        if missing:
            raise InputError(f"{', '.join(PLATFORM_AXES)} are named together, or none of them")
        message.header.frame_id = message.header.frame_id or self._odom
        place = self._motions.frames.into_odom(message.header).planar()
        columns = [names.index(name) for name in PLATFORM_AXES]
        if len(point.positions) == len(names):  # else it is refused for its size
            pose = se2.displaced(np.array(point.positions)[columns], place)
            for column, value in zip(columns, pose.tolist(), strict=True):
                point.positions[column] = value
        message.header.frame_id = self._odom
