"""Invalid messages beside those of the robot's own publishers."""

import math
from collections.abc import Callable
from typing import Any

from nav_msgs.msg import Odometry
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from omniman_ros.conversions.motion_limits import LIMITED
from omniman_ros.core.arm_parameters import UR_JOINTS
from omniman_ros.lab.faults.injections import InvalidContent, Publication

PERIOD = 0.01  #: period of invalid messages [s]
NUMBERS = {
    InvalidContent.NAN: math.nan,
    InvalidContent.INFINITE: math.inf,
    InvalidContent.HUGE: 1e300,
}  #: Numbers that messages consist of


class InvalidMessages:
    """Second publishers of topics, of which at most one sends."""

    def __init__(self, node: Node) -> None:
        self.publication: Publication | None = None
        self._node = node
        self._publishers: dict[str, Publisher] = {}
        node.create_timer(PERIOD, self._send)

    def connect(self, topic: str) -> None:
        """Become a second publisher of a topic, which stays silent until it is disturbed."""
        if topic not in self._publishers:
            kind, _ = TOPICS[topic]
            publisher = self._node.create_publisher(kind, topic, QoSProfile(depth=1))
            self._publishers[topic] = publisher

    def _send(self) -> None:
        if self.publication is None:
            return
        _, make = TOPICS[self.publication.topic]
        message = make(self.publication.content)
        message.header.stamp = self._node.get_clock().now().to_msg()
        self._publishers[self.publication.topic].publish(message)


def _joint_message(names: list[str]) -> Callable[[InvalidContent], JointState]:
    """Return a function that makes invalid joint states."""

    def make(content: InvalidContent) -> JointState:
        if content is InvalidContent.EMPTY:
            return JointState()
        if content is InvalidContent.WRONG_NAMES:
            return JointState(name=["nobody"], position=[0.0], velocity=[0.0], effort=[0.0])
        values = [NUMBERS.get(content, 0.0)] * len(names)
        return JointState(name=names, position=values, velocity=values, effort=values)

    return make


def _odometry_message(content: InvalidContent) -> Odometry:
    message = Odometry()
    message.header.frame_id = "nowhere" if content is InvalidContent.WRONG_FRAME else "odom"
    message.child_frame_id = "base_link"
    value = NUMBERS.get(content, 0.0)
    message.pose.pose.position.x = message.twist.twist.linear.x = value
    message.pose.pose.orientation.w = 1.0
    return message


def _trajectory_message(content: InvalidContent) -> JointTrajectory:
    values = [NUMBERS.get(content, 0.0)] * len(UR_JOINTS)
    points = [
        JointTrajectoryPoint(
            positions=values, velocities=values, time_from_start=Duration(seconds=t).to_msg()
        )
        for t in (0.0, 0.4)
    ]
    return JointTrajectory(joint_names=list(UR_JOINTS), points=points)


_WHEELS = ["front_left", "front_right", "rear_left", "rear_right"]
_wheels, _joints = _joint_message(_WHEELS), _joint_message(list(UR_JOINTS))
TOPICS: dict[str, tuple[type, Callable[[InvalidContent], Any]]] = {
    "wheel_commands": (JointState, _wheels),
    "wheel_states": (JointState, _wheels),
    "odom": (Odometry, _odometry_message),
    "arm/joint_states": (JointState, _joints),
    "arm/joint_reference": (JointTrajectory, _trajectory_message),
    "motion_limit": (JointState, _joint_message(list(LIMITED))),
}  #: Type of each topic that can be disturbed, and the function that makes its messages
