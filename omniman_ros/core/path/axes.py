"""Coordinates and their limits: groups whose vectors are limited in length."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class AxisGroup:
    """Coordinates that share limits: x and y of a platform, its heading, a joint of an arm.

    Attributes:
        columns: Which coordinates.
        velocity: Largest length of their velocity [m/s or rad/s].
        acceleration: Largest length of their acceleration [m/s^2 or rad/s^2].
        jerk: Largest length of their jerk [m/s^3 or rad/s^3].
        tolerance: How far from the given path they may be at corners [m or rad].
    """

    columns: tuple[int, ...]
    velocity: float
    acceleration: float
    jerk: float
    tolerance: float

    def norm(self, values: Array) -> Array:
        """Length (...) of the group's part of vectors (..., d)."""
        part = values[..., self.columns]
        length: Array = np.sqrt((part * part).sum(axis=-1))
        return length


def largest(groups: Sequence[AxisGroup], values: Array, limits: Sequence[float]) -> Array:
    """Largest share (...) of its limit that a group uses in vectors (..., d)."""
    shares: Array = np.max(
        [group.norm(values) / limit for group, limit in zip(groups, limits, strict=True)], axis=0
    )
    return shares
