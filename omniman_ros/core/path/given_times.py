"""Velocities and accelerations of points that come with times, where they are not given."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def accelerations(times: Array, positions: Array, velocities: Array, first: Array) -> Array:
    """Accelerations (n, d) at which x''' is continuous through given positions and velocities.

    Args:
        times: (n,) [s], increasing, n >= 2.
        positions, velocities: (n, d).
        first: (d,) the acceleration of the first point; that of the last is 0.
    """
    n = len(times)
    result = np.zeros_like(positions)
    result[0] = first
    if n == 2:
        return result
    h = np.diff(times)[:, None]
    step, v = np.diff(positions, axis=0), velocities
    ends = (60.0 * step / h - 24.0 * v[:-1] - 36.0 * v[1:]) / h**2
    begins = (60.0 * step / h - 36.0 * v[:-1] - 24.0 * v[1:]) / h**2
    right = begins[1:] - ends[:-1]
    right[0] += 3.0 / h[0] * first
    low, middle = -3.0 / h[:-1, 0], 9.0 / h[:-1, 0] + 9.0 / h[1:, 0]
    high = -3.0 / h[1:, 0]
    # Gauss's elimination; the diagonal outweighs the rest.
    for i in range(1, n - 2):
        share = low[i] / middle[i - 1]
        middle[i] -= share * high[i - 1]
        right[i] -= share * right[i - 1]
    result[n - 2] = right[-1] / middle[-1]
    for i in range(n - 3, 0, -1):
        result[i] = (right[i - 1] - high[i - 1] * result[i + 1]) / middle[i - 1]
    return result


def least_jerk(
    times: Array, positions: Array, velocity: Array, acceleration: Array
) -> tuple[Array, Array]:
    """Velocities and accelerations (n, d) of the motion with the least integral of x'''^2.

    That is the quintic spline: continuous up to the fourth derivative at all inner points.

    Args:
        times: (n,) [s], increasing, n >= 2.
        positions: (n, d).
        velocity, acceleration: (d,) of the first point; the last one is at rest.
    """
    n, d = positions.shape
    v, a = np.zeros((n, d)), np.zeros((n, d))
    v[0], a[0] = velocity, acceleration
    if n == 2:
        return v, a
    low, middle, high, right = _equations(times, positions)
    right[0] -= low[0] @ np.stack([v[0], a[0]])
    for i in range(1, n - 2):
        share = np.linalg.solve(middle[i - 1].T, low[i].T).T
        middle[i] -= share @ high[i - 1]
        right[i] -= share @ right[i - 1]
    known = np.zeros((2, d))
    for i in range(n - 3, -1, -1):
        known = np.linalg.solve(middle[i], right[i] - high[i] @ known)
        v[i + 1], a[i + 1] = known
    return v, a


def _equations(times: Array, positions: Array) -> tuple[Array, Array, Array, Array]:
    """Blocks (n - 2, 2, 2) for (v, a) of the point before, of this, of the next; right side.

    First row: x''' is continuous; second row: x''''. Each is scaled by the spans around it.
    """
    h = np.diff(times)
    step = np.diff(positions, axis=0)
    p, q = h[:-1], h[1:]  # before and after the point
    low = np.array([[-24.0 / p**2, -3.0 / p], [-168.0 / p**3, -24.0 / p**2]])
    middle = np.array(
        [
            [36.0 / q**2 - 36.0 / p**2, 9.0 / p + 9.0 / q],
            [-192.0 / p**3 - 192.0 / q**3, 36.0 / p**2 - 36.0 / q**2],
        ]
    )
    high = np.array([[24.0 / q**2, -3.0 / q], [-168.0 / q**3, 24.0 / q**2]])
    before, after = step[:-1] / p[:, None], step[1:] / q[:, None]
    p, q = p[:, None], q[:, None]
    jerk = 60.0 * (after / q**2 - before / p**2)
    snap = -360.0 * (after / q**3 + before / p**3)
    blocks = (np.moveaxis(block, 2, 0).copy() for block in (low, middle, high))
    return (*blocks, np.stack([jerk, snap], axis=1))  # type: ignore[return-value]
