"""Wheel speeds on their way to rest, or up to a command again, all in step."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class SpeedRamp:
    """Speeds of all wheels that keep their proportions: the robot stays on its curve.

    Args:
        n: Number of wheels.
    """

    def __init__(self, n: int) -> None:
        self._speeds: Array = np.zeros(n)
        self._at: float | None = None
        self._catching = True

    def rest(self) -> None:
        """Stand; the next command is approached by a ramp."""
        self._speeds = np.zeros_like(self._speeds)
        self._at, self._catching = None, True

    def begin(self, speeds: Array, at: float | None = None) -> None:
        """Start from speeds (n,), rad/s, as they were at a time, s; None: the next call's."""
        self._speeds, self._at, self._catching = speeds, at, True

    def down(self, deceleration: float, now: float) -> Array:
        """Return the speeds (n,) on the way to rest; the fastest wheel has this deceleration."""
        step, fastest = self._step(deceleration, now), float(np.abs(self._speeds).max())
        self._catching = True
        share = 1.0 - step / fastest if fastest > step else 0.0
        self._speeds = self._speeds * share
        return self._speeds

    def towards(self, target: Array, acceleration: float, now: float) -> Array:
        """Return the speeds (n,) on the way to a command; once it is met they follow it."""
        step = self._step(acceleration, now)
        if self._catching:
            way = target - self._speeds
            furthest = float(np.abs(way).max())
            if furthest > step:
                self._speeds = self._speeds + way * (step / furthest)
                return self._speeds
            self._catching = False
        self._speeds = target
        return target

    def _step(self, rate: float, now: float) -> float:
        last, self._at = self._at, now
        return rate * max(now - last, 0.0) if last is not None else 0.0
