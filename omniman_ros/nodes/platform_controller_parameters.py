"""Parameters of the node `platform_controller`."""

from dataclasses import dataclass

from omniman_ros.control.platform_parameters import PlatformParameters
from omniman_ros.core.arm_parameters import ArmParameters
from omniman_ros.core.parameters import inline, parameter
from omniman_ros.core.validated import Validated
from omniman_ros.motion.whole_body.model import Mount
from omniman_ros.nodes.odometry_parameters import OdometryTopicParameters


@dataclass(frozen=True, kw_only=True)
class PlatformControllerParameters(Validated):
    """Parameters of the node: those of its core, of the odometry's topics, and of its own."""

    platform: PlatformParameters = inline()
    topics: OdometryTopicParameters = inline()
    arm: ArmParameters
    mount: Mount
    control_rate: float = parameter(
        200.0, "Rate of the control tick.", unit="Hz", low=25, high=1000, read_only=True
    )
    cmd_vel_stamped: bool = parameter(False, "Whether cmd_vel is a TwistStamped.", read_only=True)
    publish_odom: bool = parameter(
        True,
        "Whether odom, /tf and coupling_error are published; not where the node `odometry` does.",
        read_only=True,
    )
