"""`joint_trajectory` in: to the arm's port, or to that of the whole body."""

from rclpy.serialization import deserialize_message
from trajectory_msgs.msg import JointTrajectory

from omniman_ros.core.body.model import AXES, PLATFORM_AXES
from omniman_ros.core.errors import InputError
from omniman_ros.nodes.motions.arm_port import ArmPort
from omniman_ros.nodes.motions.body_port import BodyPort
from omniman_ros.nodes.motions.host import Host

POINT_BYTES = 64
"""A point takes less than this on the wire, besides its numbers."""


class TrajectoryInput:
    """The topic, for two ports.

    Args:
        host: The node.
        arm, body: Its ports.
    """

    def __init__(self, host: Host, arm: ArmPort, body: BodyPort) -> None:
        self._host, self._arm, self._body = host, arm, body
        # Bytes, so that a huge trajectory is refused before it is unpacked.
        on_trajectory = host.node.guarded("joint_trajectory", self._on_bytes)
        host.node.create_subscription(
            JointTrajectory, "joint_trajectory", on_trajectory, 10, raw=True
        )

    def _on_bytes(self, data: bytes) -> str:
        most = self._host.options.joint_trajectory.max_points
        if len(data) > (POINT_BYTES + 32 * AXES) * (most + 100):
            raise self._arm.refused(f"{len(data) / 1e6:.0f} MB, at most {most} points are taken")
        message = deserialize_message(data, JointTrajectory)
        if not message.points:
            self._arm.stop()
            self._body.drop()
            self._body.stop()
            return ""
        return self.take(message)

    def take(self, message: JointTrajectory) -> str:
        """Begin a trajectory; returns why it cannot begin now.

        Raises:
            InputError: It cannot be used.
        """
        port = self.port_of(message)
        try:
            if self._host.ending:
                raise InputError("the node ends")
            why = port.trajectory(message)
        except InputError as error:
            raise port.refused(str(error)) from error
        if why:
            port.refused(why)
        return why

    def port_of(self, message: JointTrajectory) -> ArmPort | BodyPort:
        """Whose trajectory it is: where the whole body moves, all are its own."""
        whole = any(name in PLATFORM_AXES for name in message.joint_names)
        return self._body if whole or not self._body.idle else self._arm
