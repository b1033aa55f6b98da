"""Goals of the joints with the platform, from a topic and an action of control_msgs."""

from collections.abc import Callable

import numpy as np
from trajectory_msgs.msg import JointTrajectory

from omniman_ros.conversions import arm as arm_conversions
from omniman_ros.conversions.headers import time_seconds
from omniman_ros.conversions.joints import axis_names
from omniman_ros.core import round_off, se2
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.motion.axes import PLATFORM_AXES
from omniman_ros.nodes.motion_log import LoggedMotion, MotionInput
from omniman_ros.nodes.path_interpolator.motions import MotionCoordinator
from omniman_ros.nodes.path_interpolator.node import POINT_BYTES
from omniman_ros.nodes.serialized import deserialized, serialized_stamp
from omniman_ros.nodes.whole_body_planner.parameters import WholeBodyPlannerParameters
from omniman_ros.nodes.whole_body_planner.tool_tasks import ToolTaskInterface

SPARE_POINTS = 100  #: Number of points whose bytes are allowed for a whole message


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
        self.actual = tasks.body.actual
        self._sent: LoggedMotion | None = None  # the last goal of the action
        self._handle = motions.frames.deferred(
            "joint_goal", lambda received: [received[1].header], self._accept
        )
        # The message stays serialized, so that a huge one is refused unread.
        on_data = motions.node.guarded("joint_goal", self._on_data)
        motions.node.create_subscription(JointTrajectory, "joint_goal", on_data, 10, raw=True)

    def _on_data(self, data: bytes) -> str | None:
        motion = self._log.receive(serialized_stamp(data), MotionInput.JOINT_GOAL)
        try:
            if len(data) > SPARE_POINTS * (POINT_BYTES + 32 * len(self.names)):
                raise InputError(f"{len(data) / 1e6:.1f} MB, a goal is one point")
            message = deserialized(data, JointTrajectory)
        except InputError as error:
            raise self._log.refuse(motion, str(error)) from error
        message.header.frame_id = message.header.frame_id or self._odom
        return self._handle((motion, message))

    def _accept(self, received: tuple[LoggedMotion, JointTrajectory]) -> str:
        """Take a goal, in odom as its frame is known now; return or raise why it is refused."""
        motion, message = received
        if motion.outcome is not None:  # cancelled while it waited for its frame
            return ""
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
        self._sent = motion
        return motion

    def desired(self) -> tuple[Array, Array, Array] | None:
        """Return references (9,) and two rates while the last goal that was sent is driven."""
        body, sent = self._tasks.body, self._sent
        return body.desired() if sent is not None and sent is body.log.driven else None

    def normalise(self, message: JointTrajectory) -> None:
        """Write a goal with the names of the axes, and the platform's pose in odom.

        Raises:
            InputError: There is not one point, at rest and without a time; only some of the
                platform's axes are named, or the frame is unknown.
        """
        names = message.joint_names = axis_names(message.joint_names)
        if len(message.points) != 1:
            raise InputError(f"a goal is one point, not {len(message.points)}")
        (point,) = message.points
        for label in ("velocities", "accelerations"):
            if not round_off.is_rest(np.array(getattr(point, label))):
                raise InputError(f"a goal is reached at rest, without {label}")
        if after := time_seconds(point.time_from_start):
            raise InputError(
                f"a goal is reached as soon as the limits allow: time_from_start is {after:g} s, "
                "it must be 0"
            )
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
