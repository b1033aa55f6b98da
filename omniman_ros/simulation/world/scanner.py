"""Laser scanners of the robot."""

import math

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.simulation.world.model.mjcf import ROBOT_GROUP, WORLD_GROUP
from omniman_ros.simulation.world.scanner_parameters import ScannerParameters
from omniman_ros.simulation.world.world import World


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
