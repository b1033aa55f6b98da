"""Publish the feedback and the ground truth of simulated drives."""

import numpy as np
from builtin_interfaces.msg import Time
from nav_msgs.msg import Odometry
from rclpy.publisher import Publisher
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from omniman_ros.conversions.odometry import fill_odometry
from omniman_ros.conversions.wheels import electrical_message, states_message
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.simulation.plant.lossy_channel import LossyChannel
from omniman_ros.simulation.plant.parameters import FaultParameters
from omniman_ros.simulation.plant.simulated_drives import SimulatedDrives


class DriveReportPublisher:
    """Publishes wheel_states, and at lower rates ground_truth/odom and wheel_electrical.

    Args:
        channel: Channel that loses and delays wheel_states as the faults specify.
        truth_every: Number of reports per message on ground_truth/odom.
        electrical_every: Number of reports per message on wheel_electrical.
    """

    def __init__(
        self,
        node: OmnimanNode,
        wheel_names: list[str],
        channel: LossyChannel[JointState],
        truth_every: int,
        electrical_every: int,
        frames: tuple[str, str],
    ) -> None:
        self._wheel_names, self._channel = wheel_names, channel
        self._truth_every, self._electrical_every = truth_every, electrical_every
        self._states = node.create_publisher(JointState, "wheel_states", 5)
        self._electrical = node.create_publisher(Float64MultiArray, "wheel_electrical", 10)
        self._truth = node.create_publisher(Odometry, "ground_truth/odom", 10)
        world_frame, base_frame = frames
        self._truth_message = Odometry(child_frame_id=base_frame)
        self._truth_message.header.frame_id = world_frame
        self._count = 0

    @property
    def truth_publisher(self) -> Publisher:
        """Publisher of the ground truth."""
        return self._truth

    def publish_truth_with_every_report(self) -> None:
        """Publish the ground truth with every report from now on, the last one included."""
        self._truth_every = 1

    def publish(
        self, drives: SimulatedDrives, faults: FaultParameters, now: float, stamp: Time
    ) -> None:
        """Publish one report."""
        states = drives.wheel_states(now)
        message = states_message(self._wheel_names, states, stamp)
        self._channel.put(message, now, faults.lost_messages, faults.late_messages)
        for due in self._channel.due(now):
            self._states.publish(due)
        self._count += 1
        if self._count % self._truth_every == 0:
            pose, twist = drives.ground_truth()
            fill_odometry(self._truth_message, pose.tolist(), twist, np.zeros((3, 3)), stamp)
            self._truth.publish(self._truth_message)
        if self._count % self._electrical_every == 0:
            self._electrical.publish(electrical_message(drives.electrical()))
