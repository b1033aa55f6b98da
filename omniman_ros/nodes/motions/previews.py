"""What the node sends: previews of the platform's and of the arm's motion."""

import numpy as np
from rclpy.qos import QoSProfile
from trajectory_msgs.msg import JointTrajectory, MultiDOFJointTrajectory

from omniman_ros import arm_conversions, conversions
from omniman_ros.core.path.interpolator import Window
from omniman_ros.core.path.parameters import TICK
from omniman_ros.core.preview import MAX_POINTS
from omniman_ros.nodes.runtime import OmnimanNode


class PlatformPreviews:
    """Output `path/reference`.

    Args:
        node: Where the topic is.
        frame: Of the poses.
        horizon: How far most previews reach [s].

    Attributes:
        covered: Until when a receiver knows where to go [s].
        publisher: Of the topic.
    """

    def __init__(self, node: OmnimanNode, frame: str, horizon: float) -> None:
        self._node, self._frame = node, frame
        self.covered = float("inf")
        self._message = conversions.reference_message(frame, int(horizon / TICK) + 1, TICK)
        self.publisher = node.create_publisher(
            MultiDOFJointTrajectory, "path/reference", QoSProfile(depth=1)
        )

    def send(self, window: Window) -> None:
        """Publish a part of the stream; its times may be further apart than ticks."""
        message = self._message
        points = min(len(window.times), MAX_POINTS)
        step = float(window.times[1] - window.times[0])
        if points != len(message.points) or not np.isclose(step, TICK, rtol=1e-3):
            message = conversions.reference_message(self._frame, points, step)
        conversions.fill_reference(message, self._node.stamp(window.times[0]), window)
        self.publisher.publish(message)
        self.covered = float(window.times[len(message.points) - 1])


class ArmPreviews:
    """Output `arm/joint_reference`.

    Args:
        node: Where the topic is.
        names: Of the joints.
        horizon: How far most previews reach [s].

    Attributes:
        covered: Until when a receiver knows where to go [s].
        publisher: Of the topic.
    """

    def __init__(self, node: OmnimanNode, names: tuple[str, ...], horizon: float) -> None:
        self._node, self._names = node, names
        self.covered = float("inf")
        points = int(horizon / TICK) + 1
        self._message = arm_conversions.joint_reference_message(names, points, TICK)
        self.publisher = node.create_publisher(
            JointTrajectory, "arm/joint_reference", QoSProfile(depth=1)
        )

    def send(self, window: Window) -> None:
        """Publish a part of the stream; its times may be further apart than ticks."""
        message = self._message
        points = min(len(window.times), MAX_POINTS)
        step = float(window.times[1] - window.times[0])
        if points != len(message.points) or not np.isclose(step, TICK, rtol=1e-3):
            message = arm_conversions.joint_reference_message(self._names, points, step)
        arm_conversions.fill_joint_reference(message, self._node.stamp(window.times[0]), window)
        self.publisher.publish(message)
        self.covered = float(window.times[points - 1])
