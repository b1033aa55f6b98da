"""Commands to simulated drives from topics."""

from collections.abc import Callable
from functools import partial

from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState

from omniman_ros.control.wheel_cascade import DriveMode
from omniman_ros.conversions.wheels import wheel_command_from_message
from omniman_ros.core.errors import InputError
from omniman_ros.core.stop import StopLatch, StopState
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.simulation.plant.simulated_drives import SimulatedDrives

SETPOINT = QoSProfile(depth=1)  #: Quality of service of commands: only the latest counts


class DriveCommandInterface:
    """Subscribes to `wheel_commands` and `wheel_voltages`; while stopped, commands do nothing.

    Args:
        timeout: Returns the age at which a stamped command is refused [s].
    """

    def __init__(
        self,
        node: OmnimanNode,
        drives: SimulatedDrives,
        latch: StopLatch,
        wheel_names: list[str],
        timeout: Callable[[], float],
    ) -> None:
        self._node, self._drives, self._latch = node, drives, latch
        self._wheel_names, self._timeout = wheel_names, timeout
        for topic, volts in (("wheel_commands", False), ("wheel_voltages", True)):
            handler = node.guarded(topic, partial(self._on_command, volts=volts))
            node.create_subscription(JointState, topic, handler, SETPOINT)

    def _on_command(self, message: JointState, volts: bool) -> str:
        command = wheel_command_from_message(message, self._wheel_names, volts)
        age = self._node.age(message.header.stamp)
        if age > self._timeout():
            raise InputError(f"the command is stale, {age:.3f} s old")
        if self._latch.status.state is StopState.STOPPED:
            requested = command.effort if command.velocity is None else command.velocity
            return f"stopped: {self._latch.status.reason}" if requested.any() else ""
        now = self._node.now()
        if command.mode is DriveMode.VOLTAGE:
            self._drives.command_voltage(command.effort, now)
        elif command.velocity is None:
            self._drives.command_torque(command.effort, now)
        else:
            self._drives.command_velocity(command.velocity, command.effort, now)
        return ""
