"""Motion through timed positions, velocities and accelerations: quintic polynomials."""

import itertools
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.arrays import FLOAT, Array, Shape
from omniman_ros.core.errors import InputError
from omniman_ros.core.parameters import Place

#: Number of bisections that locate an extreme; the error of its value is of second order
BISECTIONS = 27
_TIMES = Shape("n", unit="s", increasing=True).of(Place("TimedCurve.times"), FLOAT)
_MOTION = tuple(
    Shape("n", "d").of(Place(f"TimedCurve.{name}"), FLOAT)
    for name in ("positions", "velocities", "accelerations")
)
_POWERS = np.arange(6.0)  #: Exponents of the terms of a quintic polynomial


class TimedCurve:
    """Motion x(t) from t = 0 on, with x'' continuous; at rest from the last point on.

    Args:
        times: (n,) times of the points [s], from 0, strictly increasing, n >= 2.
        positions, velocities, accelerations: (n, d) at the points.

    Raises:
        InputError: A shape is wrong, a number is not finite, or the times do not increase.
    """

    def __init__(
        self, times: Array, positions: Array, velocities: Array, accelerations: Array
    ) -> None:
        sizes: dict[str, int] = {}
        self.times: Array = _TIMES.check(times, sizes)
        if len(self.times) < 2:
            raise InputError(f"TimedCurve.times has {len(self.times)} points, expected 2 or more")
        self.positions, self.velocities, self.accelerations = (
            shape.check(values, sizes)
            for shape, values in zip(_MOTION, (positions, velocities, accelerations), strict=True)
        )

    @property
    def duration(self) -> float:
        """Time of the last point [s]."""
        return float(self.times[-1])

    def sample(self, times: Array) -> tuple[Array, Array, Array]:
        """Return x, x', x'' (k, d) at times (k,) [s]; at rest before the first point."""
        i = np.searchsorted(self.times, times, side="right") - 1
        i = np.clip(i, 0, len(self.times) - 2)
        span = (self.times[i + 1] - self.times[i])[:, None]
        u = np.clip((times - self.times[i])[:, None] / span, 0.0, 1.0)
        c = self._coefficients(i)
        x = c[0] + u * (c[1] + u * (c[2] + u * (c[3] + u * (c[4] + u * c[5]))))
        v = c[1] + u * (2 * c[2] + u * (3 * c[3] + u * (4 * c[4] + u * 5 * c[5])))
        a = 2 * c[2] + u * (6 * c[3] + u * (12 * c[4] + u * 20 * c[5]))
        v, a = v / span, a / span**2
        out = (times < 0.0) | (times >= self.duration)
        if out.any():
            x[times >= self.duration] = self.positions[-1]
            v[out] = a[out] = 0.0
        return x, v, a

    def extremes(self) -> Iterator[tuple[Array, Array]]:
        """Yield times [s] and values (k, n - 1, d) of the extremes of x, x', x'' and x'''.

        In each piece a polynomial is evaluated at the ends and wherever its derivative is zero.
        """
        spans = np.diff(self.times)[:, None]
        c = self._coefficients(np.arange(len(spans)))
        derivatives = [c]
        for _ in range(4):
            c = (_POWERS[: len(c)].reshape(-1, 1, 1) * c)[1:]
            derivatives.append(c)
        shape = derivatives[0].shape[1:]
        nodes = [np.zeros(shape), np.ones(shape)]
        places = []
        for c in reversed(derivatives[1:]):
            inner = [_zero(c, a, b) for a, b in itertools.pairwise(nodes)]
            nodes = [nodes[0], *inner, nodes[-1]]
            places.append(np.stack(nodes))
        for order, u in enumerate(reversed(places)):
            values = _value(derivatives[order], u) / spans**order
            yield self.times[:-1, None] + u * spans, values

    def _coefficients(self, i: NDArray[np.intp]) -> Array:
        """Return coefficients (6, k, d) of pieces i (k,) by the elapsed fraction of their time."""
        span = (self.times[i + 1] - self.times[i])[:, None]
        x, v, a = self.positions, self.velocities, self.accelerations
        v0, v1 = v[i] * span, v[i + 1] * span
        a0, a1 = a[i] * span**2, a[i + 1] * span**2
        gap, lift, bend = x[i + 1] - x[i] - v0 - 0.5 * a0, v1 - v0 - a0, a1 - a0
        return np.stack(
            [
                x[i],
                v0,
                0.5 * a0,
                10.0 * gap - 4.0 * lift + 0.5 * bend,
                -15.0 * gap + 7.0 * lift - bend,
                6.0 * gap - 3.0 * lift + 0.5 * bend,
            ]
        )


def _value(c: Array, u: Array) -> Array:
    result = np.broadcast_to(c[-1], u.shape)
    for row in c[-2::-1]:
        result = result * u + row
    return result


def _zero(c: Array, low: Array, high: Array) -> Array:
    rising = _value(c, high) > _value(c, low)
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        before = (_value(c, middle) < 0.0) == rising
        low, high = np.where(before, middle, low), np.where(before, high, middle)
    return 0.5 * (low + high)
