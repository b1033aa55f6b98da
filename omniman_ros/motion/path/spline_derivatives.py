"""Velocities and accelerations of timed points that come without them."""

import numpy as np

from omniman_ros.core.arrays import Array


def accelerations(times: Array, positions: Array, velocities: Array, first: Array) -> Array:
    """Return accelerations (n, d) that make x''' continuous at the inner points.

    Args:
        times: (n,) increasing times of the points [s], n >= 2.
        positions, velocities: (n, d) at the points.
        first: (d,) acceleration of the first point; that of the last point is 0.
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
    # Gaussian elimination without pivoting: the matrix is diagonally dominant.
    for i in range(1, n - 2):
        factor = low[i] / middle[i - 1]
        middle[i] -= factor * high[i - 1]
        right[i] -= factor * right[i - 1]
    result[n - 2] = right[-1] / middle[-1]
    for i in range(n - 3, 0, -1):
        result[i] = (right[i - 1] - high[i - 1] * result[i + 1]) / middle[i - 1]
    return result


def minimum_jerk(
    times: Array, positions: Array, velocity: Array, acceleration: Array
) -> tuple[Array, Array]:
    """Return velocities and accelerations (n, d) that minimise the integral of x'''^2.

    This is the quintic spline, which is continuous up to the fourth derivative at inner points.
    The last point is at rest.
    """
    n, d = positions.shape
    v, a = np.zeros((n, d)), np.zeros((n, d))
    v[0], a[0] = velocity, acceleration
    if n == 2:
        return v, a
    low, middle, high, right = _equations(times, positions)
    right[0] -= low[0] @ np.stack([v[0], a[0]])
    for i in range(1, n - 2):
        factor = np.linalg.solve(middle[i - 1].T, low[i].T).T
        middle[i] -= factor @ high[i - 1]
        right[i] -= factor @ right[i - 1]
    known = np.zeros((2, d))
    for i in range(n - 3, -1, -1):
        known = np.linalg.solve(middle[i], right[i] - high[i] @ known)
        v[i + 1], a[i + 1] = known
    return v, a


def _equations(times: Array, positions: Array) -> tuple[Array, Array, Array, Array]:
    """Return the block-tridiagonal system for (v, a) of the inner points.

    The first row of each block makes x''' continuous, the second row x''''.

    Returns:
        Blocks (n - 2, 2, 2) for the previous point, the point itself and the next point, and the
        right-hand sides (n - 2, 2, d).
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
