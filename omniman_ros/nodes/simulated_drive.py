"""Node `simulated_drive`: simulates the robot and its wheel drives."""

from dataclasses import replace
from typing import Any

from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import ParameterError
from omniman_ros.nodes.arm_configuration import ArmConfigurationInput
from omniman_ros.nodes.drive_simulation_node import DriveSimulationNode
from omniman_ros.nodes.runtime import run
from omniman_ros.nodes.simulated_drive_parameters import SimulatedDriveParameters
from omniman_ros.simulation.plant.carried_arm import carried_arm


class SimulatedDriveNode(DriveSimulationNode[SimulatedDriveParameters]):
    """Drives on the planar plant, which carries the arm in the posture that it reports."""

    def __init__(self, **options: Any) -> None:
        super().__init__("simulated_drive", SimulatedDriveParameters, **options)
        p = self._parameters_in_use = self.settings.value
        self._posture = ArmConfigurationInput(self, p.arm.joints, self._on_arm_configuration)

    def configure(self, new: SimulatedDriveParameters) -> None:
        """Use new parameters; the arm keeps its posture."""
        super().configure(new)
        self._parameters_in_use = new
        self._posture.repeat()

    def _on_arm_configuration(self, posture: Array) -> None:
        """Move the arm's mass, unless the robot would tip over, which the plant cannot."""
        p = self._parameters_in_use
        if p.robot.arm.mass <= 0.0:
            return
        arm = carried_arm(p.robot.arm, p.mount, posture.tolist())
        try:
            self.drives.configure(replace(p.robot, arm=arm), p.simulation)
        except ParameterError as error:
            self.warn("posture", f"the plant keeps the arm where it was: {error}")


def main(args: list[str] | None = None) -> int:
    """Entry point of `ros2 run omniman_ros simulated_drive`."""
    return run(SimulatedDriveNode, args)
