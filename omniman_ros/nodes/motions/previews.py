"""What the node sends: previews of the platform's and of the arm's motion."""

import functools
from collections.abc import Callable
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from trajectory_msgs.msg import JointTrajectory, MultiDOFJointTrajectory

from omniman_ros import arm_conversions, conversions
from omniman_ros.core.path.interpolator import Window
from omniman_ros.core.path.parameters import TICK
from omniman_ros.core.preview import MAX_POINTS
from omniman_ros.nodes.runtime import OmnimanNode


class Previews:
    """Parts of a stream on a topic.

    Args:
        node: Where the topic is.
        publisher: Of the topic.
        make: Makes an empty message of so many points that are so far apart [s].
        fill: Writes a part of the stream, whose first point is due at a stamp, into a message.
        horizon: How far most previews reach [s].

    Attributes:
        covered: Until when a receiver knows where to go [s].
        publisher: As above.
    """

    def __init__(
        self, node: OmnimanNode, publisher: Publisher, make: Callable[[int, float], Any],
        fill: Callable[[Any, Time, Window], None], horizon: float,
    ) -> None:  # fmt: skip
        self._node, self._make, self._fill = node, make, fill
        self.covered, self.publisher = float("inf"), publisher
        self._message = make(int(horizon / TICK) + 1, TICK)

    def send(self, window: Window) -> None:
        """Publish a part of the stream; its times may be further apart than ticks."""
        message = self._message
        points = min(len(window.times), MAX_POINTS)
        step = float(window.times[1] - window.times[0])
        if points != len(message.points) or not np.isclose(step, TICK, rtol=1e-3):
            message = self._make(points, step)
        self._fill(message, self._node.stamp(window.times[0]), window)
        self.publisher.publish(message)
        self.covered = float(window.times[points - 1])


def platform_previews(node: OmnimanNode, frame: str, horizon: float) -> Previews:
    """Output `path/reference`: poses in a frame."""
    publisher = node.create_publisher(
        MultiDOFJointTrajectory, "path/reference", QoSProfile(depth=1)
    )
    make = functools.partial(conversions.reference_message, frame)
    return Previews(node, publisher, make, conversions.fill_reference, horizon)


def arm_previews(node: OmnimanNode, names: tuple[str, ...], horizon: float) -> Previews:
    """Output `arm/joint_reference`: angles of joints."""
    publisher = node.create_publisher(JointTrajectory, "arm/joint_reference", QoSProfile(depth=1))
    make = functools.partial(arm_conversions.joint_reference_message, names)
    return Previews(node, publisher, make, arm_conversions.fill_joint_reference, horizon)
