"""Parameters of the node `can_bridge`."""

from dataclasses import dataclass

from omniman_ros.core.can_parameters import CanParameters
from omniman_ros.core.parameters import inline, parameter
from omniman_ros.core.robot import Robot


@dataclass(frozen=True, kw_only=True)
class CanBridgeParameters:
    """Parameters of the node: robot, installation, and automatic start."""

    robot: Robot = inline()
    can: CanParameters
    autostart: bool = parameter(
        True,
        "Whether the node starts itself, and retries until the drives are there.",
        read_only=True,
    )
    electrical_rate: float = parameter(
        50.0, "Rate of wheel_electrical.", unit="Hz", low=1, high=1000, read_only=True
    )
