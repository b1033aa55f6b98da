"""A path of the tool on its way: joint angles from where the platform really is."""

import numpy as np
from geometry_msgs.msg import PoseStamped
from numpy.typing import NDArray

from omniman_ros import arm_conversions
from omniman_ros.core.body.correction import PlatformCorrection, arm_motion, speed_pace
from omniman_ros.core.body.model import BodyModel
from omniman_ros.core.body.parameters import ToolPathOptions
from omniman_ros.core.body.tool_planner import ToolPlan
from omniman_ros.core.path.parameters import TICK
from omniman_ros.nodes.runtime import OmnimanNode

Array = NDArray[np.float64]

STEPS = 20
"""The pace is lowered in so many steps: each change is felt."""


class ToolStream:
    """A plan, and how the platform's error is taken out of it.

    Args:
        model: Of the robot.
        plan: The path.
        options: How it is corrected; what is live may be replaced.
        velocity: (6,) limits of the joints [rad/s].
    """

    def __init__(
        self, model: BodyModel, plan: ToolPlan, options: ToolPathOptions,
        velocity: tuple[float, ...],
    ) -> None:  # fmt: skip
        self._model, self.plan, self._velocity = model, plan, np.array(velocity)
        self.correction = PlatformCorrection(options)
        self._slowed = 1.0

    @property
    def pace(self) -> float:
        """How fast it may be driven, 0 to 1."""
        steps = np.floor(STEPS * min(self.correction.pace(), self._slowed))
        return max(float(steps), 1.0) / STEPS  # what stands would stand for ever

    def window(
        self, times: Array, along: Array, rate: float, q: Array, v: Array, a: Array
    ) -> tuple[Array, Array, Array]:
        """The planned motion with the arm's part corrected, (k, 9) each.

        Args:
            times: (k + 2,) a tick before the first to a tick after the last [s].
            along: The plan's times then (k + 2,) [s].
            rate: How fast they pass now, 0 to 1.
            q, v, a: (k + 2, 9) the planned motion, its rates and second derivatives.

        Raises:
            InputError: The tool cannot be reached from where the platform is.
        """
        platform = self.correction.platform_at(q[:, :3], times)
        arm = arm_motion(
            self._model, platform, self.plan.tool(along), self.plan.branch, q[:, 3:], TICK
        )
        self._slowed = speed_pace(arm[1], self._velocity, rate)
        parts = zip((q, v, a), arm, strict=True)
        x, rate, bend = (np.hstack([part[1:-1, :3], joints]) for part, joints in parts)
        return x, rate, bend


class ToolOutput:
    """A topic with poses of the tool in odom.

    Args:
        node: Where the topic is.
        topic: Its name.
        frame: Of the poses.
    """

    def __init__(self, node: OmnimanNode, topic: str, frame: str) -> None:
        self._node = node
        self._message = PoseStamped()
        self._message.header.frame_id = frame
        self._publisher = node.create_publisher(PoseStamped, topic, 10)

    def send(self, time: float, pose: Array) -> None:
        """Publish the pose (4, 4) of an instant [s]."""
        arm_conversions.fill_pose(self._message.pose, pose)
        self._message.header.stamp = self._node.stamp(time)
        self._publisher.publish(self._message)
