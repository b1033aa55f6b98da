"""Node `simulated_world`: simulates the whole robot in a scene, with contacts and laser scans."""

from typing import TYPE_CHECKING

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import LaserScan
from std_msgs.msg import Float64MultiArray
from visualization_msgs.msg import MarkerArray

from omniman_ros.conversions.world import (
    contacts_message,
    fill_obstacle_markers,
    obstacle_markers,
    scan_message,
    scanner_transform,
    wheel_loads_message,
)
from omniman_ros.extras import WORLD
from omniman_ros.nodes.drive_simulation_node import DriveSimulationNode
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.runtime import run
from omniman_ros.nodes.simulated_world_parameters import SimulatedWorldParameters
from omniman_ros.nodes.static_transforms import StaticTransforms
from omniman_ros.nodes.world_arm_link import WorldArmLink
from omniman_ros.simulation.scene_files import load_scene
from omniman_ros.simulation.world.scanner_parameters import ScannerParameters

if TYPE_CHECKING:  # needs the physics engine, which is optional
    from omniman_ros.simulation.plant.imu import BaseMotion
    from omniman_ros.simulation.world.world import World


class ScanPublisher:
    """Publishes the scans, and where the scanners are mounted.

    A single scanner publishes on `scan`, several on `NAME/scan`.

    Args:
        state_rate: Number of calls of `publish` in a second [Hz].
    """

    def __init__(
        self,
        node: OmnimanNode,
        world: "World",
        scanners: tuple[ScannerParameters, ...],
        base_frame: str,
        state_rate: float,
        seed: int,
    ) -> None:
        # Here, so that a machine without the engine can import this module.
        from omniman_ros.simulation.world.scanner import Scanner

        self._node, self._base_frame, self._state_rate = node, base_frame, state_rate
        self._scanners = [Scanner(world, p, seed + k) for k, p in enumerate(scanners)]
        topics = [f"{p.name}/scan" for p in scanners] if len(scanners) > 1 else ["scan"]
        self._publishers = [node.create_publisher(LaserScan, topic, 5) for topic in topics]
        self._every = [max(1, round(state_rate / p.rate)) for p in scanners]
        self._mounts = StaticTransforms(node, "scanners.*")
        self._count = 0
        self._publish_transforms()

    def configure(self, scanners: tuple[ScannerParameters, ...]) -> None:
        """Measure with other parameters from now on; their number stays the same."""
        if scanners == tuple(scanner.parameters for scanner in self._scanners):
            return
        for scanner, parameters in zip(self._scanners, scanners, strict=True):
            scanner.configure(parameters)
        self._publish_transforms()

    def _publish_transforms(self) -> None:
        stamp = self._node.stamp()
        self._mounts.publish(
            [
                scanner_transform(scanner.parameters, self._base_frame, stamp)
                for scanner in self._scanners
            ]
        )

    def publish(self, stamp: Time) -> None:
        """Publish what is due in one report."""
        self._count += 1
        for scanner, publisher, every in zip(
            self._scanners, self._publishers, self._every, strict=True
        ):
            ranges = scanner.scan() if self._count % every == 0 else None
            if ranges is not None:
                period = every / self._state_rate
                publisher.publish(scan_message(ranges, scanner.parameters, period, stamp))


class WorldReportPublisher:
    """Publishes contacts, wheel_loads and ground_truth/obstacles."""

    def __init__(
        self, node: OmnimanNode, world: "World", parameters: SimulatedWorldParameters
    ) -> None:
        p = self._parameters = parameters
        self._node, self._world = node, world
        self._loads_every = max(1, round(p.state_rate / p.electrical_rate))
        self._obstacles_every = max(1, round(p.state_rate / p.obstacle_rate))
        self._contacts = node.create_publisher(DiagnosticArray, "contacts", 10)
        self._loads = node.create_publisher(Float64MultiArray, "wheel_loads", 10)
        self._obstacles = node.create_publisher(MarkerArray, "ground_truth/obstacles", 10)
        self._markers = obstacle_markers(world.obstacles, p.world_frame)
        self._count, self._is_touched = 0, False

    def publish(self, stamp: Time) -> None:
        """Publish what is due in one report."""
        p = self._parameters
        self._count += 1
        contacts = self._world.contacts
        if contacts or self._is_touched:
            self._contacts.publish(contacts_message(contacts, p.world_frame, stamp))
        self._is_touched = bool(contacts)
        if self._count % self._loads_every == 0:
            self._loads.publish(wheel_loads_message(self._world.wheel_loads))
        if self._count % self._obstacles_every == 0:
            fill_obstacle_markers(self._markers, self._world.obstacles, stamp)
            self._obstacles.publish(self._markers)


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

    def report_step(self, now: float, stamp: Time) -> None:
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
    return run(SimulatedWorldNode, args, WORLD)
