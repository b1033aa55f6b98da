"""Parameters of the node `arm_streamer`."""

from dataclasses import dataclass

from omniman_ros.core.arm_parameters import ArmParameters
from omniman_ros.core.motion_limit import MotionLimitParameters
from omniman_ros.core.parameters import parameter
from omniman_ros.core.validated import Validated
from omniman_ros.ur.parameters import UrParameters


@dataclass(frozen=True, kw_only=True)
class ArmStreamerParameters(Validated):
    """Parameters of the node: the arm, its controller, and how the node starts."""

    arm: ArmParameters
    ur: UrParameters
    collision_monitor: MotionLimitParameters
    simulated_controller: bool = parameter(
        False,
        "Whether the controller is `simulated_ur` on the same /clock; use_sim_time needs it.",
        read_only=True,
    )
    autostart: bool = parameter(
        True,
        "Whether the node configures and activates itself, and retries until the controller "
        "is there.",
        read_only=True,
    )
