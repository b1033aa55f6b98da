"""Base of the nodes that simulate the robot and its wheel drives without a bus."""

from collections.abc import Callable
from functools import partial
from typing import Generic, TypeVar

import numpy as np
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus
from nav_msgs.msg import Odometry
from rclpy.qos import QoSProfile
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Float64MultiArray

from omniman_ros.control.wheel_cascade import DriveMode
from omniman_ros.conversions.imu import imu_message, imu_transform
from omniman_ros.conversions.odometry import fill_odometry
from omniman_ros.conversions.wheels import (
    electrical_message,
    states_message,
    wheel_command_from_message,
)
from omniman_ros.core.errors import InputError
from omniman_ros.core.stop import StopLatch, StopState
from omniman_ros.nodes.initial_pose_input import InitialPoseInput
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.parameters import ParameterSet
from omniman_ros.nodes.simulated_clock import ClockGiverNode
from omniman_ros.nodes.simulated_drive_parameters import SimulatedDriveParameters
from omniman_ros.nodes.static_transforms import StaticTransforms
from omniman_ros.nodes.stop_interface import StopInterface
from omniman_ros.simulation.plant.body import WheeledBody
from omniman_ros.simulation.plant.imu import BaseMotion, SimulatedImu, planar_motion
from omniman_ros.simulation.plant.lossy_channel import LossyChannel
from omniman_ros.simulation.plant.parameters import FaultParameters
from omniman_ros.simulation.plant.simulated_drives import SimulatedDrives

SETPOINT = QoSProfile(depth=1)  #: Quality of service of commands: only the latest counts
P = TypeVar("P", bound=SimulatedDriveParameters)  #: Parameters of the node
#: Shortest period of the simulation's timer [s]: less would leave time for nothing else
SHORTEST_PERIOD = 0.001
REST_SPEED = 0.05  #: Wheel speed below which the drives count as standing [rad/s]


class DriveReportPublisher:
    """Publishes wheel_states, and at lower rates ground_truth/odom and wheel_electrical.

    Args:
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
        node.final_publishers.append(self._truth)  # its last message says that the robot rests
        world_frame, base_frame = frames
        self._truth_message = Odometry(child_frame_id=base_frame)
        self._truth_message.header.frame_id = world_frame
        self._count = 0

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


class DriveCommandInterface:
    """Subscribes to `wheel_commands` and `wheel_voltages`; while stopped, commands do nothing."""

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


class ImuPublisher:
    """Publishes imu, and the pose of its frame on /tf_static."""

    def __init__(
        self,
        node: OmnimanNode,
        parameters: SimulatedDriveParameters,
        motion: Callable[[], BaseMotion],
    ) -> None:
        p = parameters
        self._node, self._motion, self._base_frame = node, motion, p.base_frame
        self._every = max(1, round(p.state_rate / p.imu_rate))
        self._count = 0
        self._imu = SimulatedImu(p.imu, p.imu_sensor, p.simulation.plant.gravity, p.seed)
        self._publisher = node.create_publisher(Imu, "imu", 10)
        self._mount = StaticTransforms(node, "imu.*")
        self.configure(p)

    def configure(self, parameters: SimulatedDriveParameters) -> None:
        """Measure with new parameters from now on."""
        p = parameters
        self._frame = p.imu.frame
        self._imu.configure(p.imu, p.imu_sensor, p.simulation.plant.gravity)
        self._mount.publish([imu_transform(p.imu, self._base_frame, self._node.stamp())])

    def publish(self, now: float, stamp: Time) -> None:
        """Publish a measurement if one is due; call this once a report."""
        self._count += 1
        if self._count % self._every != 0:
            return
        measured = self._imu.measure(now, self._motion())
        if measured is not None:
            self._publisher.publish(imu_message(*measured, self._frame, stamp))


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

    def make_body(self, parameters: P) -> WheeledBody | None:
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

    def report_step(self, now: float, stamp: Time) -> None:
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
