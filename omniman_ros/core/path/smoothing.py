"""From a path driven within speed and acceleration limits to one that keeps a jerk limit, too.

A motion whose velocity and acceleration vectors stay within a ball keeps within it under a moving
average, for a ball is convex, and the average's jerk is a difference of two accelerations over
the window: with a window of T = 2 A / J it is at most J. So every limit holds by construction, at
each instant, for vectors as for single coordinates. The price is T in time and at most A T^2 / 24
in place, across the path only where it bends.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.path.axes import AxisGroup

Array = NDArray[np.float64]


def window_ticks(groups: Sequence[AxisGroup], dt: float) -> int:
    """Ticks in the window that keeps every group's jerk limit."""
    window = max(2.0 * group.acceleration / group.jerk for group in groups)
    return max(1, math.ceil(window / dt - 1e-9))


def deviation(acceleration: float, ticks: int, dt: float) -> float:
    """How far the average leaves the path at most [m or rad]."""
    # A T^2 / 24 for the window, and A dt^2 / 4 for the three samples of a tick.
    return acceleration * dt * dt * (ticks * ticks / 24.0 + 0.25)


class Smoother:
    """A filter of finite length on the positions q(u) at the ticks of the time base.

    The positions at ticks become the knots of a motion with a piecewise constant acceleration
    (each an average of the path's own), and that is averaged over the window. The result is a
    cubic polynomial between ticks, so that x, x' and x'' at the ticks say all of it.

    Args:
        ticks: Length m of the window.
        dt: Tick [s].

    Attributes:
        memory: How many positions before a tick count for it.
    """

    def __init__(self, ticks: int, dt: float) -> None:
        self.memory = ticks + 2
        self._ticks, self._dt = ticks, dt

    def smooth(self, positions: Array) -> tuple[Array, Array, Array]:
        """x, x', x'' (k, d) at each tick but the first `memory` of positions (k + memory, d)."""
        m, dt = self._ticks, self._dt
        q = positions - positions[0]
        # The inner motion at its ticks: position, and velocity times dt, from three q in a row.
        place = 0.25 * (q[:-2] + 2.0 * q[1:-1] + q[2:])
        speed = 0.5 * (q[2:] - q[:-2])
        area = np.zeros_like(place)
        np.cumsum(0.5 * (place[1:] + place[:-1]), axis=0, out=area[1:])
        lift = speed[m:] - speed[:-m]
        mean = (area[m:] - area[:-m] - lift / 12.0) / m
        return positions[0] + mean, (place[m:] - place[:-m]) / (m * dt), lift / (m * dt * dt)
