"""Smoothing of a motion within speed and acceleration limits, so that it keeps a jerk limit, too.

A moving average keeps velocity and acceleration vectors within their balls, because a ball is
convex. Its jerk is the difference of two accelerations over the window: with a window of
T = 2 A / J it is at most J. So every limit holds by construction, at every instant, for vectors
as well as for single coordinates. The price is the time T and a deviation of at most A T^2 / 24,
which is across the path only where the path bends.
"""

import math
from collections.abc import Sequence

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.motion.path.axis_group import AxisGroup


def window_ticks(groups: Sequence[AxisGroup], dt: float) -> int:
    """Return the number of ticks of the window that keeps every group's jerk limit."""
    window = max(2.0 * group.acceleration / group.jerk for group in groups)
    return max(1, math.ceil(window / dt - 1e-9))


def deviation(acceleration: float, ticks: int, dt: float) -> float:
    """Return the largest deviation of the average from the path [m or rad]."""
    # A T^2 / 24 for the window, and A dt^2 / 4 for the three samples of a tick.
    return acceleration * dt * dt * (ticks * ticks / 24.0 + 0.25)


class Smoother:
    """Filter of finite length on the positions q(u) at the ticks of the time base.

    The positions at the ticks define a motion with piecewise constant acceleration, each value an
    average of the path's own acceleration, and this motion is averaged over the window. The result
    is a cubic polynomial between ticks, so that x, x' and x'' at the ticks determine all of it. A
    tick depends on `memory` positions before it.
    """

    def __init__(self, ticks: int, dt: float) -> None:
        self.memory = ticks + 2
        self._ticks, self._dt = ticks, dt

    def smooth(self, positions: Array) -> tuple[Array, Array, Array]:
        """Return x, x', x'' (k, d) at all but the first `memory` of positions (k + memory, d)."""
        m, dt = self._ticks, self._dt
        q = positions - positions[0]
        # The motion before the average at its ticks, from three q in a row: position, and velocity
        # times dt.
        position = 0.25 * (q[:-2] + 2.0 * q[1:-1] + q[2:])
        step = 0.5 * (q[2:] - q[:-2])
        area = np.zeros_like(position)
        np.cumsum(0.5 * (position[1:] + position[:-1]), axis=0, out=area[1:])
        change = step[m:] - step[:-m]
        mean = (area[m:] - area[:-m] - change / 12.0) / m
        velocity = (position[m:] - position[:-m]) / (m * dt)
        return positions[0] + mean, velocity, change / (m * dt * dt)
