"""The floor, and how tyres stand on it."""

import math
from dataclasses import dataclass
from xml.etree.ElementTree import Element

from omniman_ros.core.platform import Platform
from omniman_ros.simulation.plant.parameters import PlantParameters
from omniman_ros.simulation.world.model.mjcf import (
    LOOSE,
    ROBOT,
    TYRE,
    WORLD_GROUP,
    Value,
    add,
)

FLOOR = "floor"  #: Name of the floor
IMPEDANCE = 0.9  #: Impedance of tyres: the fraction of a force that keeps their shape
STANDARD_GRAVITY = 9.81  #: Gravity at which the tyres' friction is scaled [m/s^2]


@dataclass(frozen=True)
class Tyres:
    """Contact of the tyres with the floor, each a spring with critical damping.

    MuJoCo's contacts accelerate as a_ref = -b v - k z with a regularisation R: the force is
    (a_ref - a) / R. So 1 / R is a mass, here the wheel's fraction of the robot's mass, and k / R
    the stiffness. Along the floor the same law holds with R over `impratio`, where k is zero:
    friction creeps in proportion to its force, here as fast as the friction of the plant does at
    its beginning.
    """

    stiffness: float  #: Stiffness of a tyre [N/m]
    fraction: float  #: Mass that a wheel carries [kg]
    mu: float  #: Coefficient of friction
    slip_velocity: float  #: Slip at which the plant's friction has 71 % of its bound [m/s]

    @property
    def rate(self) -> float:
        """Angular frequency of the contact [rad/s]."""
        return math.sqrt(self.stiffness / self.fraction)

    @property
    def inverse_weight(self) -> float:
        """Inverse mass at a tyre that makes 1 / R the wheel's fraction of the mass [1/kg]."""
        return IMPEDANCE / ((1.0 - IMPEDANCE) * self.fraction)

    @property
    def impratio(self) -> float:
        """Ratio of frictional to normal impedance."""
        creep = self.mu * STANDARD_GRAVITY / (2.0 * self.rate * self.slip_velocity)
        return max(creep, 1.0)

    @property
    def attributes(self) -> dict[str, Value]:
        """Attributes of the tyres' shapes; `priority` lets them determine the contact."""
        return {
            "priority": "1",
            "friction": (self.mu, 0.0, 0.0),
            "solimp": (IMPEDANCE, IMPEDANCE, 0.001),
            "solref": (-IMPEDANCE * self.rate**2, -2.0 * IMPEDANCE * self.rate),
        }


def tyres_of(robot: Platform, mass: float, plant: PlantParameters, stiffness: float) -> Tyres:
    """Return the contact of a robot's tyres; its mass [kg] includes arm and loads.

    Args:
        stiffness: Stiffness of a tyre [N/m].
    """
    return Tyres(stiffness, mass / robot.wheel_count, robot.friction.mu, plant.slip_velocity)


def add_floor(world: Element) -> None:
    """Add an unbounded floor at a height of zero."""
    add(
        world,
        "geom",
        name=FLOOR,
        type="plane",
        size=(0.0, 0.0, 1.0),
        contype="0",
        conaffinity=str(TYRE | ROBOT | LOOSE),
        group=str(WORLD_GROUP),
    )
