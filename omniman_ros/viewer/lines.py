"""Polylines to draw: trails, paths and outlines, all of bounded size."""

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from omniman_ros.core.arrays import Array

TRAIL_SPACING = 0.02  #: Shortest distance between two points of a trail [m]
TRAIL_POINTS = 1500  #: Largest number of points of a trail: 30 m at the shortest spacing
JUMP = 0.5  #: Distance between points from which a trail is broken, as when odometry is set [m]
LINE_POINTS = 1000  #: Largest number of points drawn of a path; a longer one is thinned evenly
OUTLINE_POINTS = 24  #: Number of corners of the outline of an obstacle


class Trail:
    """Past positions of a moving object."""

    def __init__(self, spacing: float = TRAIL_SPACING, limit: int = TRAIL_POINTS) -> None:
        self._spacing = spacing
        self._limit = limit
        self._points = np.empty((2 * limit, 2))
        self._end = 0
        self.version = 0  #: Changes whenever the points change

    def add(self, x: float, y: float) -> None:
        """Add a position [m] unless it is too close to the previous one."""
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
        """Discard all positions."""
        self._end = 0
        self.version += 1

    @property
    def points(self) -> Array:
        """Positions (k, 2) [m], the oldest first."""
        return self._points[max(self._end - self._limit, 0) : self._end]


@dataclass
class Line:
    """A polyline."""

    #: (k, 2) on the floor or (k, 3) in space [m]
    points: Array = field(default_factory=lambda: np.empty((0, 2)))
    version: int = 0  #: Changes whenever the points change

    def set(self, points: Array) -> None:
        """Replace the points."""
        self.points = points
        self.version += 1


def segments(points: Array, jump: float = np.inf) -> Array:
    """Return the segments (s, 2, 2) of a polyline (k, 2), without those longer than `jump` [m]."""
    pieces = np.stack([points[:-1], points[1:]], axis=1)
    short: Array = pieces[np.hypot(*(pieces[:, 1] - pieces[:, 0]).T) <= jump]
    return short


def outlines(centers: Array, semi_axes: Array, angles: Array) -> Array:
    """Return the outlines (k, 2) of M ellipses [m], separated by rows of NaN.

    Centers and semi-axes are (M, 2) [m], the directions of the first semi-axes (M,) [rad].
    """
    parameter = np.append(np.linspace(0.0, 2.0 * np.pi, OUTLINE_POINTS + 1), np.nan)
    x = semi_axes[:, :1] * np.cos(parameter)
    y = semi_axes[:, 1:] * np.sin(parameter)
    c, s = np.cos(angles)[:, None], np.sin(angles)[:, None]
    around = np.stack([c * x - s * y, s * x + c * y], axis=2) + centers[:, None, :]
    flat: Array = around.reshape(-1, 2)
    return flat


def thinned(count: int, limit: int = LINE_POINTS) -> Iterable[int]:
    """Return at most `limit` evenly spaced indices of `count` points, including first and last."""
    if count <= limit:
        return range(count)
    return map(int, np.linspace(0, count - 1, limit).round())
