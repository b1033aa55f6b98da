"""Convex outline of points."""

import numpy as np

from omniman_ros.core.arrays import Array

TOLERANCE = 1e-9  #: Twice the area of a triangle that counts as a line [m^2]


def convex_outline(points: Array) -> Array:
    """Return the corners of the smallest convex polygon around points (monotone chain).

    Args:
        points: (n, 2) points, three or more that are not on a line [m].

    Returns:
        (k, 2) of the points, counter-clockwise [m].
    """
    ordered = sorted(map(tuple, points.tolist()))
    lower, upper = _chain(ordered), _chain(ordered[::-1])
    return np.array(lower[:-1] + upper[:-1])


def _chain(points: list[tuple[float, ...]]) -> list[tuple[float, ...]]:
    """Return the points at which a chain from the first to the last one turns left."""
    chain: list[tuple[float, ...]] = []
    for point in points:
        while len(chain) > 1 and _turn(chain[-2], chain[-1], point) <= TOLERANCE:
            chain.pop()
        chain.append(point)
    return chain


def _turn(a: tuple[float, ...], b: tuple[float, ...], c: tuple[float, ...]) -> float:
    """Return twice the area of the triangle a, b, c, above zero if it turns left [m^2]."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
