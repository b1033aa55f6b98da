"""Everything the platform controller is set by, declared once."""

from dataclasses import dataclass

from omniman_ros.core.coupling_controller import CouplingParameters
from omniman_ros.core.dead_wheel import WheelHealthParameters
from omniman_ros.core.errors import ParameterError
from omniman_ros.core.limits import TwistLimits
from omniman_ros.core.odometry import OdometryParameters
from omniman_ros.core.parameters import inline, parameter
from omniman_ros.core.position_controller import PositionGains
from omniman_ros.core.robot import Robot
from omniman_ros.core.wheel_controller import WheelGains


@dataclass(frozen=True)
class DriveParameters:
    """How the drives are used and watched."""

    mode: str = parameter(
        "velocity", "What the drives follow while a source drives; stops use velocity mode.",
        choices=("velocity", "torque", "voltage"),
    )  # fmt: skip
    feed_forward: bool = parameter(True, "Whether computed torque is fed forward.")
    offered: tuple[str, ...] = parameter(
        ("velocity", "torque", "voltage"), "Modes that the drives have; velocity is needed.",
        choices=("velocity", "torque", "voltage"), read_only=True,
    )  # fmt: skip
    following_error: float = parameter(
        2.0, "Speed error of a wheel that latches a stop when it lasts.",
        unit="rad/s", low=0.01, high=1000,
    )  # fmt: skip
    following_time: float = parameter(
        0.5, "How long a wheel's speed error must last.", unit="s", low=0.01, high=60
    )
    dead_wheel: str = parameter(
        "stop", "What a wheel without torque does: stop the robot, or drive on with the others "
        "where these determine the twist.", choices=("stop", "drive_on"),
    )  # fmt: skip
    dead: tuple[str, ...] = parameter(
        (), "Wheels known to be dead, by name: the robot drives without them. Only at rest."
    )
    dead_limits: float = parameter(
        0.5, "Share of the velocity and acceleration limits that is left without a wheel.",
        low=0.01, high=1,
    )  # fmt: skip


@dataclass(frozen=True)
class Timeouts:
    """When an input is stale."""

    cmd_vel: float = parameter(
        0.5, "Age at which cmd_vel is stale: the robot ramps to rest.",
        unit="s", low=0.02, high=10,
    )  # fmt: skip
    reference: float = parameter(
        0.2, "How long a preview that ends at rest holds its end.",
        unit="s", low=0.02, high=10,
    )  # fmt: skip
    voltages: float = parameter(
        0.1, "Age at which mpc/voltages are stale.", unit="s", low=0.01, high=10
    )
    cancelled: float = parameter(
        1.0, "How long a source that lost control must be silent to be heard again: longer than "
        "the period of any stream.", unit="s", low=0.05, high=60,
    )  # fmt: skip
    wheel_states: float = parameter(
        0.2, "Age at which wheel_states are lost: a stop is latched.",
        unit="s", low=0.01, high=10,
    )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class PlatformParameters:
    """Everything the platform controller is set by, the robot included."""

    robot: Robot = inline()
    limits: TwistLimits
    drive: DriveParameters
    health: WheelHealthParameters
    position: PositionGains
    coupling: CouplingParameters
    wheel: WheelGains
    odometry: OdometryParameters
    timeouts: Timeouts

    def __post_init__(self) -> None:
        scale, n = self.odometry.wheel_scale, self.robot.wheel_count
        if len(scale) not in (1, n):
            raise ParameterError("odometry.wheel_scale", scale, f"{len(scale)} values, {n} wheels")
        if "velocity" not in self.drive.offered:
            raise ParameterError("drive.offered", self.drive.offered, "stops need velocity mode")
        if self.drive.mode not in self.drive.offered:
            raise ParameterError("drive.mode", self.drive.mode, "the drives do not offer it")
        names = self.robot.wheels.names
        for wheel in self.drive.dead:
            if wheel not in names:
                there = ", ".join(names)
                raise ParameterError("drive.dead", wheel, f"no such wheel; there are {there}")
