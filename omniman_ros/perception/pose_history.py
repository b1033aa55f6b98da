"""Poses of the robot over the last moments, for the time of each beam."""

from collections import deque

import numpy as np

from omniman_ros.core import se2
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.core.stamps import TIME_JUMP

SPAN = 2.0  #: Time for which poses are kept [s]
LEAD = 0.1  #: Largest time by which the newest pose is extrapolated at its velocity [s]
JUMP, FASTEST = 0.2, 3.0
"""Distance by which a pose may be off what the last one predicts [m], and its growth with time
[m/s]; a larger one is a reset."""


class PoseHistory:
    """Poses of base_link in odom by their times; between two of them they are interpolated."""

    def __init__(self) -> None:
        self._rows: deque[tuple[float, float, float, float]] = deque()
        self._velocity = np.zeros(3)

    def add(self, time: float, pose: Array, velocity: Array) -> None:
        """Add a pose (3,) at a time, and its rate (3,) in odom, if it is newer.

        Args:
            pose: x, y, heading [m, m, rad].
            velocity: Its rate [m/s, m/s, rad/s].
        """
        x, y, theta = pose.tolist()
        rows = self._rows
        if rows and time <= rows[-1][0]:
            return
        if rows:
            theta = rows[-1][3] + se2.wrap(theta - rows[-1][3])
        rows.append((time, x, y, theta))
        while rows[0][0] < time - SPAN:
            rows.popleft()
        self._velocity = velocity

    def jump(self, time: float, pose: Array) -> str:
        """Return why a pose (3,) at a time [s] does not go on from the last ones, or nothing."""
        if not self._rows:
            return ""
        last = self._rows[-1]
        elapsed = time - last[0]
        if elapsed < -TIME_JUMP:
            return f"time went back by {-elapsed:.2f} s"
        moved = pose[:2] - np.array(last[1:3]) - max(elapsed, 0.0) * self._velocity[:2]
        distance = float(np.hypot(*moved))
        allowed = JUMP + max(elapsed, 0.0) * FASTEST
        return f"odometry jumped by {distance:.2f} m" if distance > allowed else ""

    def at(self, times: Array) -> Array:
        """Return the poses (N, 3) at times (N,) [s].

        Raises:
            InputError: The poses begin later, or end earlier than can be extrapolated.
        """
        if not self._rows:
            raise InputError("there is no odometry yet")
        rows = np.array(self._rows)
        first, last = float(times.min()), float(times.max())
        if first < rows[0, 0]:
            raise InputError(f"odometry begins {rows[0, 0] - first:.3f} s later")
        ahead = last - rows[-1, 0]
        if ahead > LEAD:
            raise InputError(f"odometry ends {ahead:.3f} s earlier")
        if ahead > 0.0:
            end = rows[-1] + ahead * np.append(1.0, self._velocity)
            rows = np.vstack((rows, end))
        return np.column_stack([np.interp(times, rows[:, 0], axis) for axis in rows[:, 1:].T])
