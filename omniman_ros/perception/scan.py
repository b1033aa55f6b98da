"""Scans in one plane, and what was seen from one place."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.core.rigid import PlanarPose

Mask = NDArray[np.bool_]  #: Flags of beams, points or tracks
Indices = NDArray[np.intp]  #: Numbers of beams, points or tracks

MOST_BEAMS = 100_000  #: Largest number of beams of a scan


@dataclass(frozen=True)
class Scan:
    """Ranges of one revolution of a scanner, or of a cloud that was cut at a height.

    Raises:
        InputError: There are no beams or too many, or a number is not finite or out of range.
    """

    time: float  #: Time of the first beam on the caller's clock [s]
    #: (N,) distances [m]; as in REP 117, inf where a beam meets nothing up to `range_max` and -inf
    #: where it meets something nearer than the scanner can measure; NaN or 0 where nothing is
    #: known.
    ranges: Array
    angle_min: float  #: Direction of the first beam in the scanner's frame [rad]
    increment: float  #: Angle between two beams, negative if they turn to the right [rad]
    range_max: float  #: Longest range [m]
    mount: PlanarPose  #: Pose of the scanner in base_link [m, m, rad]
    beam_time: float = 0.0  #: Time between two beams [s]
    heights: tuple[float, float] = (0.0, 0.0)  #: Heights above the floor between which it sees [m]

    def __post_init__(self) -> None:
        ranges = self.ranges
        if ranges.ndim != 1 or not 1 < len(ranges) <= MOST_BEAMS:
            raise InputError(f"ranges have shape {ranges.shape}, expected 2 to {MOST_BEAMS}")
        numbers = (self.time, self.angle_min, self.increment, self.range_max, self.beam_time)
        if not all(map(math.isfinite, (*numbers, *self.mount, *self.heights))):
            raise InputError("its time, angles, longest range, mount or height are not finite")
        angle = abs(self.increment) * (len(ranges) - 1)
        if not 0.0 < angle <= math.tau * (1.0 + 1e-3):
            raise InputError(f"its beams span {angle:.3f} rad, expected more than 0, at most 2 pi")
        if not self.range_max > 0.0:
            raise InputError(f"range_max is {self.range_max} m, expected more than 0")
        if not 0.0 <= self.beam_time * len(ranges) <= 1.0:
            raise InputError(f"time_increment is {self.beam_time} s, expected 0 to 1 s in all")

    @property
    def times(self) -> Array:
        """Times (N,) of the beams [s]."""
        times: Array = self.time + self.beam_time * np.arange(float(len(self.ranges)))
        return times

    @property
    def end(self) -> float:
        """Time of the last beam [s]."""
        return self.time + self.beam_time * (len(self.ranges) - 1)

    @cached_property
    def hits(self) -> Indices:
        """Numbers (M,) of the beams that met something."""
        with np.errstate(invalid="ignore"):
            met = (self.ranges > 0.0) & (self.ranges <= self.range_max)
        return np.flatnonzero(met)

    def local_points(self, beams: Indices) -> Array:
        """Return what beams (M,) met, in base_link at the time of each [m], (M, 2)."""
        x, y, yaw = self.mount
        directions = yaw + self.angle_min + self.increment * beams
        ranges = self.ranges[beams]
        return np.column_stack((x + ranges * np.cos(directions), y + ranges * np.sin(directions)))


def placed(points: Array, poses: Array) -> Array:
    """Return points (M, 2) that are given in frames, by the poses (M, 3) of these [m, m, rad]."""
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    x, y = points.T
    return np.column_stack((poses[:, 0] + c * x - s * y, poses[:, 1] + s * x + c * y))


@dataclass(frozen=True)
class View:
    """How far one can see from a place: a scan as if all its beams had been measured at once."""

    origin: Array  #: (2,) the place in odom [m]
    first: float  #: Direction of the middle of the first sector in odom [rad]
    sector: float  #: Angle of a sector [rad]
    #: (N,) distance of the nearest thing in each sector [m]; inf where there is none up to the
    #: longest range, NaN where nothing is known.
    ranges: Array

    @staticmethod
    def of(scan: Scan, pose: PlanarPose, beams: Indices, points: Array, known: Mask) -> "View":
        """Return the view from where the scanner was at the end of a scan, base_link at `pose`.

        The M beams met points (M, 2) in odom [m]; those `known` are not the robot itself.

        Args:
            pose: Pose of base_link at its end in odom [m, m, rad].
        """
        mount = np.array([scan.mount[:2]])
        origin = placed(mount, np.array([pose]))[0]
        count, sector = len(scan.ranges), abs(scan.increment)
        start = scan.angle_min if scan.increment > 0.0 else scan.angle_min - (count - 1) * sector
        first = pose[2] + scan.mount[2] + start
        ranges = np.where(np.isposinf(scan.ranges), math.inf, math.nan)
        ranges = ranges if scan.increment > 0.0 else ranges[::-1].copy()
        away = points[known] - origin
        view = View(origin, first, sector, ranges)
        index = view.sectors(np.arctan2(away[:, 1], away[:, 0]))
        inside = index >= 0
        index, distances = index[inside], np.hypot(*away[inside].T)
        ranges[index] = math.inf
        np.minimum.at(ranges, index, distances)
        if not known.all():
            blind = beams[~known] if scan.increment > 0.0 else count - 1 - beams[~known]
            ranges[blind] = math.nan
        return view

    def sectors(self, bearings: Array) -> Indices:
        """Return the numbers of the sectors in directions in odom [rad]; -1 outside."""
        turned = (bearings - self.first + 0.5 * self.sector) % math.tau
        index = (turned / self.sector).astype(np.intp)
        index[index >= len(self.ranges)] = -1
        return index

    @cached_property
    def clear(self) -> Array:
        """(N + 1,) distances up to which sectors are free, for sure [m]; the last one is 0.

        A beam that is lost looks like one that meets nothing: the neighbours must agree.
        """
        ranges = np.where(np.isnan(self.ranges), 0.0, self.ranges)
        padded = np.concatenate((ranges[:1], ranges, ranges[-1:]))
        least = np.minimum(np.minimum(padded[:-2], padded[1:-1]), padded[2:])
        return np.append(least, 0.0)

    def passed(
        self, origin: Array, resolution: float, count: int, reach: float
    ) -> tuple[slice, slice, Mask]:
        """Return which cells of a square grid are free, for sure: rows, columns, and which.

        A cell is looked up in the view, in place of a ray drawn through the cells: no cell is
        missed where rays are farther apart than cells. The first cell has its corner at `origin`
        in odom; cells count up to a reach [m].
        """
        middles = resolution * (np.arange(count, dtype=np.float32) + 0.5)
        x = middles + np.float32(origin[0] - self.origin[0])
        y = middles + np.float32(origin[1] - self.origin[1])
        columns, rows = (_within(axis, reach) for axis in (x, y))
        x, y = x[None, columns], y[rows, None]
        distances = np.sqrt(x * x + y * y)
        limits = self.clear - 0.75 * resolution
        clear = limits[self.sectors(np.arctan2(y, x))]
        return rows, columns, distances < np.minimum(clear, reach)

    def sees_through(self, center: Array, radius: float) -> bool | None:
        """Return whether one looks through a disc in odom; None if it is outside of the view.

        Args:
            center: (2,) its centre in odom [m].
            radius: Its radius [m].
        """
        away = center - self.origin
        distance = float(np.hypot(*away))
        if distance <= radius:
            return None
        half = math.asin(0.7 * radius / distance)
        steps = np.linspace(-half, half, 9)
        index = self.sectors(math.atan2(away[1], away[0]) + steps)
        index = index[index >= 0]
        if len(index) < 5:
            return None
        with np.errstate(invalid="ignore"):
            return bool((self.ranges[index] > distance + radius).mean() >= 0.5)


def _within(axis: NDArray[np.float32], reach: float) -> slice:
    """Return the part of an ascending axis that is nearer than a distance."""
    first, last = np.searchsorted(axis, (-reach, reach)).tolist()
    return slice(first, last)
