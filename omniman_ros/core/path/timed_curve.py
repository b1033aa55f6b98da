"""A motion given by timed positions, velocities and accelerations: quintic polynomials."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

HALVINGS = 27
"""To find where a derivative is zero; a value there is off by the square of what is left."""
_POWERS = np.arange(6.0)


class TimedCurve:
    """x(t) from t = 0 on, with x'' continuous; at rest at the last point and after it.

    Args:
        times: (n,) [s], from 0, strictly increasing, n >= 2.
        positions, velocities, accelerations: (n, d).
    """

    def __init__(
        self, times: Array, positions: Array, velocities: Array, accelerations: Array
    ) -> None:
        self.times = times
        self.positions, self.velocities, self.accelerations = positions, velocities, accelerations

    @property
    def duration(self) -> float:
        """Time of the last point [s]."""
        return float(self.times[-1])

    def sample(self, times: Array) -> tuple[Array, Array, Array]:
        """x, x', x'' (k, d) at times (k,) [s]; before the first point it waits there at rest."""
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
        """Times and values (k, n - 1, d) of x, x', x'', x''' where they are largest and least.

        In each piece a polynomial is looked at at the ends and wherever its derivative is zero.
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
            inner = [_zero(c, a, b) for a, b in zip(nodes, nodes[1:], strict=False)]
            nodes = [nodes[0], *inner, nodes[-1]]
            places.append(np.stack(nodes))
        for order, u in enumerate(reversed(places)):
            values = _value(derivatives[order], u) / spans**order
            yield self.times[:-1, None] + u * spans, values

    def _coefficients(self, i: NDArray[np.intp]) -> Array:
        """Coefficients (6, k, d) of pieces i (k,), in the share of the piece's time."""
        span = (self.times[i + 1] - self.times[i])[:, None]
        x, v, a = self.positions, self.velocities, self.accelerations
        v0, v1 = v[i] * span, v[i + 1] * span
        a0, a1 = a[i] * span**2, a[i + 1] * span**2
        gap, lift, bend = x[i + 1] - x[i] - v0 - 0.5 * a0, v1 - v0 - a0, a1 - a0
        return np.stack(
            [
                x[i], v0, 0.5 * a0, 10.0 * gap - 4.0 * lift + 0.5 * bend,
                -15.0 * gap + 7.0 * lift - bend, 6.0 * gap - 3.0 * lift + 0.5 * bend,
            ]
        )  # fmt: skip


def _value(c: Array, u: Array) -> Array:
    """Polynomials c (m, n, d) at u (..., n, d)."""
    result = np.broadcast_to(c[-1], u.shape)
    for row in c[-2::-1]:
        result = result * u + row
    return result


def _zero(c: Array, low: Array, high: Array) -> Array:
    """Where a polynomial that is monotone from low to high is zero; an end if it is not."""
    rising = _value(c, high) > _value(c, low)
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        before = (_value(c, middle) < 0.0) == rising
        low, high = np.where(before, middle, low), np.where(before, high, middle)
    return 0.5 * (low + high)
