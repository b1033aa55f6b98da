"""Parameters of the node `can_bridge`."""

from dataclasses import dataclass

from omniman_ros.core.can_parameters import CanParameters
from omniman_ros.core.errors import ParameterError
from omniman_ros.core.parameters import inline, parameter
from omniman_ros.core.platform import Platform
from omniman_ros.core.validated import Validated


@dataclass(frozen=True, kw_only=True)
class CanBridgeParameters(Validated):
    """Parameters of the node: robot, installation, and automatic start."""

    robot: Platform = inline()
    can: CanParameters
    autostart: bool = parameter(
        True,
        "Whether the node starts itself, and retries until the drives are there.",
        read_only=True,
    )
    simulated_bus_port: int = parameter(
        0,
        "With use_sim_time, TCP port on this machine at which simulated_can_drives, with "
        "publish_clock, takes the place of the bus; 0 for the bus of can.interface.",
        low=0,
        high=65535,
        read_only=True,
    )
    electrical_rate: float = parameter(
        50.0, "Rate of wheel_electrical.", unit="Hz", low=1, high=1000, read_only=True
    )


def require_time_of_bus(port: int, is_simulated: bool) -> None:
    """Raise ParameterError unless `use_sim_time` goes with the simulated bus, and only it."""
    if is_simulated is not bool(port):
        reason = "a bus runs on real time, and the one at simulated_bus_port on /clock"
        raise ParameterError("use_sim_time", is_simulated, reason)
