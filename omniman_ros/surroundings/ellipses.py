"""Obstacles as moving ellipses, and prediction of their positions."""

from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omniman_ros.core.arrays import Array, Shape
from omniman_ros.core.validated import Validated


@dataclass(frozen=True)
class Ellipses(Validated):
    """M obstacles, each bounded by an ellipse that moves at constant velocity (MPC 2021, 4.3).

    Values that are not finite are let in: the distance to such an obstacle counts as a contact.
    """

    time: float  #: Time at which the obstacles are at their centres [s]
    centers: Annotated[Array, Shape("M", 2, finite=False)]  #: (M, 2) centres in odom [m]
    velocities: Annotated[Array, Shape("M", 2, finite=False)]  #: (M, 2) velocities in odom [m/s]
    #: (M, 2) semi-axes along the ellipses' own x and y axes [m], above zero
    semi_axes: Annotated[Array, Shape("M", 2, low=0.0, unit="m", finite=False)]
    angles: Annotated[
        Array, Shape("M", finite=False)
    ]  #: (M,) angles of the ellipses' x axes in odom [rad]
    #: (M,) rates at which the margin around each grows with predicted time [m/s]
    growth: Annotated[Array, Shape("M", finite=False)]
    #: (M,) heights of the obstacles' lower sides above the floor [m]; by default minus infinity
    lower: Annotated[Array, Shape("M", finite=False, spread=True)] = field(
        default_factory=lambda: np.array(-np.inf)
    )
    #: (M,) heights of their upper sides [m]; by default infinity
    upper: Annotated[Array, Shape("M", finite=False, spread=True)] = field(
        default_factory=lambda: np.array(np.inf)
    )

    def __len__(self) -> int:
        return len(self.centers)

    @staticmethod
    def none(time: float = 0.0) -> "Ellipses":
        """Return an empty set of obstacles at a time [s]."""
        empty, flat = np.zeros((0, 2)), np.zeros(0)
        return Ellipses(time, empty, empty, empty, flat, flat)

    @staticmethod
    def circles(
        time: float, centers: ArrayLike, velocities: ArrayLike, radii: ArrayLike
    ) -> "Ellipses":
        """Return M round obstacles, whose motion is known, so that their margins do not grow.

        Args:
            time: Time at which they are at their centres [s].
            centers: Centres (M, 2) in odom [m].
            velocities: Velocities (M, 2) in odom [m/s], or one (2,) for all.
            radii: Radii (M,) [m], or one for all.
        """
        places = np.array(centers, dtype=np.float64).reshape(-1, 2)
        rates = np.broadcast_to(np.asarray(velocities, dtype=np.float64), places.shape)
        sizes = np.broadcast_to(np.asarray(radii, dtype=np.float64), len(places))
        flat = np.zeros(len(places))
        return Ellipses(time, places, rates, np.column_stack([sizes, sizes]), flat, flat)

    def select(self, indices: NDArray[Any]) -> "Ellipses":
        """Return the obstacles with these indices, in their order, or those of a mask."""
        return Ellipses.unchecked(
            time=self.time,
            centers=self.centers[indices],
            velocities=self.velocities[indices],
            semi_axes=self.semi_axes[indices],
            angles=self.angles[indices],
            growth=self.growth[indices],
            lower=self.lower[indices],
            upper=self.upper[indices],
        )

    def joined(self, others: "Ellipses") -> "Ellipses":
        """Return these obstacles followed by others of the same time."""
        return Ellipses.unchecked(
            time=self.time,
            centers=np.concatenate([self.centers, others.centers]),
            velocities=np.concatenate([self.velocities, others.velocities]),
            semi_axes=np.concatenate([self.semi_axes, others.semi_axes]),
            angles=np.concatenate([self.angles, others.angles]),
            growth=np.concatenate([self.growth, others.growth]),
            lower=np.concatenate([self.lower, others.lower]),
            upper=np.concatenate([self.upper, others.upper]),
        )

    def centers_at(self, times: Array) -> Array:
        """Return the predicted centres (K, M, 2) [m] at times (K,) [s]."""
        ahead = (times - self.time)[:, None, None]
        result: Array = self.centers + ahead * self.velocities
        return result

    def axes_at(self, times: Array, margin: Array | float = 0.0) -> Array:
        """Return the semi-axes (K, M, 2) [m] at times (K,) [s], with a margin and the growth.

        The margin [m] is a single value for all obstacles, or (M,) with one value for each.
        """
        ahead = np.maximum(times - self.time, 0.0)[:, None]
        return inflated(self.semi_axes, margin + ahead * self.growth)


def inflated(semi_axes: Array, margin: Array | float) -> Array:
    """Return the semi-axes (..., 2) of a tight ellipse that contains one and a margin [m].

    The ellipse with the semi-axes a + m and b + m does not. An ellipse of the matrix P, widened by
    a disc of radius m, lies in (1 + 1/s) P + (1 + s) m^2 I for every s > 0; the trace is smallest
    for s = sqrt(tr P / (2 m^2)). A circle of radius a becomes one of radius a + m. The margins
    (...) are not negative.
    """
    squares = semi_axes * semi_axes
    size = np.sqrt(0.5 * squares.sum(axis=-1))[..., None]
    m = np.asarray(margin)[..., None]
    # s = size / m gives (1 + m / size) P + (1 + size / m) m^2, without dividing by a zero margin.
    result: Array = np.sqrt((1.0 + m / size) * squares + m * (m + size))
    return result
