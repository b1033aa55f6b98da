"""Ramps of the wheel speeds to rest and up to a command, synchronised over all wheels."""

import numpy as np

from omniman_ros.core.arrays import Array


class SpeedRamp:
    """Ramps the speeds of all wheels in proportion, so that the robot stays on its curve."""

    def __init__(self, n: int) -> None:
        self._speeds: Array = np.zeros(n)
        self._at: float | None = None
        self._is_catching_up = True

    def rest(self) -> None:
        """Set all speeds to zero; the next command is approached by a ramp."""
        self._speeds = np.zeros_like(self._speeds)
        self._at, self._is_catching_up = None, True

    def begin(self, speeds: Array, at: float | None = None) -> None:
        """Start from speeds (n,) [rad/s] of a time [s], or else of the next call's."""
        self._speeds, self._at, self._is_catching_up = speeds, at, True

    def step_to_rest(self, deceleration: float, now: float) -> Array:
        """Return the next speeds (n,) [rad/s] of the ramp to rest.

        Args:
            deceleration: Deceleration of the fastest wheel [rad/s^2].
        """
        step, fastest = self._step(deceleration, now), float(np.abs(self._speeds).max())
        self._is_catching_up = True
        scale = 1.0 - step / fastest if fastest > step else 0.0
        self._speeds = self._speeds * scale
        return self._speeds

    def step_towards(self, target: Array, acceleration: float, now: float) -> Array:
        """Return the next speeds (n,) [rad/s] of the ramp to a command, then the command itself.

        Args:
            acceleration: Acceleration of the wheel with the largest change [rad/s^2].
        """
        step = self._step(acceleration, now)
        if self._is_catching_up:
            change = target - self._speeds
            largest = float(np.abs(change).max())
            if largest > step:
                self._speeds = self._speeds + change * (step / largest)
                return self._speeds
            self._is_catching_up = False
        self._speeds = target
        return target

    def _step(self, rate: float, now: float) -> float:
        last, self._at = self._at, now
        return rate * max(now - last, 0.0) if last is not None else 0.0
