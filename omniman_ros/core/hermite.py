"""Points in time joined by polynomials, in any number of dimensions."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Hermite:
    """Quintic polynomials where there are accelerations, cubic ones elsewhere.

    Before its first point it waits there, after its last it stays there, both at rest.

    Args:
        times: (k,) [s], strictly increasing, k >= 1.
        positions: (k, d).
        velocities: (k, d), per second.
        accelerations: (k, d), per second squared, or None.
    """

    def __init__(
        self, times: Array, positions: Array, velocities: Array, accelerations: Array | None
    ) -> None:
        self._times = times
        self._list: list[float] = times.tolist()
        self._positions = positions
        self._velocities = velocities
        self._accelerations = accelerations
        self._rest: Array = np.zeros(positions.shape[1])
        self._rest.flags.writeable = False
        self._segment = 0

    @property
    def start(self) -> float:
        """Time of the first point [s]."""
        return self._list[0]

    @property
    def end(self) -> float:
        """Time of the last point [s]."""
        return self._list[-1]

    @property
    def end_speed(self) -> float:
        """Largest entry of the last point's velocity: 0 if it ends at rest."""
        return float(np.abs(self._velocities[-1]).max())

    def sample(self, now: float) -> tuple[Array, Array, Array]:
        """Position, velocity and acceleration (d,) at a time [s].

        The segment of the last call is tried first.
        """
        times = self._list
        if now < times[0] or now >= times[-1]:
            return self._positions[0 if now < times[0] else -1], self._rest, self._rest
        i = self._segment
        if not times[i] <= now < times[i + 1]:
            i = int(np.searchsorted(self._times, now, side="right")) - 1
            self._segment = i
        return self._polynomial(i, now - times[i], times[i + 1] - times[i])

    def positions_at(self, times: Array) -> Array:
        """Positions (m, d) at times (m,) [s]."""
        if len(self._list) == 1:
            return np.repeat(self._positions, len(times), axis=0)
        held = np.clip(times, self._list[0], self._list[-1])
        i = np.searchsorted(self._times, held, side="right") - 1
        i = np.minimum(i, len(self._list) - 2)
        span = (self._times[i + 1] - self._times[i])[:, None]
        t = (held - self._times[i])[:, None]
        u = t / span
        c2, c3, c4, c5 = self._coefficients(i, span)
        result: Array = self._positions[i] + self._velocities[i] * t
        result += u * u * (c2 + u * (c3 + u * (c4 + u * c5)))
        return result

    def _coefficients(
        self, i: int | NDArray[np.intp], span: float | Array
    ) -> tuple[Array, Array, Array, Array]:
        """Of u^2 to u^5 in the segments i, u = 0 to 1 in each span."""
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
        """Hermite polynomial of segment i, t seconds into its span."""
        x0, v0, u = self._positions[i], self._velocities[i], t / span
        c2, c3, c4, c5 = self._coefficients(i, span)
        position = x0 + v0 * t + u * u * (c2 + u * (c3 + u * (c4 + u * c5)))
        velocity = v0 + u / span * (2 * c2 + u * (3 * c3 + u * (4 * c4 + u * 5 * c5)))
        acceleration = (2 * c2 + u * (6 * c3 + u * (12 * c4 + u * 20 * c5))) / (span * span)
        return position, velocity, acceleration
