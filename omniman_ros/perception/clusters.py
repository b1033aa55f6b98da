"""Points of a scan, grouped into things, and the discs that fit them."""

import math
from dataclasses import dataclass

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.perception.scan import Indices, Mask, View

NONE = -1  #: Label of a point that belongs to no track
LEAST_RADIUS = 0.03  #: Smallest radius of a disc [m]
STEPS = 3  #: Number of steps of the fit of a disc
#: Weight of the expected centre, in points: where an arc is short, its centre is uncertain across
PRIOR = 0.01
#: Distance by which a neighbouring beam must end earlier to hide a part of a thing [m]
HIDING = 0.1


@dataclass(frozen=True)
class Clusters:
    """Groups of points that follow one another in a scan."""

    begins: Indices  #: (C,) index of the first point of each
    counts: Indices  #: (C,) number of points of each
    number: Indices  #: (N,) number of the cluster of each point

    @staticmethod
    def of(points: Array, gaps: Array, labels: Indices | None = None) -> "Clusters":
        """Group points (N, 2) in the order of their beams.

        From its gap (N,) on, a point does not belong to the one before [m]. Points of two tracks,
        labelled (N,) by those that they are near or NONE, do not belong together, however near
        they are.
        """
        if not len(points):
            nothing = np.zeros(0, dtype=np.intp)
            return Clusters(nothing, nothing, nothing)
        steps = points[1:] - points[:-1]
        is_new = np.hypot(steps[:, 0], steps[:, 1]) > gaps[1:]
        if labels is not None:
            before, after = labels[:-1], labels[1:]
            is_new |= (before != after) & (before != NONE) & (after != NONE)
        begins = np.concatenate(([0], np.flatnonzero(is_new) + 1))
        counts = np.diff(np.append(begins, len(points)))
        return Clusters(begins, counts, np.repeat(np.arange(len(begins)), counts))

    def __len__(self) -> int:
        return len(self.begins)

    def means(self, values: Array) -> Array:
        """Return the means (..., C) of values (..., N) of the points."""
        means: Array = np.add.reduceat(values, self.begins, axis=-1) / self.counts
        return means

    def widths(self, points: Array) -> Array:
        """Return the diagonals (C,) of the boxes around the points (N, 2) [m]."""
        high = np.maximum.reduceat(points, self.begins)
        sides = high - np.minimum.reduceat(points, self.begins)
        widths: Array = np.hypot(sides[:, 0], sides[:, 1])
        return widths


@dataclass(frozen=True)
class Outlines:
    """What the points of clusters tell of the discs behind them."""

    radii: Array  #: (C,) radii of the discs that fill the angles of the clusters [m]
    is_whole: Mask  #: (C,) whether nothing hides a side of the cluster
    centers: Array  #: (C, 2) centres by these radii [m]

    @staticmethod
    def of(clusters: Clusters, points: Array, view: View, partial_radius: float) -> "Outlines":
        """Judge clusters of points (N, 2) in odom [m].

        A disc at the distance d of its centre fills the angle 2 asin(r / d), and its nearest point
        is at d - r. What is hidden in part has the radius `partial_radius` [m].
        """
        away = points - view.origin
        distances = np.hypot(away[:, 0], away[:, 1])
        sectors = view.sectors(np.arctan2(away[:, 1], away[:, 0]))
        low = np.minimum.reduceat(sectors, clusters.begins)
        high = np.maximum.reduceat(sectors, clusters.begins)
        nearest = np.minimum.reduceat(distances, clusters.begins)
        half = 0.5 * (high - low + 1) * view.sector
        sines = np.sin(np.minimum(half, 0.45 * math.pi))
        radii = np.maximum(nearest * sines / (1.0 - sines), LEAST_RADIUS)
        is_whole = np.ones(len(clusters), dtype=bool)
        last = len(view.ranges) - 1
        for side, step in ((low, -1), (high, 1)):
            beside = side + step
            inside = (beside >= 0) & (beside <= last)
            ranges = view.ranges[np.clip(beside, 0, last)]
            with np.errstate(invalid="ignore"):
                is_whole &= inside & (ranges > view.ranges[side] - HIDING)
        radii = np.where(is_whole, radii, np.maximum(radii, partial_radius))
        middle = np.column_stack([clusters.means(axis) for axis in away.T])
        span = np.hypot(middle[:, 0], middle[:, 1])
        # The mean of an arc that is seen from afar lies at pi / 4 of the radius.
        centers = view.origin + middle * (1.0 + 0.25 * math.pi * radii / span)[:, None]
        return Outlines(radii, is_whole, centers)


def fitted_centers(points: Array, number: Indices, expected: Array, radii: Array) -> Array:
    """Return the centres (K, 2) of discs of known radii [m], fitted by Gauss and Newton.

    The points (N, 2) are on the outlines of the discs with the numbers (N,), whose centres are
    expected at `expected` (K, 2).
    """
    count = len(expected)
    centers = expected.copy()
    wanted = radii[number]
    sums = np.maximum(np.bincount(number, minlength=count), 1)
    for _ in range(STEPS):
        away = points - centers[number]
        distances = np.maximum(np.hypot(away[:, 0], away[:, 1]), 1e-6)
        nx, ny = away.T / distances
        error = distances - wanted
        rows = (nx * nx, nx * ny, ny * ny, nx * error, ny * error)
        xx, xy, yy, bx, by = (
            np.bincount(number, weights=row, minlength=count).astype(np.float64) for row in rows
        )
        prior = PRIOR * sums
        xx, yy = xx + prior, yy + prior
        bx += prior * (expected[:, 0] - centers[:, 0])
        by += prior * (expected[:, 1] - centers[:, 1])
        determinant = xx * yy - xy * xy
        centers = centers + np.column_stack(
            ((yy * bx - xy * by) / determinant, (xx * by - xy * bx) / determinant)
        )
    return centers
