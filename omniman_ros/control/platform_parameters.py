"""Parameters of the platform controller."""

from dataclasses import dataclass

from omniman_ros.control.coupling_controller import CouplingParameters
from omniman_ros.control.dead_wheel import WheelHealthParameters
from omniman_ros.control.held_robot import HeldRobotParameters
from omniman_ros.control.imu import ImuParameters
from omniman_ros.control.limits import TwistLimits
from omniman_ros.control.odometry import OdometryParameters
from omniman_ros.control.position_controller import PositionGains
from omniman_ros.control.stability import StabilityParameters
from omniman_ros.control.wheel_controller import WheelGains
from omniman_ros.core.errors import ParameterError
from omniman_ros.core.motion_limit import MotionLimitParameters
from omniman_ros.core.parameters import inline, parameter
from omniman_ros.core.platform import Platform
from omniman_ros.core.validated import Validated


@dataclass(frozen=True)
class DriveParameters(Validated):
    """Parameters of the use and the monitoring of the wheel drives."""

    mode: str = parameter(
        "velocity",
        "Quantity that the drives follow while a command source drives the robot; stops use "
        "velocity mode.",
        choices=("velocity", "torque", "voltage"),
    )
    feed_forward: bool = parameter(True, "Whether computed torques are fed forward to the drives.")
    offered: tuple[str, ...] = parameter(
        ("velocity", "torque", "voltage"),
        "Modes that the drives support; velocity must be among them.",
        choices=("velocity", "torque", "voltage"),
        read_only=True,
    )
    following_error: float = parameter(
        2.0,
        "Speed error of a wheel that latches a stop once it has lasted following_time.",
        unit="rad/s",
        low=0.01,
        high=1000,
    )
    following_time: float = parameter(
        0.5,
        "Time that a wheel's speed error must last to latch a stop.",
        unit="s",
        low=0.01,
        high=60,
    )
    dead_wheel: str = parameter(
        "stop",
        "Reaction to wheels found without torque: stop the robot, or drive on with the other "
        "wheels as long as they determine the twist well.",
        choices=("stop", "drive_on"),
    )
    dead: tuple[str, ...] = parameter(
        (),
        "Names of wheels known to be without torque: the robot drives with the others. It can be "
        "changed only at rest.",
    )
    dead_limits: float = parameter(
        0.5,
        "Factor on the velocity and acceleration limits while the robot drives without wheels; it "
        "falls further where the others determine the twist weakly.",
        low=0.01,
        high=1,
    )


@dataclass(frozen=True)
class Timeouts(Validated):
    """Times after which inputs are stale, and for which they are held or ignored."""

    cmd_vel: float = parameter(
        0.5,
        "Age from which cmd_vel is stale and the robot ramps down to rest.",
        unit="s",
        low=0.02,
        high=10,
    )
    reference: float = parameter(
        0.2,
        "Time for which the last pose of a preview that ends at rest is held.",
        unit="s",
        low=0.02,
        high=10,
    )
    preview: float = parameter(
        3600.0,
        "Age from which a preview is stale although it goes on. Where its sender is on another "
        "host, set it to a few of the sender's periods.",
        unit="s",
        low=0.02,
        high=3600,
    )
    voltages: float = parameter(
        0.1, "Age from which mpc/voltages are stale.", unit="s", low=0.01, high=10
    )
    cancelled: float = parameter(
        1.0,
        "Time without messages after which a command source that lost control is accepted again; "
        "it must be longer than the period of any source.",
        unit="s",
        low=0.05,
        high=60,
    )
    wheel_states: float = parameter(
        0.2,
        "Age from which wheel_states count as lost and a stop is latched.",
        unit="s",
        low=0.01,
        high=10,
    )


@dataclass(frozen=True, kw_only=True)
class PlatformParameters(Validated):
    """All parameters of the platform controller, including those of the robot.

    Raises:
        ParameterError: The number of wheel scales is neither one nor that of the wheels, the
            drives do not support velocity mode or the selected mode, or a dead wheel is unknown.
    """

    robot: Platform = inline()
    limits: TwistLimits
    drive: DriveParameters
    health: WheelHealthParameters
    held: HeldRobotParameters
    stability: StabilityParameters
    position: PositionGains
    coupling: CouplingParameters
    wheel: WheelGains
    odometry: OdometryParameters
    imu: ImuParameters
    timeouts: Timeouts
    collision_monitor: MotionLimitParameters

    def __post_init__(self) -> None:
        super().__post_init__()
        self.odometry.require_wheel_count(self.robot.wheel_count)
        if "velocity" not in self.drive.offered:
            raise self._refusal("drive.offered", "must include velocity, which stops use")
        if self.drive.mode not in self.drive.offered:
            raise self._refusal("drive.mode", "must be one of drive.offered")
        names = self.robot.wheels.names
        for wheel in self.drive.dead:
            if wheel not in names:
                reason = f"must be a wheel of the robot: {', '.join(names)}"
                raise ParameterError("drive.dead", wheel, reason)
