"""Parameters of the node `odometry` and of the topics of all odometry."""

from dataclasses import dataclass

from omniman_ros.control.wheel_odometry import WheelOdometryParameters
from omniman_ros.core.parameters import inline, parameter
from omniman_ros.core.validated import Validated
from omniman_ros.nodes.frame_parameters import OdomFrame


@dataclass(frozen=True, kw_only=True)
class OdometryTopicParameters(Validated):
    """Rates, frames and variances of the odometry's topics."""

    odom_rate: float = parameter(
        100.0,
        "Rate of odom and /tf, as near as whole numbers of ticks or reports allow.",
        unit="Hz",
        low=1,
        high=1000,
        read_only=True,
    )
    monitor_rate: float = parameter(
        50.0,
        "Rate of coupling_error, as near as whole numbers of ticks or reports allow.",
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
    frame: OdomFrame = inline()
    base_frame: str = parameter("base_link", "Frame of twists.", read_only=True)
    publish_tf: bool = parameter(
        True,
        "Whether odom -> base_link is published on /tf and, with map_is_odom from the start, "
        "map -> odom on /tf_static.",
    )


@dataclass(frozen=True, kw_only=True)
class OdometryNodeParameters(Validated):
    """Parameters of the node: those of its core and of its topics."""

    core: WheelOdometryParameters = inline()
    topics: OdometryTopicParameters = inline()
