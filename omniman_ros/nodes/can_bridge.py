"""Node `can_bridge`: wheel commands to motor drives on a CAN bus, and their feedback back."""

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, UInt32MultiArray

from omniman_ros.conversions.wheels import (
    electrical_message,
    restarts_message,
    states_message,
    wheel_command_from_message,
)
from omniman_ros.core.stop import StopState
from omniman_ros.extras import CAN
from omniman_ros.nodes.can_bridge_parameters import CanBridgeParameters, require_time_of_bus
from omniman_ros.nodes.hardware_node import HardwareError, HardwareNode
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.parameters import ParameterSet
from omniman_ros.nodes.runtime import run
from omniman_ros.nodes.stop_interface import LATCHED

if TYPE_CHECKING:  # needs python-can, which is optional
    from omniman_ros.can_drives.link import CanLink, OpenBus

COMMAND_QOS = QoSProfile(depth=1)  #: Quality of service of commands: only the newest one counts


class WheelReportPublisher:
    """Publishes `wheel_states`, `wheel_electrical` and `wheel_restarts`."""

    def __init__(self, node: OmnimanNode, wheel_names: Sequence[str]) -> None:
        self._node, self._wheel_names = node, list(wheel_names)
        self._states = node.create_publisher(JointState, "wheel_states", 5)
        self._electrical = node.create_publisher(Float64MultiArray, "wheel_electrical", 10)
        self._restarts = node.create_publisher(UInt32MultiArray, "wheel_restarts", LATCHED)
        self._published_restarts: tuple[int, ...] = ()

    def publish(self, link: "CanLink", is_active: bool) -> None:
        """Publish new restarts of the drives and, while the node is active, the wheels' states."""
        if link.drives.restarts != self._published_restarts:
            self._published_restarts = link.drives.restarts
            self._restarts.publish(restarts_message(self._published_restarts))
        states = link.drives.take_states()
        if states is not None and is_active:
            stamp = self._node.stamp(states.at)
            self._states.publish(states_message(self._wheel_names, states, stamp))

    def publish_electrical(self, link: "CanLink", dt: float) -> None:
        """Publish the motors' voltages, currents and energies, which grow over `dt` [s]."""
        self._electrical.publish(electrical_message(link.drives.electrical(dt)))


class CanBridgeNode(HardwareNode):
    """Connects topics, services and the life cycle to `can_drives.link.CanLink`.

    configure opens the bus and configures the drives, activate enables them at zero speed,
    deactivate stops the wheels and takes the power off, cleanup closes the bus. The transitions
    wait for the drives; meanwhile only the bus is served.
    """

    def __init__(self, *, open_bus: "OpenBus | None" = None, **options: Any) -> None:
        super().__init__("can_bridge", allow_sim_time=True, **options)
        self.settings = ParameterSet(self, CanBridgeParameters)
        p = self.settings.value
        if open_bus is None:
            require_time_of_bus(p.simulated_bus_port, self.is_simulated)
        p.can.check(p.robot)
        self.link: CanLink | None = None
        self._open_bus, self._names = open_bus, list(p.robot.wheels.names)
        self._reports = WheelReportPublisher(self, self._names)
        for topic, is_voltage in (("wheel_commands", False), ("wheel_voltages", True)):
            handler = self.guarded(topic, partial(self._on_command, is_voltage=is_voltage))
            self.create_subscription(JointState, topic, handler, COMMAND_QOS)
        self.settings.on_change(self._update_parameters)
        self.every(p.can.period, self.tick)
        self.every(1.0 / p.electrical_rate, self._publish_electrical)
        self.begin(p.autostart)

    @property
    def is_configured(self) -> bool:
        """Whether the bus is open and the drives are configured."""
        return self.link is not None

    @property
    def is_hardware_off(self) -> bool:
        """Whether no drive has power on its motor."""
        return self.link is None or self.link.drives.is_off

    @property
    def may_have_moved(self) -> bool:
        """Whether a command has asked for motion, or a wheel has rotated under power."""
        return self.link is not None and self.link.drives.may_have_moved

    @property
    def start_fault(self) -> str:
        """Why the drives are stopped: a new configuration listens to the bus and resets faults."""
        return "" if self.link is None else self.link.stop_reason

    def open_hardware(self) -> str:
        """Open the bus and configure the drives."""
        # Imported here, so that this module's parameters can be read without python-can.
        from omniman_ros.can_drives.bus import BusError
        from omniman_ros.can_drives.link import CanLink
        from omniman_ros.nodes.paced_bus import bus_opener

        p = self.settings.value
        open_bus = self._open_bus or bus_opener(p.simulated_bus_port, self.now, self.poll_clock)
        try:
            self.link = CanLink(p.robot, p.can, self.now, self.wake, open_bus)
        except BusError as error:
            raise HardwareError(str(error)) from error
        if reason := self.link.configure():
            raise HardwareError(reason)
        return self.link.description

    def enable_hardware(self) -> str:
        """Enable the drives at zero speed."""
        if self.link is None:
            raise HardwareError("the bus is not open")
        if reason := self.link.enable():
            raise HardwareError(reason)
        return "the drives hold zero speed"

    def disable_hardware(self) -> None:
        """Stop the wheels and take the power off."""
        if self.link is not None and not self.link.power_off():
            self.get_logger().error("a drive does not report that its power is off")

    def close_hardware(self) -> None:
        """Close the bus."""
        if self.link is not None:
            self.link.close()
        self.link = None

    def reset_hardware(self) -> None:
        """Open a bus that has failed anew, reset the latch, then the drives."""
        from omniman_ros.can_drives.bus import BusError

        at_rest, fault = self.link is None or self.link.at_rest, ""
        if self.link is not None and at_rest:
            try:
                self.link.reopen_failed_bus()
            except BusError as error:
                fault = str(error)
        self.latch.reset(at_rest=at_rest, fault=fault)
        if self.link is not None:
            self.link.reset()

    def follow_latch(self) -> None:
        """Stop the drives if the latch is stopped."""
        if self.link is not None and self.latch.status.state is StopState.STOPPED:
            self.link.stop(self.latch.status.reason)

    def receive(self) -> None:
        """Process the received frames, and publish what they report."""
        if self.link is not None:
            self.link.receive()
            self._publish(self.link)

    @property
    def progress(self) -> float:
        """Simulated time up to which frames were exchanged [s]; the drives learn it, too."""
        self.receive()
        if self.link is not None:
            self.link.send(())
        return self.now()

    def tick(self) -> None:
        """Run the link for one period, and publish what the drives report."""
        if self.link is not None:
            self.link.tick()
            self._publish(self.link)

    def _on_command(self, message: JointState, is_voltage: bool) -> str:
        command = wheel_command_from_message(message, self._names, is_voltage)
        age = self.age(message.header.stamp)
        if self.link is None or not self.is_active:
            values = command.effort if command.velocity is None else command.velocity
            return "the bridge is not active" if values.any() else ""
        return self.link.set_command(command, max(age, 0.0))

    def _update_parameters(self, new: CanBridgeParameters) -> None:
        if self.link is not None:
            self.link.drives.update_parameters(new.robot, new.can)

    def _publish(self, link: "CanLink") -> None:
        if link.stop_reason and not self.is_starting:
            self.latch.stop(link.stop_reason)
        self._reports.publish(link, self.is_active)
        self.stop_interface.publish()

    def _publish_electrical(self) -> None:
        if self.link is not None and self.is_active:
            self._reports.publish_electrical(self.link, 1.0 / self.settings.value.electrical_rate)

    def status(self) -> tuple[bytes, str, list[tuple[str, object]]]:
        """Return level, message and values for the diagnostics."""
        if self.link is None:
            return DiagnosticStatus.WARN, "unconfigured", []
        level = DiagnosticStatus.OK if self.link.is_driving else DiagnosticStatus.WARN
        stopped = self.stop_diagnostics()
        return *(stopped or (level, self.link.drives.phase.value)), self.link.diagnostics()

    @property
    def stop_timeout(self) -> float:
        """How long the drives may take to come to rest and switch their power off [s]."""
        return 1.0 if self.link is None else self.link.stop_timeout


def main(args: list[str] | None = None) -> int:
    """Entry point of `ros2 run omniman_ros can_bridge`."""
    return run(CanBridgeNode, args, CAN)
