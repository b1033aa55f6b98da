"""Where an inertial measurement unit is mounted on the platform."""

from dataclasses import dataclass

from omniman_ros.core.parameters import parameter
from omniman_ros.core.validated import Validated


@dataclass(frozen=True, kw_only=True)
class ImuMount(Validated):
    """Pose in base_link of an inertial measurement unit whose z axis points upward."""

    x: float = parameter(0.0, "Position in base_link, forward.", unit="m", low=-10, high=10)
    y: float = parameter(0.0, "Position in base_link, left.", unit="m", low=-10, high=10)
    z: float = parameter(0.2, "Height above the floor.", unit="m", low=0, high=10)
    yaw: float = parameter(0.0, "Direction of its x axis.", unit="rad", low=-6.3, high=6.3)
    frame: str = parameter("imu_link", "Frame of imu.", read_only=True)
