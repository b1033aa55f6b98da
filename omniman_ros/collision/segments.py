"""Distances between line segments in space, in batches.

The first axis of an array of points holds their three coordinates.
"""

from functools import reduce

import numpy as np

from omniman_ros.core.arrays import Array


def dot(a: Array, b: Array) -> Array:
    """Return the scalar products (...) of vectors (3, ...)."""
    result: Array = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    return result


def segment_distances(first: Array, first_end: Array, second: Array, second_end: Array) -> Array:
    """Return the distances (...) between pairs of segments, starts and ends (3, ...) each [m].

    The squared distance is a convex quadratic function of the places on the two segments. Its
    minimum over the unit square is inside, where the gradient vanishes, or on one of the four
    edges: the least of these five values is taken. Segments may be parallel, or points.
    """
    u, v, w = first_end - first, second_end - second, first - second
    uu, uv, vv = dot(u, u), dot(u, v), dot(v, v)
    uw, vw, ww = dot(u, w), dot(v, w), dot(w, w)
    tiny = np.finfo(np.float64).tiny

    def squared(s: Array | float, t: Array | float) -> Array:
        """Return the squared distance of places s and t, as fractions of the segments."""
        result: Array = ww + s * (s * uu + 2.0 * uw) + t * (t * vv - 2.0 * vw) - 2.0 * s * t * uv
        return result

    def clip(numerator: Array, denominator: Array) -> Array:
        return np.clip(numerator / np.maximum(denominator, tiny), 0.0, 1.0)

    determinant = uu * vv - uv * uv
    candidates = (
        squared(0.0, clip(vw, vv)),
        squared(1.0, clip(vw + uv, vv)),
        squared(clip(-uw, uu), 0.0),
        squared(clip(uv - uw, uu), 1.0),
        squared(
            clip(uv * vw - vv * uw, determinant),
            clip(uu * vw - uv * uw, determinant),
        ),
    )
    least = reduce(np.minimum, candidates)
    result: Array = np.sqrt(np.maximum(least, 0.0))
    return result
