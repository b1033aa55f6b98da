"""Laser scanners of the robot."""

import math
from dataclasses import dataclass

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.core.parameters import parameter
from omniman_ros.simulation.world.model.mjcf import ROBOT_GROUP, WORLD_GROUP
from omniman_ros.simulation.world.world import World


@dataclass(frozen=True, kw_only=True)
class ScannerParameters:
    """Mounting and measurement of a scanner that lies flat; the first beam is its rightmost."""

    x: float = parameter(0.5, "Position in base_link, forward.", unit="m", low=-10, high=10)
    y: float = parameter(0.0, "Position in base_link, left.", unit="m", low=-10, high=10)
    z: float = parameter(0.2, "Height above the floor.", unit="m", low=0, high=10)
    yaw: float = parameter(0.0, "Direction of its middle.", unit="rad", low=-6.3, high=6.3)
    field_of_view: float = parameter(
        4.71238898038469,
        "Angle from the first to the last beam.",
        unit="rad",
        low=0,
        high=math.tau,
    )
    beams: int = parameter(720, "Number of beams.", low=2, high=100_000, read_only=True)
    range_min: float = parameter(0.05, "Shortest range.", unit="m", low=0, high=100)
    range_max: float = parameter(25.0, "Longest range.", unit="m", low=0.1, high=1000)
    noise: float = parameter(0.0, "Standard deviation of a range.", unit="m", low=0, high=1)
    dropouts: float = parameter(0.0, "Probability that a beam is lost.", low=0, high=1)
    sees_robot: bool = parameter(True, "Whether the robot's own parts are in its way.")


class Scanner:
    """A laser scanner that measures from the robot's present pose, all beams at once.

    Args:
        world: The world.
        parameters: Mounting and measurement.
        seed: Seed of noise and dropouts.

    Attributes:
        angles: Directions of the beams in the scanner's frame [rad], (beams,).
    """

    def __init__(self, world: World, parameters: ScannerParameters, seed: int = 0) -> None:
        p = self._parameters = parameters
        self._world = world
        self._random = np.random.default_rng(seed)
        half = 0.5 * p.field_of_view
        self.angles: Array = np.linspace(-half, half, p.beams)
        self._origin = np.array([p.x, p.y, p.z])
        directions = self.angles + p.yaw
        self._directions = np.column_stack(
            [np.cos(directions), np.sin(directions), np.zeros(p.beams)]
        )
        self._groups = (WORLD_GROUP, ROBOT_GROUP) if p.sees_robot else (WORLD_GROUP,)

    def scan(self) -> Array:
        """Return the ranges [m], (beams,).

        As in REP 117, a range is inf where a beam meets nothing up to the longest range or is
        lost, and -inf where it meets something nearer than the shortest.
        """
        p = self._parameters
        position, rotation = self._world.base_frame
        ranges = self._world.engine.rays(
            position + rotation @ self._origin,
            self._directions @ rotation.T,
            p.range_max,
            self._groups,
        )
        missed = ranges < 0.0
        if p.noise:
            ranges += self._random.normal(0.0, p.noise, p.beams)
        ranges[ranges < p.range_min] = -math.inf
        ranges[missed | (ranges > p.range_max)] = math.inf
        if p.dropouts:
            ranges[self._random.random(p.beams) < p.dropouts] = math.inf
        return ranges
