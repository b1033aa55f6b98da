"""Previews of the arm's motion: from `arm/joint_reference` to the streaming process."""

from collections.abc import Sequence

from rclpy.qos import QoSProfile
from trajectory_msgs.msg import JointTrajectory

from omniman_ros.conversions.arm import joint_preview
from omniman_ros.nodes.arm_limit import ArmLimit
from omniman_ros.nodes.hardware_node import HardwareNode
from omniman_ros.ur.joint_preview import JointPreview
from omniman_ros.ur.streaming_client import StreamingClient
from omniman_ros.ur.streaming_messages import Command

TOPIC = "arm/joint_reference"  #: Name of the topic
MAX_STAMP_LEAD = 1.0  #: How far in the future the stamp of a preview may be [s]


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
