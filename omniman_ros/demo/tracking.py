"""Errors with which the platform followed the reference of its path, measured by odometry."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.arrays import Array
from omniman_ros.demo.interval import Interval
from omniman_ros.demo.recorder import Row

TRACKING_FIGURES = (
    "rms_mm",
    "max_mm",
    "heading_rms_deg",
    "heading_max_deg",
    "final_mm",
    "final_heading_deg",
)
"""Keys of the tracking errors."""
SETTLING_AT_END = 0.5
"""Time after a movement at which the platform is at rest at its end [s]."""
SAME_TIME = 1e-3
"""Time difference below which two points of the reference count as the same point [s]."""


def rms(values: Array) -> float:
    """Return the root mean square of an array."""
    return float(np.sqrt(np.mean(np.square(values))))


def wrap_angle(angle: Array) -> Array:
    """Return angles wrapped to [-pi, pi] [rad]."""
    result: Array = np.remainder(angle + math.pi, math.tau) - math.pi
    return result


class Reference:
    """The reference that `path/reference` published, as a function of ROS time.

    Args:
        rows: Rows of `Recording.reference`: time, x, y, theta, in any order; times may repeat.

    Attributes:
        times: Times (k,) of the reference in increasing order [s].
    """

    def __init__(self, rows: Sequence[Row]) -> None:
        table = np.array(rows).reshape(-1, 4)
        table = table[np.argsort(table[:, 0], kind="stable")]
        is_new = np.concatenate([[True], np.diff(table[:, 0]) > SAME_TIME])[: len(table)]
        self.times = table[is_new, 0]
        self._poses = np.column_stack([table[is_new, 1:3], np.unwrap(table[is_new, 3])])

    def during(self, times: Array, intervals: Sequence[Interval]) -> NDArray[np.bool_]:
        """Return which of the times (k,) lie in any interval and within the reference."""
        is_during = np.zeros(len(times), dtype=bool)
        if len(self.times):
            for interval in intervals:
                is_during |= interval.contains(times)
            is_during &= (times >= self.times[0]) & (times <= self.times[-1])
        return is_during

    def at(self, times: Array) -> Array:
        """Return the poses (k, 3) at times (k,) [m, m, rad].

        The first and the last pose hold before and after the reference.
        """
        return np.column_stack([np.interp(times, self.times, pose) for pose in self._poses.T])


def pose_errors(odom: Array, reference: Reference) -> tuple[Array, Array]:
    """Return distance [m] and angle [rad], (k,) each, of the platform from the reference.

    Args:
        odom: Rows (k, 7) of `Recording.odom`.
        reference: Reference at the rows' stamps.
    """
    error = odom[:, 1:4] - reference.at(odom[:, 0])
    return np.hypot(error[:, 0], error[:, 1]), wrap_angle(error[:, 2])


def tracking_figures(
    odom: Array, reference: Reference, intervals: Sequence[Interval]
) -> dict[str, Any]:
    """Return the tracking errors in odom, each at the stamp of its odometry message.

    Args:
        odom: Rows (k, 7) of `Recording.odom`.
        reference: Reference of the path.
        intervals: Intervals in which the path was driven.

    Returns:
        Errors of position and heading, on the way and at the end; infinite if there is no
        reference at those times.
    """
    during = reference.during(odom[:, 0], intervals)
    if not during.any():
        return dict.fromkeys(TRACKING_FIGURES, math.inf)
    distance, angle = pose_errors(odom[during], reference)
    ended = odom[:, 0] <= max(interval.end for interval in intervals) + SETTLING_AT_END
    final_distance, final_angle = pose_errors(odom[ended][-1:], reference)
    return {
        "rms_mm": 1e3 * rms(distance),
        "max_mm": 1e3 * float(distance.max()),
        "heading_rms_deg": math.degrees(rms(angle)),
        "heading_max_deg": math.degrees(float(np.abs(angle).max())),
        "final_mm": 1e3 * float(final_distance[0]),
        "final_heading_deg": math.degrees(abs(float(final_angle[0]))),
        "samples": int(during.sum()),
    }


def coupling_figures(rows: Sequence[Row], movements: Sequence[Interval]) -> dict[str, Any]:
    """Return the coupling error on a path, over all movements and for each of them [rad].

    It is counted from the start of the path, CCTA 2017 (24).

    Args:
        rows: Rows of `Recording.coupling`; a robot without constraints has only the stamps.
        movements: Movements of the path.
    """
    table = np.array(rows)
    epsilon = table[:, 1:]
    result: dict[str, Any] = {"rms_rad": 0.0, "max_rad": 0.0, "movements": {}}
    if not epsilon.size:
        return result
    start = min((movement.start for movement in movements), default=math.inf)
    before = np.flatnonzero(table[:, 0] <= start)
    epsilon = epsilon - epsilon[before[-1] if before.size else 0]
    on_path = np.zeros(len(table), dtype=bool)
    for movement in movements:
        during = movement.contains(table[:, 0])
        on_path |= during
        if during.any():
            result["movements"][movement.name] = float(np.abs(epsilon[during]).max())
    if on_path.any():
        result["rms_rad"] = rms(epsilon[on_path])
        result["max_rad"] = float(np.abs(epsilon[on_path]).max())
    return result
