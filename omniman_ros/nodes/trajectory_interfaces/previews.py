"""Publishers of previews of the platform's and of the arm's motion."""

import functools
from collections.abc import Callable
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from trajectory_msgs.msg import JointTrajectory, MultiDOFJointTrajectory

from omniman_ros.conversions import arm as arm_conversions
from omniman_ros.conversions.trajectories import fill_reference, reference_message
from omniman_ros.core.preview import MAX_POINTS
from omniman_ros.motion.path.parameters import TICK
from omniman_ros.motion.path.window import Window
from omniman_ros.nodes.omniman_node import OmnimanNode


class Previews:
    """Publishes stretches of a stream on a topic.

    Args:
        make: Returns an empty message for a number of points and their spacing [s].
        fill: Writes a stretch into a message; its first point is due at the stamp.

    Attributes:
        covered_until: Time up to which receivers have a reference [s].
    """

    def __init__(
        self,
        node: OmnimanNode,
        publisher: Publisher,
        make: Callable[[int, float], Any],
        fill: Callable[[Any, Time, Window], None],
        horizon: float,
    ) -> None:
        self._node, self._make, self._fill = node, make, fill
        self.covered_until, self.publisher = float("inf"), publisher
        self._message = make(int(horizon / TICK) + 1, TICK)

    def send(self, window: Window) -> None:
        """Publish a stretch of the stream, whose spacing may be longer than a tick."""
        message = self._message
        points = min(len(window.times), MAX_POINTS)
        step = float(window.times[1] - window.times[0])
        if points != len(message.points) or not np.isclose(step, TICK, rtol=1e-3):
            message = self._make(points, step)
        self._fill(message, self._node.stamp(window.times[0]), window)
        self.publisher.publish(message)
        self.covered_until = float(window.times[points - 1])


def platform_previews(node: OmnimanNode, topic: str, frame: str, horizon: float) -> Previews:
    """Create the output of the platform's previews on a topic, with poses in `frame`."""
    publisher = node.create_publisher(MultiDOFJointTrajectory, topic, QoSProfile(depth=1))
    make = functools.partial(reference_message, frame)
    return Previews(node, publisher, make, fill_reference, horizon)


def arm_previews(node: OmnimanNode, names: tuple[str, ...], horizon: float) -> Previews:
    """Create the output `arm/joint_reference`, with angles of the named joints."""
    publisher = node.create_publisher(JointTrajectory, "arm/joint_reference", QoSProfile(depth=1))
    make = functools.partial(arm_conversions.joint_reference_message, names)
    return Previews(node, publisher, make, arm_conversions.fill_joint_reference, horizon)
