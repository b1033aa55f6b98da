"""Lines that are drawn: trails, paths, outlines; of bounded size."""

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SPACING = 0.02
"""Shortest distance between two points of a trail [m]."""
TRAIL_POINTS = 1500
"""Longest trail: 30 m at the shortest distance."""
JUMP = 0.5
"""A trail is broken where it jumps further than this, as when odometry is set [m]."""
LINE_POINTS = 1000
"""Points of a path that are drawn; of a longer one, every second, third, ..."""
CORNERS = 24
"""Of an obstacle's outline."""


class Trail:
    """Where something has been.

    Attributes:
        version: Changes with the points.
    """

    def __init__(self, spacing: float = SPACING, limit: int = TRAIL_POINTS) -> None:
        self._spacing = spacing
        self._limit = limit
        self._points = np.empty((2 * limit, 2))
        self._end = 0
        self.version = 0

    def add(self, x: float, y: float) -> None:
        """Add a position [m], if it is far enough from the last."""
        if self._end:
            last = self._points[self._end - 1]
            if np.hypot(x - last[0], y - last[1]) < self._spacing:
                return
        if self._end == len(self._points):
            self._points[: self._limit] = self._points[self._limit :]
            self._end = self._limit
        self._points[self._end] = x, y
        self._end += 1
        self.version += 1

    def clear(self) -> None:
        """Forget it."""
        self._end = 0
        self.version += 1

    @property
    def points(self) -> Array:
        """Positions (k, 2) [m], the oldest first."""
        return self._points[max(self._end - self._limit, 0) : self._end]


@dataclass
class Line:
    """A line: points (k, 2) on the floor or (k, 3) in space [m]; `version` changes with them."""

    points: Array = field(default_factory=lambda: np.empty((0, 2)))
    version: int = 0

    def set(self, points: Array) -> None:
        """Replace the points."""
        self.points = points
        self.version += 1


def segments(points: Array, jump: float = np.inf) -> Array:
    """Pieces (k - 1, 2, 2) between neighbours of a line (k, 2), without those that are longer."""
    pieces = np.stack([points[:-1], points[1:]], axis=1)
    near: Array = pieces[np.hypot(*(pieces[:, 1] - pieces[:, 0]).T) <= jump]
    return near


def outlines(centers: Array, semi_axes: Array, angles: Array) -> Array:
    """Points (k, 2) around M ellipses: (M, 2) [m], (M, 2) [m], (M,) [rad]; NaN between two."""
    turn = np.append(np.linspace(0.0, 2.0 * np.pi, CORNERS + 1), np.nan)
    x = semi_axes[:, :1] * np.cos(turn)
    y = semi_axes[:, 1:] * np.sin(turn)
    c, s = np.cos(angles)[:, None], np.sin(angles)[:, None]
    around = np.stack([c * x - s * y, s * x + c * y], axis=2) + centers[:, None, :]
    flat: Array = around.reshape(-1, 2)
    return flat


def thinned(count: int, limit: int = LINE_POINTS) -> Iterable[int]:
    """Indices of at most `limit` of `count` points, evenly, the first and the last among them."""
    if count <= limit:
        return range(count)
    return map(int, np.linspace(0, count - 1, limit).round())
