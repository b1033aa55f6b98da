"""What is around the robot: upright solids, some of which move."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from omniman_ros.collision.solids import Mask, UprightSolids
from omniman_ros.core.arrays import Array

SLOWEST = 0.02  #: Speed up to which a solid counts as standing [m/s]


@dataclass(frozen=True)
class Surroundings:
    """Solids that stand or move at constant velocity."""

    solids: UprightSolids  #: M solids where they are now
    velocity: Array  #: Velocities (2, M) in the frame of the solids [m/s]

    @staticmethod
    def standing(solids: UprightSolids) -> "Surroundings":
        """Return solids that do not move."""
        return Surroundings(solids, np.zeros((2, len(solids))))

    @staticmethod
    def join(parts: Sequence["Surroundings"]) -> "Surroundings":
        """Return the solids of several surroundings, in their order."""
        solids = UprightSolids.join([part.solids for part in parts])
        velocity = [part.velocity for part in parts] or [np.zeros((2, 0))]
        return Surroundings(solids, np.concatenate(velocity, axis=1))

    def __len__(self) -> int:
        return len(self.solids)

    @property
    def is_moving(self) -> Mask:
        """Whether each solid (M,) moves."""
        moving: Mask = np.hypot(*self.velocity) > SLOWEST
        return moving

    def within(self, place: Array, distance: float, time: float) -> Mask:
        """Return which solids (M,) may come within a distance [m] of a place in a time [s]."""
        m = len(self)
        points = np.stack((np.full(m, place[0]), np.full(m, place[1]), self.solids.lower))
        reach = distance + time * np.hypot(*self.velocity)
        near: Mask = self.solids.point_distances(points) <= reach
        return near

    def select(self, chosen: Mask) -> "Surroundings":
        """Return the solids with a flag."""
        return Surroundings(self.solids.select(np.flatnonzero(chosen)), self.velocity[:, chosen])

    def after(self, time: float) -> UprightSolids:
        """Return the solids a time from now [s]."""
        return replace(self.solids, centre=self.solids.centre + time * self.velocity)
