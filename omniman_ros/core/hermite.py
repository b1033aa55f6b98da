"""Hermite interpolation between points at given times, in any number of dimensions."""

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.arrays import Array


class Hermite:
    """A curve through points: quintic polynomials if accelerations are given, else cubic ones.

    Before its first point the curve rests at the first point, after its last point at the last.

    Args:
        times: Times (k,) [s], strictly increasing, k >= 1.
        positions: Positions (k, d) in any unit.
        velocities: Velocities (k, d) in that unit per second.
        accelerations: Accelerations (k, d) in that unit per second squared, or None.
    """

    def __init__(
        self, times: Array, positions: Array, velocities: Array, accelerations: Array | None
    ) -> None:
        self._times = times
        self._time_list: list[float] = times.tolist()
        self._positions = positions
        self._velocities = velocities
        self._accelerations = accelerations
        self._rest: Array = np.zeros(positions.shape[1])
        self._rest.flags.writeable = False
        self._segment = 0

    @property
    def start(self) -> float:
        """Time of the first point [s]."""
        return self._time_list[0]

    @property
    def end(self) -> float:
        """Time of the last point [s]."""
        return self._time_list[-1]

    @property
    def end_speed(self) -> float:
        """Largest component of the last velocity by magnitude; 0 if the curve ends at rest."""
        return float(np.abs(self._velocities[-1]).max())

    def sample(self, now: float) -> tuple[Array, Array, Array]:
        """Return position, velocity and acceleration (d,) at the time `now` [s].

        The segment of the previous call is tried first, so that calls at rising times are fast.
        """
        times = self._time_list
        if now < times[0] or now >= times[-1]:
            return self._positions[0 if now < times[0] else -1], self._rest, self._rest
        i = self._segment
        if not times[i] <= now < times[i + 1]:
            i = int(np.searchsorted(self._times, now, side="right")) - 1
            self._segment = i
        return self._polynomial(i, now - times[i], times[i + 1] - times[i])

    def positions_at(self, times: Array) -> Array:
        """Return the positions (m, d) at times (m,) [s]."""
        if len(self._time_list) == 1:
            return np.repeat(self._positions, len(times), axis=0)
        clipped = np.clip(times, self._time_list[0], self._time_list[-1])
        i = np.searchsorted(self._times, clipped, side="right") - 1
        i = np.minimum(i, len(self._time_list) - 2)
        span = (self._times[i + 1] - self._times[i])[:, None]
        t = (clipped - self._times[i])[:, None]
        u = t / span
        c2, c3, c4, c5 = self._coefficients(i, span)
        result: Array = self._positions[i] + self._velocities[i] * t
        result += u * u * (c2 + u * (c3 + u * (c4 + u * c5)))
        return result

    def _coefficients(
        self, i: int | NDArray[np.intp], span: float | Array
    ) -> tuple[Array, Array, Array, Array]:
        """Return the coefficients of u^2 to u^5 in segments, where u rises from 0 to 1.

        Args:
            i: Index of the segment, or indices (m,).
            span: Duration of the segment [s], or durations (m, 1).

        Returns:
            Four coefficients, (d,) or (m, d) each.
        """
        x0, x1 = self._positions[i], self._positions[i + 1]
        v0, v1 = self._velocities[i], self._velocities[i + 1]
        gap = x1 - x0 - v0 * span
        lift = (v1 - v0) * span
        if self._accelerations is None:
            c4 = np.zeros_like(x0)
            return 3.0 * gap - lift, lift - 2.0 * gap, c4, c4
        a0, a1 = self._accelerations[i], self._accelerations[i + 1]
        c2 = 0.5 * a0 * span * span
        gap, lift, bend = gap - c2, lift - 2.0 * c2, (a1 - a0) * span * span
        c3 = 10.0 * gap - 4.0 * lift + 0.5 * bend
        c4 = -15.0 * gap + 7.0 * lift - bend
        c5 = 6.0 * gap - 3.0 * lift + 0.5 * bend
        return c2, c3, c4, c5

    def _polynomial(self, i: int, t: float, span: float) -> tuple[Array, Array, Array]:
        """Return position, velocity and acceleration (d,) at a time in a segment."""
        x0, v0, u = self._positions[i], self._velocities[i], t / span
        c2, c3, c4, c5 = self._coefficients(i, span)
        position = x0 + v0 * t + u * u * (c2 + u * (c3 + u * (c4 + u * c5)))
        velocity = v0 + u / span * (2 * c2 + u * (3 * c3 + u * (4 * c4 + u * 5 * c5)))
        acceleration = (2 * c2 + u * (6 * c3 + u * (12 * c4 + u * 20 * c5))) / (span * span)
        return position, velocity, acceleration
