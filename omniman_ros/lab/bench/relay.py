"""Baseline of the latency: a node that relays `cmd_vel` to `wheel_commands` without any control.

The relay has the same life cycle, executor, timer and messages as `platform_controller`. It
subscribes to `relay/cmd_vel` and publishes four wheel speeds on `relay/wheel_commands`.
"""

from geometry_msgs.msg import Twist
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState

from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.runtime import run

RATE = 200.0  #: rate of the wheel commands, that of the controller [Hz]
SETPOINT = QoSProfile(depth=1)  #: of topics of which only the last message counts
WHEELS = ("front_left", "front_right", "rear_left", "rear_right")


class RelayNode(OmnimanNode):
    """Publishes the forward velocity of the last twist as the speed of each of four wheels.

    The number is copied: the node does not convert m/s to rad/s.
    """

    def __init__(self, **options: object) -> None:
        super().__init__("relay", **options)
        self._speed = 0.0
        self._publisher = self.create_publisher(JointState, "relay/wheel_commands", SETPOINT)
        self._message = JointState(name=list(WHEELS), effort=[0.0] * len(WHEELS))
        self.create_subscription(Twist, "relay/cmd_vel", self._on_twist, SETPOINT)
        self.every(1.0 / RATE, self._tick)

    def _on_twist(self, message: Twist) -> None:
        self._speed = message.linear.x

    def _tick(self) -> None:
        self._message.header.stamp = self.stamp()
        self._message.velocity = [self._speed] * len(WHEELS)
        self._publisher.publish(self._message)


def main(args: list[str] | None = None) -> int:
    """Run the relay until it is shut down; return its exit code."""
    return run(RelayNode, args)
