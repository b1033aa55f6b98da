"""Node `simulated_world`: simulates the whole robot in a scene, with contacts and laser scans."""

import sys
from typing import TYPE_CHECKING

from builtin_interfaces.msg import Time as TimeMsg

from omniman_ros.extras import WORLD
from omniman_ros.nodes.drive_simulation_node import DriveSimulationNode
from omniman_ros.nodes.runtime import run
from omniman_ros.nodes.scan_publisher import ScanPublisher
from omniman_ros.nodes.simulated_world_parameters import SimulatedWorldParameters
from omniman_ros.nodes.world_arm_link import WorldArmLink
from omniman_ros.nodes.world_reports import WorldReportPublisher
from omniman_ros.simulation.scene_files import load_scene

if TYPE_CHECKING:
    from omniman_ros.simulation.plant.imu import BaseMotion
    from omniman_ros.simulation.world.world import World


class SimulatedWorldNode(DriveSimulationNode[SimulatedWorldParameters]):
    """Drives on a robot in a physics world, of which it also publishes what there is to sense."""

    world: "World"  #: The world
    _arm_link: WorldArmLink | None = None

    def __init__(self, **options: object) -> None:
        super().__init__("simulated_world", SimulatedWorldParameters, **options)
        p = self.settings.value
        self._world_reports = WorldReportPublisher(self, self.world, p)
        self._scans = ScanPublisher(
            self, self.world, p.scanners, p.base_frame, p.state_rate, p.seed
        )
        if p.arm_port and self.world.arm is not None:
            self._arm_link = WorldArmLink(
                self, self.world.arm, self.drives, p.arm_port, self.simulated_clock
            )
        elif p.arm_port:
            self.get_logger().warning("the robot has no arm: arm_port is not used")

    def make_body(self, parameters: SimulatedWorldParameters) -> "World":
        """Return the robot in its scene; raise ParameterError if it would start in something."""
        # Here, so that the parameters of this module can be read without the engine.
        from omniman_ros.simulation.world.world import World

        p = parameters
        self.world = World(p.description, p.simulation, p.world, load_scene(p.scene))
        return self.world

    def base_motion(self) -> "BaseMotion":
        """Return the present motion of base_link, in all six directions."""
        return self.world.base_motion

    def configure(self, new: SimulatedWorldParameters) -> None:
        """Use new parameters, or raise ParameterError and change nothing."""
        super().configure(new)
        self._scans.configure(new.scanners)

    def report_step(self, now: float, stamp: TimeMsg) -> None:
        """Advance the simulation, and publish what is due."""
        super().report_step(now, stamp)
        self._world_reports.publish(stamp)
        self._scans.publish(stamp)
        self._exchange(now)

    def tick(self) -> None:
        """Advance as far as time demands; the arm's controller may have to be waited for."""
        self._exchange(self.now())
        super().tick()

    def _exchange(self, now: float) -> None:
        """Exchange setpoints and states with the arm's controller, once time has begun."""
        if self._arm_link is not None and self.world.time > 0.0:
            self._arm_link.exchange(now)

    # ---- life ---------------------------------------------------------------------------------

    def status(self) -> tuple[bytes, str, list[tuple[str, object]]]:
        """Return level, message and values for the diagnostics."""
        level, message, values = super().status()
        if self._arm_link is not None:
            values.append(("arm_controller_connected", self._arm_link.is_connected))
        return level, message, values

    def begin_shutdown(self, reason: str) -> None:
        """Ramp every wheel and joint to rest."""
        super().begin_shutdown(reason)
        if self._arm_link is not None:
            self._arm_link.disconnect()
            self._arm_link.close()

    @property
    def finished(self) -> bool:
        """Whether wheels and joints are at rest."""
        arm_rests = self._arm_link is None or self._arm_link.at_rest
        return super().finished and arm_rests

    def destroy_node(self) -> None:
        """Close the port, then destroy the node."""
        if self._arm_link is not None:
            self._arm_link.close()
        super().destroy_node()


def main(args: list[str] | None = None) -> int:
    """Entry point of `ros2 run omniman_ros simulated_world`."""
    if not WORLD.is_available:
        sys.stderr.write(f"cannot start: {WORLD.hint}\n")
        return 1
    return run(SimulatedWorldNode, args)
