"""Parameters of the node `viewer`."""

from dataclasses import dataclass

from omniman_ros.core.arm_parameters import ArmParameters
from omniman_ros.core.body.model import Mount
from omniman_ros.core.parameters import REQUIRED, inline, parameter
from omniman_ros.core.robot import Robot


@dataclass(frozen=True)
class DrivingLimits:
    """Bounds of the sliders; the platform controller has the limits that hold."""

    linear_velocity: float = parameter(
        REQUIRED, "Largest linear speed of the buttons.", unit="m/s", low=1e-3, high=20,
        read_only=True,
    )  # fmt: skip
    angular_velocity: float = parameter(
        REQUIRED, "Largest yaw rate of the buttons.", unit="rad/s", low=1e-3, high=50,
        read_only=True,
    )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class ViewerParameters:
    """Parameters of the node: the robot as it looks, where the page is, rates and frames."""

    robot: Robot = inline()
    arm: ArmParameters
    mount: Mount
    limits: DrivingLimits
    host: str = parameter(
        "127.0.0.1", "Address to serve the page on; who can reach it can drive the robot.",
        read_only=True,
    )  # fmt: skip
    port: int = parameter(
        8080, "Port of the page; if it is taken, the next one that is free.", low=1, high=65535,
        read_only=True,
    )  # fmt: skip
    frame_rate: float = parameter(
        25.0, "Frames of the page, while a browser is there.", unit="Hz", low=1, high=60,
        read_only=True,
    )  # fmt: skip
    odom_frame: str = parameter("odom", "Frame of paths, references and goals.", read_only=True)
    map_is_odom: bool = parameter(
        False, "Whether paths, goals and obstacles in `map` are taken for odom.", read_only=True
    )
    base_frame: str = parameter("base_link", "Frame of twists.", read_only=True)
    cmd_vel_stamped: bool = parameter(False, "Whether cmd_vel is a TwistStamped.", read_only=True)

    @property
    def frames(self) -> tuple[str, ...]:
        """Frames that are taken for odom."""
        return (self.odom_frame, "map") if self.map_is_odom else (self.odom_frame,)
