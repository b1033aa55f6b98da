"""What lies below the drive units: motors, wheels and the robot that they move."""

from collections.abc import Sequence
from typing import Protocol

from omniman_ros.core.arrays import Array
from omniman_ros.core.platform import Platform
from omniman_ros.simulation.plant.energy_ledger import EnergyLedger
from omniman_ros.simulation.plant.gear_motor import GearMotor
from omniman_ros.simulation.plant.parameters import SimulationParameters


class WheeledBody(Protocol):
    """A robot on its wheels that voltages at the motors move, one substep at a time."""

    @property
    def wheels(self) -> Sequence[GearMotor]:
        """Gear motors of the wheels, in the robot's order."""

    @property
    def pose(self) -> Array:
        """Pose (x, y, heading) of base_link in the world [m, m, rad], (3,); not wrapped."""

    @property
    def twist(self) -> Array:
        """Twist (vx, vy, w) of base_link in its own frame [m/s, m/s, rad/s], (3,)."""

    @property
    def energy(self) -> EnergyLedger:
        """Energies since the start."""

    def set_pose(self, pose: Sequence[float] | Array) -> None:
        """Move base_link to another pose [m, m, rad], (3,); the motion in its frame continues.

        Raises:
            InputError: There is no room for the robot; it then stays.
        """

    def step(self, voltages: Sequence[float]) -> None:
        """Integrate one substep with voltages (n,) requested from the amplifiers [V]."""

    def configure(self, robot: Platform, parameters: SimulationParameters) -> None:
        """Replace robot data and parameters, both or neither; a ParameterError refuses them."""
