"""Base of the nodes that simulate the robot and its wheel drives without a bus."""

from typing import Generic, TypeVar

import numpy as np
from builtin_interfaces.msg import Time as TimeMsg
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.publisher import Publisher

from omniman_ros.core.stop import StopLatch, StopState
from omniman_ros.nodes.clock_giver import ClockGiverNode
from omniman_ros.nodes.drive_command_interface import DriveCommandInterface
from omniman_ros.nodes.drive_reports import DriveReportPublisher
from omniman_ros.nodes.imu_publisher import ImuPublisher
from omniman_ros.nodes.initial_pose_input import InitialPoseInput
from omniman_ros.nodes.parameters import ParameterSet
from omniman_ros.nodes.simulated_drive_parameters import SimulatedDriveParameters
from omniman_ros.nodes.stop_interface import StopInterface
from omniman_ros.simulation.plant.body import Body
from omniman_ros.simulation.plant.imu import BaseMotion, planar_motion
from omniman_ros.simulation.plant.lossy_channel import LossyChannel
from omniman_ros.simulation.plant.simulated_drives import SimulatedDrives

P = TypeVar("P", bound=SimulatedDriveParameters)  #: Parameters of the node
#: Shortest period of the simulation's timer [s]: less would leave time for nothing else
SHORTEST_PERIOD = 0.001
REST_SPEED = 0.05  #: Wheel speed below which the drives count as standing [rad/s]


class DriveSimulationNode(ClockGiverNode, Generic[P]):
    """Commands a :class:`SimulatedDrives` from topics, and publishes feedback and ground truth.

    With `publish_clock`, the node advances simulated time itself, and publishes it on /clock.
    """

    def __init__(self, name: str, kind: type[P], **options: object) -> None:
        super().__init__(name, **options)
        self.settings = ParameterSet(self, kind)
        p = self.settings.value
        self.drives = SimulatedDrives(p.robot, p.simulation, p.seed, self.make_body(p))
        self.settings.on_change(self.configure)
        self.latch = StopLatch()
        names = list(p.robot.wheels.names)
        self._reports = DriveReportPublisher(
            self,
            names,
            LossyChannel(p.seed),
            truth_every=max(1, round(p.state_rate / p.truth_rate)),
            electrical_every=max(1, round(p.state_rate / p.electrical_rate)),
            frames=(p.world_frame, p.base_frame),
        )
        self._imu = ImuPublisher(self, p, self.base_motion)
        DriveCommandInterface(
            self, self.drives, self.latch, names, lambda: self.settings.value.command_timeout
        )
        InitialPoseInput(self, p.world_frame, p.odom_frame, self.drives.set_pose)
        self._stop = StopInterface(self, self.latch, self._reset, self._halt)
        self.give_clock(p, 1.0 / p.state_rate)
        rate = p.state_rate * (p.real_time_factor if p.publish_clock else 1.0)
        self._period = max(1.0 / rate, SHORTEST_PERIOD)
        self._timer = self.create_timer(self._period, self.tick_in_time, clock=self.clock)

    def make_body(self, parameters: P) -> Body | None:
        """Return what the drives of a node with these parameters move; None for the plant."""

    def base_motion(self) -> BaseMotion:
        """Return the present motion of base_link."""
        return planar_motion(self.drives.ground_truth()[1])

    def configure(self, new: P) -> None:
        """Use new parameters, or raise ParameterError and change nothing."""
        self.drives.configure(new.robot, new.simulation)
        self._imu.configure(new)

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

    def tick_in_time(self) -> None:
        """Tick, and give way to other callbacks for a period if that took longer than one.

        An executor whose timer is always due serves nothing else, and does not end.
        """
        begin = super().now()
        self.tick()
        if super().now() - begin > self._period:
            self._timer.reset()

    def tick(self) -> None:
        """Publish one report or, with /clock, as many as are due in simulated time."""
        if self.simulated_clock is None:
            self.report_step(self.now(), self.stamp())
            return
        for _ in self.simulated_clock.steps():
            self.report_step(self.now(), self.stamp())

    def report_step(self, now: float, stamp: TimeMsg) -> None:
        """Advance the simulation to `now` [s], and publish one report."""
        self.drives.advance(now)
        if self.drives.stop_reason is not None:
            self.latch.stop(self.drives.stop_reason)
        faults = self.settings.value.simulation.faults
        self._reports.publish(self.drives, faults, now, stamp)
        self._imu.publish(now, stamp)
        self._stop.publish()

    def status(self) -> tuple[bytes, str, list[tuple[str, object]]]:
        """Return level, message and values for the diagnostics."""
        energy = self.drives.energy
        values: list[tuple[str, object]] = [
            ("mode", self.drives.mode.value),
            ("ramping_to_rest_by_itself", self.drives.holding),
            ("electrical_energy_J", round(energy.electrical, 3)),
            *((f"{name}_loss_J", round(loss, 3)) for name, loss in energy.losses.items()),
        ]
        values += self.pace_values()
        if self.latch.status.state is StopState.STOPPED:
            return DiagnosticStatus.ERROR, self.latch.status.reason, values
        if not self.latch.released:
            return DiagnosticStatus.WARN, self.latch.status.reason, values
        return DiagnosticStatus.OK, "running", values

    def begin_shutdown(self, reason: str) -> None:
        """Ramp every wheel to rest, and publish the ground truth until then."""
        self._reports.publish_truth_with_every_report()
        self.latch.shut_down(reason)
        self._halt()
        super().begin_shutdown(reason)

    @property
    def finished(self) -> bool:
        """Whether the wheels are at rest."""
        return self._at_rest

    @property
    def stop_timeout(self) -> float:
        """How long the ramp to rest may take [s], with a margin of 1 s."""
        speed = float(np.abs(self.drives.wheel_states(self.now()).velocity).max())
        return 1.0 + speed / self.settings.value.simulation.firmware.quick_stop_deceleration

    @property
    def final_publishers(self) -> tuple[Publisher, ...]:
        """Publisher of the ground truth, whose last message tells that the robot is at rest."""
        return (self._reports.truth_publisher,)
