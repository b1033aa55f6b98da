"""Parameters of the node `simulated_can_drives`."""

from dataclasses import dataclass

from omniman_ros.core.can_parameters import CanParameters
from omniman_ros.core.parameters import inline, parameter
from omniman_ros.core.platform import Platform
from omniman_ros.nodes.clock_parameters import ClockParameters
from omniman_ros.simulation.can_drives.parameters import CanFaultParameters
from omniman_ros.simulation.plant.parameters import SimulationParameters


@dataclass(frozen=True, kw_only=True)
class SimulatedCanDrivesParameters(ClockParameters):
    """Parameters of the node: robot, simulation, installation, faults and time."""

    robot: Platform = inline()
    simulation: SimulationParameters = inline()
    can: CanParameters
    can_faults: CanFaultParameters
    bus_port: int = parameter(
        0,
        "With publish_clock, TCP port on this machine at which the drives wait for can_bridge in "
        "place of the bus of can.interface; 0 takes any free one.",
        low=0,
        high=65535,
        read_only=True,
    )
    truth_rate: float = parameter(
        100.0, "Rate of ground_truth/odom.", unit="Hz", low=1, high=1000, read_only=True
    )
    world_frame: str = parameter("map", "Frame of the ground truth.", read_only=True)
    odom_frame: str = parameter(
        "odom",
        "Frame of odometry: another name of world_frame, as long as TF does not relate the two.",
        read_only=True,
    )
    base_frame: str = parameter("base_link", "Frame of its twist.", read_only=True)
    seed: int = parameter(0, "Seed of noise and losses.", low=0, high=2**31, read_only=True)
