"""Groups of coordinates whose vectors are limited in length."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from omniman_ros.core.arrays import Array


@dataclass(frozen=True)
class AxisGroup:
    """Coordinates that share limits: x and y of a platform, its heading, a joint of an arm."""

    columns: tuple[int, ...]  #: Indices of the coordinates
    velocity: float  #: Limit of the length of their velocity [m/s or rad/s]
    acceleration: float  #: Limit of the length of their acceleration [m/s^2 or rad/s^2]
    jerk: float  #: Limit of the length of their jerk [m/s^3 or rad/s^3]
    tolerance: float  #: Largest distance from the given path at corners [m or rad]

    def norm(self, values: Array) -> Array:
        """Return the length (...) of the group's part of vectors (..., d)."""
        part = values[..., self.columns]
        length: Array = np.sqrt((part * part).sum(axis=-1))
        return length


def max_utilisation(groups: Sequence[AxisGroup], values: Array, limits: Sequence[float]) -> Array:
    """Return the largest utilisation (...) of any group's limit by vectors (..., d).

    Args:
        limits: Limit of the length of each group's part, in the unit of the values.

    Returns:
        Length over limit of the group that is nearest to its limit or furthest beyond.
    """
    utilisation: Array = np.max(
        [group.norm(values) / limit for group, limit in zip(groups, limits, strict=True)], axis=0
    )
    return utilisation
