"""Node `can_bridge`: wheel commands to real motor drives on a CAN bus, and their feedback back."""

import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from omniman_ros import conversions
from omniman_ros.can_drive import availability
from omniman_ros.can_drive.phase import Phase
from omniman_ros.core.can_parameters import CanParameters
from omniman_ros.core.errors import InputError
from omniman_ros.core.parameters import inline, parameter
from omniman_ros.core.robot import Robot
from omniman_ros.core.stop import StopLatch, StopState
from omniman_ros.nodes.lifecycle import FAILURE, SUCCESS, HardwareNode, told
from omniman_ros.nodes.parameters import ParameterSet
from omniman_ros.nodes.runtime import run
from omniman_ros.nodes.stopping import StopPort

if TYPE_CHECKING:
    from omniman_ros.can_drive.link import CanLink

SETPOINT = QoSProfile(depth=1)


@dataclass(frozen=True, kw_only=True)
class CanBridgeParameters:
    """Parameters of the node: robot, installation, and how it starts."""

    robot: Robot = inline()
    can: CanParameters
    autostart: bool = parameter(
        True, "Whether it configures and activates itself, again and again until the drives are "
        "there.", read_only=True,
    )  # fmt: skip
    electrical_rate: float = parameter(
        50.0, "Rate of wheel_electrical.", unit="Hz", low=1, high=1000, read_only=True
    )


class CanBridgeNode(HardwareNode):
    """Message plumbing and life cycle around `can_drive.drives.CanDrives`.

    configure opens the bus and configures the drives, activate enables them at zero speed,
    deactivate stops the wheels and takes the power off, cleanup closes the bus. The transitions
    wait for the drives; meanwhile only the bus is served.
    """

    def __init__(self, **options: object) -> None:
        super().__init__("can_bridge", **options)
        self.settings = ParameterSet(self, CanBridgeParameters)
        p = self.settings.value
        p.can.check(p.robot)
        self.link: CanLink | None = None
        self.latch = StopLatch()
        self._active = False
        self._names = list(p.robot.wheels.names)
        self._make_topics(p)
        self._stop = StopPort(self, self.latch, self._reset, self._halt)
        self.settings.on_change(self._configure)
        self.every(p.can.period, self.tick)
        self.every(1.0 / p.electrical_rate, self._report_electrical)
        if p.autostart:
            self.autostart()

    def _make_topics(self, p: CanBridgeParameters) -> None:
        self._states = self.create_publisher(JointState, "wheel_states", 5)
        self._electrical = self.create_publisher(Float64MultiArray, "wheel_electrical", 10)
        for topic, volts in (("wheel_commands", False), ("wheel_voltages", True)):
            handler = self.guarded(topic, lambda message, v=volts: self._on_command(message, v))
            self.create_subscription(JointState, topic, handler, SETPOINT)

    # ---- life cycle ---------------------------------------------------------------------------

    @property
    def is_configured(self) -> bool:
        """Whether the bus is open and the drives are configured."""
        return self.link is not None

    @told
    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Open the bus and configure the drives."""
        # Here, so that a machine without python-can can import this module for its parameters.
        from omniman_ros.can_drive.bus import BusError
        from omniman_ros.can_drive.link import CanLink

        p = self.settings.value
        try:
            self.link = CanLink(p.robot, p.can, self.now, self._wake)
        except BusError as error:
            self.warn("configure", f"not configured: {error}")
            return FAILURE
        drives = self.link.drives
        drives.configure(self.now())
        self.link.run_until(lambda: drives.phase is not Phase.CONFIGURING, 1e9)
        if drives.phase is Phase.IDLE:
            self.get_logger().info(f"configured: {len(self._names)} drives ({p.can.protocol})")
            return SUCCESS
        self.warn("configure", drives.stop_reason)
        self._close()
        return FAILURE

    @told
    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Enable the drives at zero speed."""
        drives = self.link.drives
        if self.latch.status.state is StopState.STOPPED:
            self.warn("activate", f"not activated: stopped: {self.latch.status.reason}")
            return FAILURE
        try:
            drives.enable(self.now())
        except InputError as error:
            self.warn("activate", f"not activated: {error}")
            return FAILURE
        self.link.run_until(lambda: drives.phase is Phase.DRIVING or drives.stop_reason, 1e9)
        if drives.phase is Phase.DRIVING and not drives.stop_reason:
            self._active = True
            self.leave_alone()
            self.get_logger().info("active: the drives hold zero speed")
            return SUCCESS
        self.warn("activate", f"not activated: {drives.stop_reason}")
        self._power_off()
        return FAILURE

    @told
    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop the wheels and take the power off."""
        self._active = False
        self._power_off()
        return SUCCESS

    @told
    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Close the bus."""
        self.leave_alone()
        self._close()
        return SUCCESS

    @told
    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop the wheels, take the power off, close the bus."""
        self.leave_alone()
        return self.on_error(state)

    @told
    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Do the same after an error in a transition; the node is then unconfigured."""
        self._active = False
        self._power_off()
        self._close()
        return SUCCESS

    def _power_off(self) -> None:
        if self.link is None:
            return
        drives = self.link.drives
        drives.disable(self.now())
        if not self.link.run_until(lambda: drives.is_off, drives.longest_stop + 1.0):
            self.get_logger().error("a drive does not say that its power is off")

    def _close(self) -> None:
        if self.link is not None:
            self.link.close()
        self.link = None

    # ---- inputs -------------------------------------------------------------------------------

    def _wake(self) -> None:
        """Have the executor hear what the bus' thread has."""
        if self.executor is not None:
            self.executor.create_task(self._hear)

    def _hear(self) -> None:
        if self.link is not None:
            self.link.hear()
            self._report()

    def _on_command(self, message: JointState, volts: bool) -> str:
        command = conversions.wheel_command(message, self._names, volts)
        age = self.age(message.header.stamp)
        if age > self.settings.value.can.command_timeout:
            raise InputError(f"stale, {age:.3f} s old")
        if not self._active:
            asked = command.effort if command.velocity is None else command.velocity
            return "the bridge is not active" if asked.any() else ""
        return self.link.drives.command(command, self.now() - max(age, 0.0))

    def _configure(self, new: CanBridgeParameters) -> None:
        if self.link is not None:
            self.link.drives.configure_parameters(new.robot, new.can)

    # ---- stops --------------------------------------------------------------------------------

    def _halt(self) -> None:
        if self.link is not None and self.latch.status.state is StopState.STOPPED:
            reason = self.latch.status.reason
            self.link.send(self.link.drives.stop(reason, self.now()))

    def _reset(self) -> None:
        drives = None if self.link is None else self.link.drives
        self.latch.reset(at_rest=drives is None or drives.at_rest(self.now()))
        if drives is not None:
            drives.reset(self.now())

    # ---- output -------------------------------------------------------------------------------

    def tick(self) -> None:
        """Do one period."""
        if self.link is not None:
            self.link.tick()
            self._report()

    def _report(self) -> None:
        drives = self.link.drives
        if drives.stop_reason:
            self.latch.stop(drives.stop_reason)
        states = drives.take_states()
        if states is not None and self._active:
            message = JointState(
                name=self._names, position=states.position.tolist(),
                velocity=states.velocity.tolist(), effort=states.effort.tolist(),
            )  # fmt: skip
            message.header.stamp = self.stamp(states.at)
            self._states.publish(message)
        self._stop.publish()

    def _report_electrical(self) -> None:
        if self._active:
            dt = 1.0 / self.settings.value.electrical_rate
            self._electrical.publish(conversions.electrical(self.link.drives.electrical(dt)))

    # ---- life ---------------------------------------------------------------------------------

    def status(self) -> tuple[bytes, str, list[tuple[str, object]]]:
        """Level, message and values for the diagnostics."""
        if self.link is None:
            return DiagnosticStatus.WARN, "unconfigured", []
        drives, now = self.link.drives, self.now()
        values: list[tuple[str, object]] = [("phase", drives.phase.value)]
        for axis in drives.axes:
            name, feedback = axis.settings.name, axis.feedback
            values += [
                (f"{name} (node {axis.settings.node})", axis.trouble or axis.state.value),
                (f"{name} feedback age ms", f"{1e3 * (now - feedback.at):.1f}"),
                (f"{name} supply V", f"{feedback.bus_voltage:.1f}"),
            ]
        values += [("frames sent", self.link.sent), ("frames heard", self.link.heard)]
        values += [("garbage on the wire", self.link.bus.garbage), *self._counts()]
        if self.latch.status.state is StopState.STOPPED:
            return DiagnosticStatus.ERROR, self.latch.status.reason, values
        if not self.latch.released:
            return DiagnosticStatus.WARN, self.latch.status.reason, values
        if drives.phase is not Phase.DRIVING:
            return DiagnosticStatus.WARN, drives.phase.value, values
        return DiagnosticStatus.OK, "driving", values

    def _counts(self) -> list[tuple[str, object]]:
        return [(f"frames {kind}", n) for kind, n in self.link.drives.lookout.counts.items()]

    def begin_shutdown(self, reason: str) -> None:
        """Stop every wheel; then the power is taken off."""
        self.leave_alone()
        self.latch.stop(f"shutting down: {reason}")
        self._halt()

    @property
    def finished(self) -> bool:
        """Whether the power is off."""
        return self.link is None or self.link.drives.is_off

    @property
    def patience(self) -> float:
        """How long the stop may take [s]."""
        return 1.0 if self.link is None else 1.0 + self.link.drives.longest_stop

    def destroy_node(self) -> None:
        """Close the bus, then the node."""
        self._close()
        super().destroy_node()


def main(args: list[str] | None = None) -> int:
    """Entry point of `ros2 run omniman_ros can_bridge`."""
    if not availability.is_available():
        print(f"cannot start: {availability.HINT}", file=sys.stderr)
        return 1
    return run(CanBridgeNode, args)
