"""Laser scanners of the robot."""

import math

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.simulation.world.model.mjcf import ROBOT_GROUP, WORLD_GROUP
from omniman_ros.simulation.world.scanner_parameters import (
    COVERED,
    FROZEN,
    SILENT,
    ScannerParameters,
)
from omniman_ros.simulation.world.world import World


class Scanner:
    """A laser scanner that measures from the robot's present pose, all beams at once."""

    def __init__(self, world: World, parameters: ScannerParameters, seed: int = 0) -> None:
        self._world = world
        self._random = np.random.default_rng(seed)
        self._latest: Array | None = None
        self.configure(parameters)

    def configure(self, parameters: ScannerParameters) -> None:
        """Measure with other parameters from now on; the number of beams stays the same."""
        p = self.parameters = parameters
        self._origin = np.array([p.x, p.y, p.z])
        directions = self.angles + p.yaw + p.turned
        self._directions = np.column_stack(
            [np.cos(directions), np.sin(directions), np.zeros(p.beams)]
        )
        self._groups = (WORLD_GROUP, ROBOT_GROUP) if p.sees_robot else (WORLD_GROUP,)

    @property
    def angles(self) -> Array:
        """Directions of the beams in the scanner's frame [rad], (beams,)."""
        half = 0.5 * self.parameters.field_of_view
        angles: Array = np.linspace(-half, half, self.parameters.beams)
        return angles

    def scan(self) -> Array | None:
        """Return the ranges [m], (beams,); None if the scanner is silent.

        As in REP 117, a range is inf where a beam meets nothing up to the longest range or is
        lost, and -inf where it meets something nearer than the shortest.
        """
        fault = self.parameters.fault
        if fault == SILENT:
            return None
        if fault == COVERED:
            return np.full(self.parameters.beams, -math.inf)
        if fault == FROZEN and self._latest is not None:
            return self._latest
        self._latest = self._measure()
        return self._latest

    def points(self, ranges: Array) -> Array:
        """Return where ranges (beams,) end in the world from its present pose, (k, 2) [m].

        Beams that meet nothing in their range are left out.
        """
        position, rotation = self._world.base_frame
        met = np.isfinite(ranges)
        ends = self._origin + ranges[met, None] * self._directions[met]
        points: Array = (position + ends @ rotation.T)[:, :2]
        return points

    def _measure(self) -> Array:
        p = self.parameters
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
