"""Moving ellipses on the floor: what the planner knows of obstacles, and where they will be."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Ellipses:
    """M obstacles at one time, each bounded by an ellipse, at constant velocity (MPC 2021, 4.3).

    Attributes:
        time: When they are there [s].
        centers: (M, 2) in odom [m].
        velocities: (M, 2) in odom [m/s].
        semi_axes: (M, 2) half of the diameters along their own x and y [m], above zero.
        angles: (M,) of their own x axis in odom [rad].
        growth: (M,) by which the margin around each grows with the time predicted [m/s].
    """

    time: float
    centers: Array
    velocities: Array
    semi_axes: Array
    angles: Array
    growth: Array

    def __len__(self) -> int:
        return len(self.centers)

    @staticmethod
    def none(time: float = 0.0) -> "Ellipses":
        """No obstacle."""
        empty, flat = np.zeros((0, 2)), np.zeros(0)
        return Ellipses(time, empty, empty, empty, flat, flat)

    def select(self, indices: NDArray[Any]) -> "Ellipses":
        """Those of these indices (or of a mask), in that order."""
        return Ellipses(
            self.time, self.centers[indices], self.velocities[indices], self.semi_axes[indices],
            self.angles[indices], self.growth[indices],
        )  # fmt: skip

    def joined(self, others: "Ellipses") -> "Ellipses":
        """These, and behind them others of the same time."""
        return Ellipses(
            self.time,
            np.concatenate([self.centers, others.centers]),
            np.concatenate([self.velocities, others.velocities]),
            np.concatenate([self.semi_axes, others.semi_axes]),
            np.concatenate([self.angles, others.angles]),
            np.concatenate([self.growth, others.growth]),
        )

    def centers_at(self, times: Array) -> Array:
        """Predicted centres (K, M, 2) [m] at times (K,) [s]."""
        ahead = (times - self.time)[:, None, None]
        result: Array = self.centers + ahead * self.velocities
        return result

    def axes_at(self, times: Array, margin: Array | float = 0.0) -> Array:
        """Semi-axes (K, M, 2) [m] at times (K,), with a margin, one or (M,) [m], and growth."""
        ahead = np.maximum(times - self.time, 0.0)[:, None]
        return inflated(self.semi_axes, margin + ahead * self.growth)


def inflated(semi_axes: Array, margin: Array | float) -> Array:
    """Semi-axes of the tight ellipse that holds an ellipse with a margin around it.

    The axes a + m, b + m would not do. An ellipse of the matrix P, widened by a disc of radius m,
    lies in (1 + 1/s) P + (1 + s) m^2 I for every s > 0; s = sqrt(tr P / (2 m^2)) has the least
    trace.

    Args:
        semi_axes: (..., 2) [m].
        margin: (...) [m], not negative.

    Returns:
        (..., 2) [m]; a circle of radius a becomes one of radius a + m.
    """
    squares = semi_axes * semi_axes
    size = np.sqrt(0.5 * squares.sum(axis=-1))[..., None]
    wide = np.asarray(margin)[..., None]
    # s = size / m: (1 + m / size) P + (1 + size / m) m^2, without dividing by a zero margin.
    result: Array = np.sqrt((1.0 + wide / size) * squares + wide * (wide + size))
    return result
