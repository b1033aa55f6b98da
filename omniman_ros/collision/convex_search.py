"""Distances of line segments from convex solids, by a search along the segments.

The first axis of an array of points holds their three coordinates.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from omniman_ros.collision.segments import dot
from omniman_ros.core.arrays import Array

Indices = NDArray[np.intp]
"""Array of indices."""
Outward = Callable[[Array], Array]
"""Returns the vectors (3, ...) to points (3, ...) from the nearest points of convex solids [m]."""
ACCURACY = 1e-8
"""Accuracy of distances [m]."""
MOST_STEPS = 100
"""Largest number of steps of the search along a segment; about 10 are usual."""


def distances_along(
    outward: Outward,
    some_outward: Callable[[tuple[Indices, ...]], Outward],
    start: Array,
    along: Array,
    reach: Array | float,
) -> Array:
    """Return the distances between segments and convex solids; zero where they meet.

    The distance from a convex solid is a convex function of the place on the segment. Where its
    slope changes sign between the ends, the false position method (Illinois) finds the minimum; as
    the function is convex, the slope there bounds the error.

    Args:
        outward: Vectors to points (3, ...) from the solids, one for each segment.
        some_outward: Returns the same function for the n segments with indices, each (n,).
        start: Starts (3, ...) of the segments [m].
        along: Vectors (3, ...) to their ends [m].
        reach: Distance above which a lower bound is enough, one or (...) [m].

    Returns:
        Distances (...) [m]. Those above `reach` may be too small, but are not below it.
    """
    low, high = outward(start), outward(start + along)
    slope_low, slope_high = dot(low, along), dot(high, along)
    squared = np.where(slope_low >= 0.0, dot(low, low), dot(high, high))
    is_between = (slope_low < 0.0) & (slope_high > 0.0)
    # Nothing changes by more than a segment's half length around its middle.
    middle = outward(start + 0.5 * along)
    bound = np.sqrt(dot(middle, middle)) - 0.5 * np.sqrt(dot(along, along))
    is_far = is_between & (bound > reach)
    squared[is_far] = bound[is_far] ** 2
    where = np.nonzero(is_between & ~is_far)
    chosen: tuple[slice | Indices, ...] = (slice(None), *where)
    squared[where] = _least(
        some_outward(where), start[chosen], along[chosen], slope_low[where], slope_high[where]
    )
    result: Array = np.sqrt(squared)
    return result


def _least(
    outward: Outward, start: Array, along: Array, slope_low: Array, slope_high: Array
) -> Array:
    """Return the least squared distances (n,) of segments from their solids [m^2].

    Args:
        outward: Vectors to points (3, n) from the solids.
        start: Starts (3, n) [m].
        along: Vectors (3, n) to the ends [m].
        slope_low: Slopes (n,) of half the squared distance at the starts, below zero.
        slope_high: Those at the ends, above zero.
    """
    count = len(slope_low)
    low, high = np.zeros(count), np.ones(count)
    was_low = was_high = np.zeros(count, dtype=bool)
    squared = np.empty(count)
    for _ in range(MOST_STEPS):
        middle = low + (high - low) * slope_low / (slope_low - slope_high)
        vector = outward(start + middle * along)
        squared, slope = dot(vector, vector), dot(vector, along)
        if (np.abs(slope) <= ACCURACY * np.maximum(np.sqrt(squared), ACCURACY)).all():
            break
        is_low = slope < 0.0
        low, high = np.where(is_low, middle, low), np.where(is_low, high, middle)
        # An end that stays twice counts with half its slope, so that both ends move.
        slope_low = np.where(is_low, slope, np.where(was_high, 0.5, 1.0) * slope_low)
        slope_high = np.where(is_low, np.where(was_low, 0.5, 1.0) * slope_high, slope)
        was_low, was_high = is_low, ~is_low
    return squared
