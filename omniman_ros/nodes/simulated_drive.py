"""Node `simulated_drive`: the robot's drives and the robot itself, simulated."""

from dataclasses import dataclass

import numpy as np
from builtin_interfaces.msg import Time as TimeMsg
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from rclpy.qos import QoSProfile
from rclpy.time import Time
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from omniman_ros import conversions
from omniman_ros.core.errors import InputError
from omniman_ros.core.parameters import inline, parameter
from omniman_ros.core.robot import Robot
from omniman_ros.core.stop import StopLatch, StopState
from omniman_ros.core.wheel_cascade import DriveMode
from omniman_ros.drive.channel import Channel
from omniman_ros.drive.parameters import SimulationParameters
from omniman_ros.drive.simulated import SimulatedDrives
from omniman_ros.nodes.parameters import ParameterSet
from omniman_ros.nodes.runtime import FUTURE, OmnimanNode, run
from omniman_ros.nodes.stopping import StopPort

SETPOINT = QoSProfile(depth=1)
CLOCK_START = 1.0
"""First time on /clock [s]: a zero stamp would mean now."""
CATCH_UP = 4
"""Reports that one callback makes at most: a simulation that cannot keep up falls behind."""
REST_SPEED = 0.05
"""Wheel speed at which the drives are at rest [rad/s]."""


@dataclass(frozen=True, kw_only=True)
class SimulatedDriveParameters:
    """Parameters of the node: robot, simulation, rates and time."""

    robot: Robot = inline()
    simulation: SimulationParameters = inline()
    state_rate: float = parameter(
        200.0, "Rate of wheel_states.", unit="Hz", low=10, high=1000, read_only=True
    )
    truth_rate: float = parameter(
        100.0, "Rate of ground_truth/odom, at most the state rate.", unit="Hz", low=1, high=1000,
        read_only=True,
    )  # fmt: skip
    electrical_rate: float = parameter(
        50.0, "Rate of wheel_electrical, at most the state rate.", unit="Hz", low=1, high=1000,
        read_only=True,
    )  # fmt: skip
    command_timeout: float = parameter(
        0.1, "Age at which a stamped command is refused.", unit="s", low=0.005, high=10
    )
    publish_clock: bool = parameter(
        False, "Whether simulated time is published on /clock, for nodes with use_sim_time.",
        read_only=True,
    )  # fmt: skip
    real_time_factor: float = parameter(
        1.0, "Speed of /clock over real time.", low=0.01, high=100, read_only=True
    )
    world_frame: str = parameter("map", "Frame of the ground truth.", read_only=True)
    base_frame: str = parameter("base_link", "Frame of its twist.", read_only=True)
    seed: int = parameter(0, "Seed of noise and losses.", low=0, high=2**31, read_only=True)


class SimulatedDriveNode(OmnimanNode):
    """Message plumbing around `drive.simulated.SimulatedDrives`."""

    def __init__(self, **options: object) -> None:
        super().__init__("simulated_drive", **options)
        self._simulated_time: float | None = None
        self.settings = ParameterSet(self, SimulatedDriveParameters)
        p = self.settings.value
        self.drives = SimulatedDrives(p.robot, p.simulation, p.seed)
        self.settings.on_change(self._configure)
        self.latch = StopLatch()
        self._names = list(p.robot.wheels.names)
        self._channel: Channel[JointState] = Channel(p.seed)
        self._reports = 0
        self._make_topics(p)
        self._stop = StopPort(self, self.latch, self._reset, self._halt)
        self._started = super().now()
        if p.publish_clock:
            self._simulated_time = CLOCK_START
        self.drives.advance(self.now())
        self.every(
            1.0 / p.state_rate / (p.real_time_factor if p.publish_clock else 1.0), self.tick
        )

    def _make_topics(self, p: SimulatedDriveParameters) -> None:
        self._states = self.create_publisher(JointState, "wheel_states", 5)
        self._electrical = self.create_publisher(Float64MultiArray, "wheel_electrical", 10)
        self._truth = self.create_publisher(Odometry, "ground_truth/odom", 10)
        self._clock_out = self.create_publisher(Clock, "/clock", 10) if p.publish_clock else None
        self._truth_msg = Odometry(child_frame_id=p.base_frame)
        self._truth_msg.header.frame_id = p.world_frame
        self._truth_every = max(1, round(p.state_rate / p.truth_rate))
        self._electrical_every = max(1, round(p.state_rate / p.electrical_rate))
        for topic, volts in (("wheel_commands", False), ("wheel_voltages", True)):
            handler = self.guarded(topic, lambda message, v=volts: self._on_command(message, v))
            self.create_subscription(JointState, topic, handler, SETPOINT)
        handler = self.guarded("initialpose", self._on_initial_pose)
        self.create_subscription(PoseWithCovarianceStamped, "initialpose", handler, 10)

    # ---- time: this node makes it where it publishes /clock -----------------------------------

    def now(self) -> float:
        """Time that the drives run on [s]."""
        return super().now() if self._simulated_time is None else self._simulated_time

    def stamp(self, at: float | None = None) -> TimeMsg:
        """ROS time of an instant [s], now if it is None."""
        if self._simulated_time is None:
            return super().stamp(at)
        return Time(nanoseconds=round((at or self._simulated_time) * 1e9)).to_msg()

    def age(self, stamp: TimeMsg) -> float:
        """How long ago a stamp was [s]; see OmnimanNode.age."""
        if self._simulated_time is None or (stamp.sec == 0 and stamp.nanosec == 0):
            return super().age(stamp)
        age = self._simulated_time - conversions.time_seconds(stamp)
        if age < -FUTURE:
            raise InputError(f"the stamp is {-age:.3f} s ahead")
        return age

    # ---- inputs -------------------------------------------------------------------------------

    def _on_command(self, message: JointState, volts: bool) -> str:
        command = conversions.wheel_command(message, self._names, volts)
        age = self.age(message.header.stamp)
        if age > self.settings.value.command_timeout:
            raise InputError(f"stale, {age:.3f} s old")
        if self.latch.status.state is StopState.STOPPED:
            asked = command.effort if command.velocity is None else command.velocity
            return f"stopped: {self.latch.status.reason}" if asked.any() else ""
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
        pose, _ = conversions.planar_pose(message, frames)
        self.drives.set_pose(pose)

    def _configure(self, new: SimulatedDriveParameters) -> None:
        self.drives.configure(new.robot, new.simulation)

    # ---- stops: a held drive obeys, as the controller ramps it down; a stopped one ramps itself

    def _halt(self) -> None:
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
        """Report at the state rate; with /clock, as often as simulated time is due."""
        p = self.settings.value
        if self._clock_out is None or self._simulated_time is None:
            self._report()
            return
        due = CLOCK_START + p.real_time_factor * (super().now() - self._started)
        for _ in range(CATCH_UP):
            if self._simulated_time + 1.0 / p.state_rate > due:
                return
            self._simulated_time += 1.0 / p.state_rate
            self._clock_out.publish(Clock(clock=self.stamp()))
            self._report()
        self._started = super().now() - (self._simulated_time - CLOCK_START) / p.real_time_factor

    def _report(self) -> None:
        now, stamp = self.now(), self.stamp()
        states, faults = self.drives.wheel_states(now), self.settings.value.simulation.faults
        message = JointState(
            name=self._names, position=states.position.tolist(),
            velocity=states.velocity.tolist(), effort=states.effort.tolist(),
        )  # fmt: skip
        message.header.stamp = stamp
        if self.drives.stop_reason is not None:
            self.latch.stop(self.drives.stop_reason)
        self._channel.put(message, now, faults.lost_messages, faults.late_messages)
        for due in self._channel.due(now):
            self._states.publish(due)
        self._reports += 1
        if self._reports % self._truth_every == 0:
            pose, twist = self.drives.ground_truth()
            conversions.fill_odometry(
                self._truth_msg, pose.tolist(), twist, np.zeros((3, 3)), stamp
            )
            self._truth.publish(self._truth_msg)
        if self._reports % self._electrical_every == 0:
            self._electrical.publish(conversions.electrical(self.drives.electrical()))
        self._stop.publish()

    # ---- life ---------------------------------------------------------------------------------

    def status(self) -> tuple[bytes, str, list[tuple[str, object]]]:
        """Level, message and values for the diagnostics."""
        energy = self.drives.energy
        values: list[tuple[str, object]] = [
            ("mode", self.drives.mode.value),
            ("ramping_to_rest_by_itself", self.drives.holding),
            ("electrical_energy_J", round(energy.electrical, 3)),
            *((f"{name}_loss_J", round(loss, 3)) for name, loss in energy.losses.items()),
        ]
        if self.latch.status.state is StopState.STOPPED:
            return DiagnosticStatus.ERROR, self.latch.status.reason, values
        if not self.latch.released:
            return DiagnosticStatus.WARN, self.latch.status.reason, values
        return DiagnosticStatus.OK, "running", values

    def begin_shutdown(self, reason: str) -> None:
        """Ramp every wheel to zero."""
        self.latch.stop(f"shutting down: {reason}")
        self._halt()

    @property
    def finished(self) -> bool:
        """Whether the wheels stand."""
        return self._at_rest

    @property
    def patience(self) -> float:
        """How long the ramp may take [s]."""
        speed = float(np.abs(self.drives.wheel_states(self.now()).velocity).max())
        return 1.0 + speed / self.settings.value.simulation.firmware.quick_stop_deceleration


def main(args: list[str] | None = None) -> int:
    """Entry point of `ros2 run omniman_ros simulated_drive`."""
    return run(SimulatedDriveNode, args)
