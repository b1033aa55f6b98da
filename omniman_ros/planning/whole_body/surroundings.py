"""What the whole body keeps clear of: solids that stand, and solids that move or may move."""

from dataclasses import dataclass, field

import numpy as np

from omniman_ros.collision.solids import UprightSolids
from omniman_ros.collision.surroundings import Surroundings
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError


def _nothing() -> Surroundings:
    return Surroundings.standing(UprightSolids.join([]))


@dataclass(frozen=True)
class Hindrances:
    """Solids around the robot at one time, in odom.

    Attributes:
        time: Time at which the moving ones are where they are said to be [s].
        standing: Solids that stand.
        moving: Solids that move at constant velocity, and those that may walk on at once.
        growth: Rates (M,) at which the margin around each of the moving ones grows [m/s].

    Raises:
        InputError: The growth has the wrong shape, or a value is not finite.
    """

    time: float = 0.0
    standing: UprightSolids = field(default_factory=lambda: UprightSolids.join([]))
    moving: Surroundings = field(default_factory=_nothing)
    growth: Array = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        if self.growth.shape != (len(self.moving),):
            raise InputError(
                f"growth has shape {self.growth.shape}, expected ({len(self.moving)},)"
            )
        solids = self.standing, self.moving.solids
        values = [part for each in solids for part in (each.centre, each.yaw, each.half)]
        values += [self.moving.velocity, self.growth, np.array([self.time])]
        if not all(np.isfinite(part).all() for part in values):
            raise InputError("solids must be finite, and so must their motion and its time")

    def labels(self) -> list[str]:
        """Return a name for each solid, the standing ones first."""
        standing = [f"standing solid {k}" for k in range(len(self.standing))]
        return standing + [f"moving solid {k}" for k in range(len(self.moving))]
