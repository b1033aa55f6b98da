"""Previews of the arm's motion, and the limit of its speed."""

from collections.abc import Callable, Sequence

import numpy as np
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory

from omniman_ros.conversions.arm import joint_preview
from omniman_ros.core.arrays import Array
from omniman_ros.core.motion_limit import MotionLimit, MotionLimitParameters
from omniman_ros.nodes.hardware_node import HardwareNode
from omniman_ros.nodes.motion_limit_input import subscribe_to_motion_limit
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.ur.joint_preview import JointPreview
from omniman_ros.ur.streaming_client import StreamingClient
from omniman_ros.ur.streaming_messages import Command

TOPIC = "arm/joint_reference"  #: Name of the topic
MAX_STAMP_LEAD = 1.0  #: How far in the future the stamp of a preview may be [s]


class ArmLimit:
    """Subscribes to `motion_limit`, and publishes on `motion_demand` what previews ask for."""

    def __init__(
        self,
        node: OmnimanNode,
        joints: list[str],
        options: MotionLimitParameters,
        send: Callable[[float], None],
    ) -> None:
        self._node, self._joints, self._send = node, joints, send
        self._limit, self._sent = MotionLimit(options), 1.0
        subscribe_to_motion_limit(node, arm=self._limit, on_update=self.send)
        self._demands = node.create_publisher(JointState, "motion_demand", QoSProfile(depth=1))

    def configure(self, options: MotionLimitParameters) -> None:
        """Use other parameters."""
        self._limit.parameters = options

    @property
    def share(self) -> float:
        """Fraction of the speed limits that the arm may use now, 0 to 1."""
        return self._limit.share(self._node.now())

    def send(self) -> None:
        """Send the fraction that applies now; again and again, as the process may be a new one."""
        share = self.share
        if self._limit.parameters.use or share != self._sent:
            self._sent = share
            self._send(share)

    def ask(self, velocities: Array) -> None:
        """Publish the joint rates that a preview with velocities (k, n) [rad/s] asks for first.

        It asks for them even if it is refused because of the limit.
        """
        if not self._limit.parameters.use:
            return
        moving = np.flatnonzero(np.abs(velocities).max(axis=1) > 0.0)
        first = velocities[moving[0] if len(moving) else 0]
        message = JointState(name=self._joints, velocity=first.tolist())
        message.header.stamp = self._node.stamp()
        self._demands.publish(message)


class ArmPreviewInput:
    """Sends the previews on `arm/joint_reference` to the streaming process.

    Args:
        node: Node that subscribes; nothing is sent unless it is active and released.
    """

    def __init__(
        self,
        node: HardwareNode,
        joints: Sequence[str],
        limit: ArmLimit,
        streaming: StreamingClient,
    ) -> None:
        self._node, self._joints = node, list(joints)
        self._limit, self._streaming = limit, streaming
        handler = node.guarded(TOPIC, self._on_preview)
        node.create_subscription(JointTrajectory, TOPIC, handler, QoSProfile(depth=1))

    def _on_preview(self, message: JointTrajectory) -> str:
        start = self._node.instant(message.header.stamp, MAX_STAMP_LEAD)
        arrays = joint_preview(message, start, self._joints)
        JointPreview(*arrays)  # raises here as well, so that a refusal is logged at once
        if not self._node.is_active:
            return "the streamer is not active"
        latch = self._node.latch
        if not latch.released:
            return f"{latch.status.state.value}: {latch.status.reason}"
        self._limit.ask(arrays[2])
        self._streaming.send(Command.PREVIEW, *arrays)
        return ""
