"""Node `simulated_drive`: simulates the robot and its wheel drives."""

from omniman_ros.nodes.drive_simulation_node import DriveSimulationNode
from omniman_ros.nodes.runtime import run
from omniman_ros.nodes.simulated_drive_parameters import SimulatedDriveParameters


class SimulatedDriveNode(DriveSimulationNode[SimulatedDriveParameters]):
    """Drives on the planar plant."""

    def __init__(self, **options: object) -> None:
        super().__init__("simulated_drive", SimulatedDriveParameters, **options)


def main(args: list[str] | None = None) -> int:
    """Entry point of `ros2 run omniman_ros simulated_drive`."""
    return run(SimulatedDriveNode, args)
