"""Distances of line segments from convex obstacles, by a search along the segments.

The first axis of an array of points holds their three coordinates.
"""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from omniman_ros.collision.segments import dot
from omniman_ros.core.arrays import Array

Indices = NDArray[np.intp]  #: Array of indices
#: Returns the vectors (3, n) to n points (3, n) from the nearest points of n convex obstacles [m]
Outward = Callable[[Array], Array]
ACCURACY = 1e-8  #: Accuracy of distances [m]
MOST_STEPS = 100  #: Largest number of steps of the search along a segment; about 10 are usual
#: Fraction of segments that are not yet done at which the others are left out of further steps
UNFINISHED_FRACTION = 0.75


def distances_along(
    outward: Callable[[tuple[Indices, ...]], Outward],
    bound: Array,
    start: Array,
    along: Array,
    cutoff: Array | float,
) -> Array:
    """Return the distances (...) between segments and convex obstacles; zero where they meet [m].

    The distance from a convex solid is a convex function of the place on the segment. Where its
    slope changes sign between the ends, the false position method (Illinois) finds the minimum; as
    the function is convex, the slope there bounds the error. Segments go from starts (3, ...)
    along vectors (3, ...) to their ends [m]. Distances above `cutoff`, one or (...) [m], may be
    too small, but are not below it.

    Args:
        outward: Returns a function for the n segments with indices, each (n,): the vectors to
            points (3, n) from the obstacles, one for each of these segments.
        bound: Lower bounds (...) of the distances, not negative [m].
    """
    result = bound.copy()
    near = np.nonzero(bound <= cutoff)
    chosen: tuple[slice | Indices, ...] = (slice(None), *near)
    farthest = np.broadcast_to(cutoff, bound.shape)[near]

    def some(where: Indices) -> Outward:
        return outward(tuple(index[where] for index in near))

    result[near] = _distances(outward(near), some, start[chosen], along[chosen], farthest)
    return result


def _distances(
    outward: Outward,
    some_outward: Callable[[Indices], Outward],
    start: Array,
    along: Array,
    cutoff: Array,
) -> Array:
    low, high = outward(start), outward(start + along)
    slope_low, slope_high = dot(low, along), dot(high, along)
    squared = np.where(slope_low >= 0.0, dot(low, low), dot(high, high))
    where = np.flatnonzero((slope_low < 0.0) & (slope_high > 0.0))
    first, way = start[:, where], along[:, where]
    # Nothing changes by more than a segment's half length around its middle.
    middle = some_outward(where)(first + 0.5 * way)
    bound = np.sqrt(dot(middle, middle)) - 0.5 * np.sqrt(dot(way, way))
    is_far = bound > cutoff[where]
    squared[where[is_far]] = bound[is_far] ** 2
    left, where = ~is_far, where[~is_far]
    squared[where] = _least(
        lambda some: some_outward(where[some]),
        first[:, left],
        way[:, left],
        slope_low[where],
        slope_high[where],
    )
    result: Array = np.sqrt(squared)
    return result


def box_gaps(
    start: Array, end: Array, lower: Sequence[Array | float], upper: Sequence[Array | float]
) -> tuple[Array, Array, Array]:
    """Return the gaps (...) between bounding boxes of segments and obstacles along each axis [m].

    Segments have starts and ends (3, ...). The lower and upper corners of the obstacles' boxes are
    given by coordinate, each of a shape that is broadcast to (...).
    """
    x, y, z = (
        np.maximum(np.maximum(np.minimum(a, b) - high, low - np.maximum(a, b)), 0.0)
        for a, b, low, high in zip(start, end, lower, upper, strict=True)
    )
    return x, y, z


def _least(
    outward: Callable[[Indices], Outward],
    start: Array,
    along: Array,
    slope_low: Array,
    slope_high: Array,
) -> Array:
    """Return the least squared distances (n,) of segments from their obstacles [m^2].

    Few segments need many steps: those that are done are left out of the further ones. Starts and
    vectors to the ends are (3, n) [m]. The slopes (n,) are those of half the squared distance,
    below zero at the starts and above zero at the ends.
    """
    count = len(slope_low)
    squared = np.empty(count)
    left, nearest = np.arange(count), outward(np.arange(count))
    low, high = np.zeros(count), np.ones(count)
    was_low = was_high = np.zeros(count, dtype=bool)
    for _ in range(MOST_STEPS):
        middle = low + (high - low) * slope_low / (slope_low - slope_high)
        vector = nearest(start + middle * along)
        found, slope = dot(vector, vector), dot(vector, along)
        squared[left] = found
        is_low = slope < 0.0
        low, high = np.where(is_low, middle, low), np.where(is_low, high, middle)
        accurate = ACCURACY * np.maximum(np.sqrt(found), ACCURACY)
        is_open = np.abs(slope) * (high - low) > accurate
        # An end that stays twice counts with half its slope, so that both ends move.
        slope_low = np.where(is_low, slope, np.where(was_high, 0.5, 1.0) * slope_low)
        slope_high = np.where(is_low, np.where(was_low, 0.5, 1.0) * slope_high, slope)
        was_low, was_high = is_low, ~is_low
        open_count = int(np.count_nonzero(is_open))
        if open_count == 0:
            break
        if open_count <= UNFINISHED_FRACTION * len(left):
            left, start, along = left[is_open], start[:, is_open], along[:, is_open]
            low, high = low[is_open], high[is_open]
            slope_low, slope_high = slope_low[is_open], slope_high[is_open]
            was_low, was_high = was_low[is_open], was_high[is_open]
            nearest = outward(left)
    return squared
