"""Node `simulated_world`: simulates the whole robot in a scene, with contacts and laser scans."""

import sys
from typing import TYPE_CHECKING

from builtin_interfaces.msg import Time as TimeMsg

from omniman_ros.extras import WORLD
from omniman_ros.nodes.drive_simulation_node import DriveSimulationNode
from omniman_ros.nodes.runtime import run
from omniman_ros.nodes.simulated_world_parameters import SimulatedWorldParameters
from omniman_ros.nodes.world_reports import WorldReportPublisher
from omniman_ros.simulation.scene_files import load_scene

if TYPE_CHECKING:
    from omniman_ros.simulation.plant.imu import BaseMotion
    from omniman_ros.simulation.world.world import World


class SimulatedWorldNode(DriveSimulationNode[SimulatedWorldParameters]):
    """Drives on a robot in a physics world, of which it also publishes what there is to sense.

    Attributes:
        world: The world.
    """

    world: "World"

    def __init__(self, **options: object) -> None:
        super().__init__("simulated_world", SimulatedWorldParameters, **options)
        self._world_reports = WorldReportPublisher(self, self.world, self.settings.value)

    def make_body(self, parameters: SimulatedWorldParameters) -> "World":
        """Return the robot in its scene.

        Args:
            parameters: Parameters of the node.

        Raises:
            ParameterError: The scene or a parameter is refused, or the robot would start in
                something.
        """
        # Here, so that the parameters of this module can be read without the engine.
        from omniman_ros.simulation.world.world import World

        p = parameters
        self.world = World(p.description, p.simulation, p.world, load_scene(p.scene))
        return self.world

    def base_motion(self) -> "BaseMotion":
        """Return the present motion of base_link, in all six directions."""
        return self.world.base_motion

    def configure(self, new: SimulatedWorldParameters) -> None:
        """Use new parameters.

        Raises:
            ParameterError: One of them is refused; nothing is changed then.
        """
        super().configure(new)
        if new.scanner != self.settings.value.scanner:
            self._world_reports.mount(new.scanner)

    def report_step(self, now: float, stamp: TimeMsg) -> None:
        """Advance the simulation, and publish what is due.

        Args:
            now: Time of the drives' clock [s].
            stamp: Stamp of the messages.
        """
        super().report_step(now, stamp)
        self._world_reports.publish(stamp)


def main(args: list[str] | None = None) -> int:
    """Entry point of `ros2 run omniman_ros simulated_world`."""
    if not WORLD.is_available:
        sys.stderr.write(f"cannot start: {WORLD.hint}\n")
        return 1
    return run(SimulatedWorldNode, args)
