"""Rasterisation of triangles with a depth buffer, in numpy.

All triangles of a call are drawn together: each row of pixels of each triangle is a span, whose
ends follow from its edges, and the pixels of all spans are compared in arrays.
"""

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.arrays import Array

#: Largest number of pixels of spans that are compared at once; it bounds the memory
PIXELS = 4_000_000
_MIN_AREA = 1e-9  #: Smallest doubled area of a triangle that is drawn [px^2]

Image = NDArray[np.uint8]  #: Image (rows, columns, 3): red, green and blue, 0 to 255


class Rasterizer:
    """A copy of a background with a depth buffer, into which triangles are drawn."""

    def __init__(self, image: Image) -> None:
        self.image = image.copy()
        self._height, self._width = image.shape[:2]
        self._colours = self.image.reshape(-1, 3)
        self._nearness = np.zeros(self._height * self._width)

    def draw(self, corners: Array, nearness: Array, colours: Image) -> None:
        """Draw triangles, of which the nearest is seen.

        Pixel (column, row) has its centre at (column + 0.5, row + 0.5).

        Args:
            corners: (t, 3, 2) corners of the triangles in the image, x to the right, y down [px].
            nearness: (t, 3) reciprocals of the corners' distances along the view, above 0 [1/m].
            colours: (t, 3) red, green and blue, 0 to 255.
        """
        kept = np.abs(_doubled_area(corners)) > _MIN_AREA
        corners, nearness, colours = corners[kept], nearness[kept], colours[kept]
        triangle, row, first, count = self._spans(corners)
        # A span that has more pixels than are compared at once is compared alone.
        group = np.cumsum(count) // PIXELS
        plane = _nearness_planes(corners, nearness)
        for k in np.unique(group):
            part = group == k
            self._draw_spans(triangle[part], row[part], first[part], count[part], plane, colours)

    def _spans(self, corners: Array) -> tuple[NDArray[np.int64], ...]:
        """Return triangle, row, first column and number of pixels (s,) of each span."""
        y = corners[..., 1]
        top = np.maximum(np.ceil(y.min(axis=1) - 0.5), 0).astype(np.int64)
        low = np.minimum(np.floor(y.max(axis=1) - 0.5), self._height - 1).astype(np.int64)
        rows = np.maximum(low - top + 1, 0)
        triangle = np.repeat(np.arange(len(rows)), rows)
        row = _counted(top, rows)
        left, right = np.zeros(len(row)), np.full(len(row), float(self._width))
        slopes, offsets = _edges(corners)
        for edge in range(3):
            slope = slopes[triangle, edge, 0]
            rest = slopes[triangle, edge, 1] * (row + 0.5) + offsets[triangle, edge]
            with np.errstate(divide="ignore", invalid="ignore"):
                zero = -rest / slope
            left = np.where(slope > 0.0, np.maximum(left, zero), left)
            right = np.where(slope < 0.0, np.minimum(right, zero), right)
            right = np.where((slope == 0.0) & (rest < 0.0), -1.0, right)
        first = np.ceil(left - 0.5).astype(np.int64)
        last = np.minimum(np.floor(right - 0.5).astype(np.int64), self._width - 1)
        count = last - first + 1
        seen = count > 0
        return triangle[seen], row[seen], first[seen], count[seen]

    def _draw_spans(
        self,
        triangle: NDArray[np.int64],
        row: NDArray[np.int64],
        first: NDArray[np.int64],
        count: NDArray[np.int64],
        plane: Array,
        colours: Image,
    ) -> None:
        """Draw spans (s,) of triangles whose nearness is a linear function `plane` (t, 3)."""
        pixel = _counted(row * self._width + first, count)
        a, b, c = plane[triangle].T
        start = a * (first + 0.5) + b * (row + 0.5) + c
        steps = _counted(np.zeros_like(first), count)
        near = np.repeat(start, count) + np.repeat(a, count) * steps
        visible = np.flatnonzero(near > self._nearness[pixel])
        # Of several triangles at a pixel, the last assignment counts: the nearest one.
        order = visible[np.argsort(near[visible], kind="stable")]
        pixel = pixel[order]
        self._nearness[pixel] = near[order]
        self._colours[pixel] = colours[np.repeat(triangle, count)[order]]


def _counted(start: NDArray[np.int64], count: NDArray[np.int64]) -> NDArray[np.int64]:
    ends = np.cumsum(count)
    total = int(ends[-1]) if len(ends) else 0
    return np.asarray(np.arange(total) + np.repeat(start - (ends - count), count))


def _doubled_area(corners: Array) -> Array:
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


def _edges(corners: Array) -> tuple[Array, Array]:
    """Return linear functions that are at least 0 on the inner side of each edge.

    Args:
        corners: (t, 3, 2) corners of triangles that have an area [px].

    Returns:
        Slopes (t, 3, 2) along x and y, and values (t, 3) at the origin.
    """
    way = np.roll(corners, -1, axis=1) - corners
    sign = np.sign(_doubled_area(corners))[:, None, None]
    slopes = sign * np.stack((-way[..., 1], way[..., 0]), axis=-1)
    return slopes, -(slopes * corners).sum(axis=-1)


def _nearness_planes(corners: Array, nearness: Array) -> Array:
    """Return the coefficients (t, 3) of x, y and 1 by which the nearness is linear [1/m]."""
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    first, second = nearness[:, 1] - nearness[:, 0], nearness[:, 2] - nearness[:, 0]
    area = _doubled_area(corners)
    x = (first * b[:, 1] - second * a[:, 1]) / area
    y = (second * a[:, 0] - first * b[:, 0]) / area
    return np.column_stack((x, y, nearness[:, 0] - x * corners[:, 0, 0] - y * corners[:, 0, 1]))
