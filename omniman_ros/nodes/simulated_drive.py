"""Node `simulated_drive`: simulates the robot and its wheel drives."""

from functools import partial

import numpy as np
from builtin_interfaces.msg import Time as TimeMsg
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseWithCovarianceStamped
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState

from omniman_ros.control.wheel_cascade import DriveMode
from omniman_ros.conversions.poses import planar_pose
from omniman_ros.conversions.wheels import wheel_command_from_message
from omniman_ros.core.errors import InputError
from omniman_ros.core.stop import StopLatch, StopState
from omniman_ros.nodes.drive_reports import DriveReportPublisher
from omniman_ros.nodes.omniman_node import MAX_LEAD, OmnimanNode
from omniman_ros.nodes.parameters import ParameterSet
from omniman_ros.nodes.runtime import run
from omniman_ros.nodes.simulated_clock import SimulatedClock
from omniman_ros.nodes.simulated_drive_parameters import SimulatedDriveParameters
from omniman_ros.nodes.stop_interface import StopInterface
from omniman_ros.simulation.plant.lossy_channel import LossyChannel
from omniman_ros.simulation.plant.simulated_drives import SimulatedDrives

SETPOINT = QoSProfile(depth=1)
"""Quality of service of commands: only the latest counts."""
PACE_PERIOD = 5.0
"""Real time between two looks at the pace of simulated time [s]."""
REST_SPEED = 0.05
"""Wheel speed below which the drives count as standing [rad/s]."""


class SimulatedDriveNode(OmnimanNode):
    """Commands a :class:`SimulatedDrives` from topics, and publishes feedback and ground truth.

    With `publish_clock`, the node advances simulated time itself, and publishes it on /clock.
    """

    def __init__(self, **options: object) -> None:
        super().__init__("simulated_drive", **options)
        self._simulated_clock: SimulatedClock | None = None
        self.settings = ParameterSet(self, SimulatedDriveParameters)
        p = self.settings.value
        self.drives = SimulatedDrives(p.robot, p.simulation, p.seed)
        self.settings.on_change(self._configure)
        self.latch = StopLatch()
        self._names = list(p.robot.wheels.names)
        self._reports = DriveReportPublisher(
            self,
            self._names,
            LossyChannel(p.seed),
            truth_every=max(1, round(p.state_rate / p.truth_rate)),
            electrical_every=max(1, round(p.state_rate / p.electrical_rate)),
            frames=(p.world_frame, p.base_frame),
        )
        self._subscribe()
        self._stop = StopInterface(self, self.latch, self._reset, self._halt)
        if p.publish_clock:
            self._simulated_clock = SimulatedClock(
                self, 1.0 / p.state_rate, p.real_time_factor, p.clock_patience, super().now
            )
            self.every(PACE_PERIOD, self._report_pace)
        rate = p.state_rate * (p.real_time_factor if p.publish_clock else 1.0)
        self.every(1.0 / rate, self.tick)

    def _subscribe(self) -> None:
        for topic, volts in (("wheel_commands", False), ("wheel_voltages", True)):
            handler = self.guarded(topic, partial(self._on_command, volts=volts))
            self.create_subscription(JointState, topic, handler, SETPOINT)
        handler = self.guarded("initialpose", self._on_initial_pose)
        self.create_subscription(PoseWithCovarianceStamped, "initialpose", handler, 10)

    def now(self) -> float:
        """Return the time of the drives' clock [s]: with `publish_clock`, simulated time."""
        return super().now() if self._simulated_clock is None else self._simulated_clock.now

    def stamp(self, at: float | None = None) -> TimeMsg:
        """Return the ROS time of an instant of the drives' clock [s]; now if it is None."""
        clock = self._simulated_clock
        return super().stamp(at) if clock is None else clock.stamp(at)

    def age(self, stamp: TimeMsg, max_lead: float = MAX_LEAD) -> float:
        """Return the age of a stamp [s]; see `OmnimanNode.age`."""
        clock = self._simulated_clock
        return super().age(stamp, max_lead) if clock is None else clock.age(stamp, max_lead)

    # ---- inputs -------------------------------------------------------------------------------

    def _on_command(self, message: JointState, volts: bool) -> str:
        command = wheel_command_from_message(message, self._names, volts)
        age = self.age(message.header.stamp)
        if age > self.settings.value.command_timeout:
            raise InputError(f"the command is stale, {age:.3f} s old")
        if self.latch.status.state is StopState.STOPPED:
            requested = command.effort if command.velocity is None else command.velocity
            return f"stopped: {self.latch.status.reason}" if requested.any() else ""
        now = self.now()
        if command.mode is DriveMode.VOLTAGE:
            self.drives.command_voltage(command.effort, now)
        elif command.velocity is None:
            self.drives.command_torque(command.effort, now)
        else:
            self.drives.command_velocity(command.velocity, command.effort, now)
        return ""

    def _on_initial_pose(self, message: PoseWithCovarianceStamped) -> None:
        frames = (self.settings.value.world_frame, "map", "odom")
        pose, _ = planar_pose(message, frames)
        self.drives.set_pose(pose)

    def _configure(self, new: SimulatedDriveParameters) -> None:
        self.drives.configure(new.robot, new.simulation)

    # ---- stops --------------------------------------------------------------------------------

    def _halt(self) -> None:
        """Stop the drives if the latch is stopped; while it holds, the controller ramps down."""
        if self.latch.status.state is StopState.STOPPED:
            self.drives.stop(self.latch.status.reason)

    @property
    def _at_rest(self) -> bool:
        speeds = self.drives.wheel_states(self.now()).velocity
        return bool(np.abs(speeds).max() < REST_SPEED)

    def _reset(self) -> None:
        self.latch.reset(at_rest=self._at_rest)
        self.drives.reset()

    # ---- output -------------------------------------------------------------------------------

    def tick(self) -> None:
        """Publish one report or, with /clock, as many as are due in simulated time."""
        if self._simulated_clock is None:
            self._report()
            return
        for _ in self._simulated_clock.steps():
            self._report()

    def _report_pace(self) -> None:
        report = self._simulated_clock.pace_report() if self._simulated_clock else ""
        if report:
            self.get_logger().info(report)

    def _report(self) -> None:
        now, stamp = self.now(), self.stamp()
        self.drives.advance(now)
        if self.drives.stop_reason is not None:
            self.latch.stop(self.drives.stop_reason)
        faults = self.settings.value.simulation.faults
        self._reports.publish(self.drives, faults, now, stamp)
        self._stop.publish()

    # ---- life ---------------------------------------------------------------------------------

    def status(self) -> tuple[bytes, str, list[tuple[str, object]]]:
        """Return level, message and values for the diagnostics."""
        energy = self.drives.energy
        values: list[tuple[str, object]] = [
            ("mode", self.drives.mode.value),
            ("ramping_to_rest_by_itself", self.drives.holding),
            ("electrical_energy_J", round(energy.electrical, 3)),
            *((f"{name}_loss_J", round(loss, 3)) for name, loss in energy.losses.items()),
        ]
        if self._simulated_clock is not None:
            values.append(("real_time_factor", round(self._simulated_clock.pace, 2)))
        if self.latch.status.state is StopState.STOPPED:
            return DiagnosticStatus.ERROR, self.latch.status.reason, values
        if not self.latch.released:
            return DiagnosticStatus.WARN, self.latch.status.reason, values
        return DiagnosticStatus.OK, "running", values

    def begin_shutdown(self, reason: str) -> None:
        """Ramp every wheel to rest."""
        self.latch.stop(f"shutting down: {reason}")
        self._halt()
        if self._simulated_clock is not None:
            self._simulated_clock.release()

    @property
    def finished(self) -> bool:
        """Whether the wheels are at rest."""
        return self._at_rest

    @property
    def stop_timeout(self) -> float:
        """How long the ramp to rest may take [s], with a margin of 1 s."""
        speed = float(np.abs(self.drives.wheel_states(self.now()).velocity).max())
        return 1.0 + speed / self.settings.value.simulation.firmware.quick_stop_deceleration


def main(args: list[str] | None = None) -> int:
    """Entry point of `ros2 run omniman_ros simulated_drive`."""
    return run(SimulatedDriveNode, args)
