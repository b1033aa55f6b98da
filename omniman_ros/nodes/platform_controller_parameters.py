"""Parameters of the node `platform_controller`."""

from dataclasses import dataclass

from omniman_ros.control.platform_parameters import PlatformParameters
from omniman_ros.core.parameters import inline, parameter


@dataclass(frozen=True, kw_only=True)
class PlatformControllerParameters:
    """Parameters of the node: those of its core, its rates and frames."""

    platform: PlatformParameters = inline()
    control_rate: float = parameter(
        200.0, "Rate of the control tick.", unit="Hz", low=25, high=1000, read_only=True
    )
    odom_rate: float = parameter(
        100.0,
        "Rate of odom and /tf, at most the control rate.",
        unit="Hz",
        low=1,
        high=1000,
        read_only=True,
    )
    monitor_rate: float = parameter(
        50.0,
        "Rate of coupling_error, at most the control rate.",
        unit="Hz",
        low=1,
        high=1000,
        read_only=True,
    )
    twist_variance: float = parameter(
        1e-4,
        "Variance of the twist in odom, for sensor fusion.",
        unit="m^2/s^2, rad^2/s^2",
        low=0,
        high=100,
        read_only=True,
    )
    odom_frame: str = parameter("odom", "Frame of poses and references.", read_only=True)
    base_frame: str = parameter("base_link", "Frame of twists.", read_only=True)
    map_is_odom: bool = parameter(False, "Whether input in `map` counts as odom.")
    cmd_vel_stamped: bool = parameter(False, "Whether cmd_vel is a TwistStamped.", read_only=True)
    publish_tf: bool = parameter(True, "Whether odom -> base_link is published on /tf.")
