"""Parameters of the node `simulated_world`."""

from dataclasses import dataclass

from omniman_ros.core.errors import ParameterError
from omniman_ros.core.parameters import parameter
from omniman_ros.description.parameters import DescriptionParameters
from omniman_ros.nodes.simulated_drive_parameters import SimulatedDriveParameters
from omniman_ros.simulation.world.parameters import WorldParameters
from omniman_ros.simulation.world.scanner_parameters import ScannerParameters

#: Rate of the arm's controller [Hz]; it must not have to run twice for a step of /clock
CONTROLLER_RATE = 125.0


@dataclass(frozen=True, kw_only=True)
class SimulatedWorldParameters(SimulatedDriveParameters):
    """Parameters of the node: those of `simulated_drive`, the world and the scanners."""

    world: WorldParameters
    scanners: tuple[ScannerParameters, ...]
    scene: str = parameter(
        "workshop",
        "Scene: a name in share/omniman_ros/config/worlds or the path of a YAML file.",
        read_only=True,
    )
    arm_port: int = parameter(
        0,
        "TCP port on this machine at which simulated_ur moves the arm; 0 holds it in "
        "world.posture.",
        low=0,
        high=65535,
        read_only=True,
    )
    obstacle_rate: float = parameter(
        20.0,
        "Rate of ground_truth/obstacles, at most the state rate.",
        unit="Hz",
        low=1,
        high=1000,
        read_only=True,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        _ = self.description
        if self.arm_port and self.publish_clock and self.state_rate < CONTROLLER_RATE:
            reason = f"must be at least {CONTROLLER_RATE:g} Hz with publish_clock and arm_port"
            raise self._refusal("state_rate", reason)
        names = tuple(scanner.name for scanner in self.scanners)
        if len(set(names)) < len(names):
            raise ParameterError("scanners.name", names, "two scanners have the same name")

    @property
    def description(self) -> DescriptionParameters:
        """The robot with its arm."""
        return DescriptionParameters(robot=self.robot, arm=self.arm, mount=self.mount)
