"""Speeds at which the tool may pass the bends of its path."""

import math

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.motion.whole_body.tool_curve import ROTATION_LENGTH
from omniman_ros.planning.whole_body.redundancy import LedPath

CELL = 0.001  #: Length of a cell of the path for which a speed is known [m]
MAX_CELLS = 100_000  #: Largest number of cells
#: Number of bends that are looked at in each cell: the roundings of corners are millimetres long
SAMPLES = 3
BRAKING = 0.6  #: Fraction of the acceleration by which the tool brakes before a bend


class CornerSpeeds:
    """Rates of the path parameter at which bends keep the tool's acceleration.

    At a constant rate s' the tool accelerates by s'^2 times the derivative t' of its twist per s,
    a rotation counting by `ROTATION_LENGTH`. So s' <= sqrt(a / |t'|) for the acceleration a
    [m/s^2].
    """

    def __init__(self, path: LedPath, acceleration: float) -> None:
        count = min(max(1, math.ceil(path.end / CELL)), MAX_CELLS)
        self._size = max(path.end, CELL) / count
        at = np.linspace(0.0, path.end, SAMPLES * count + 1)
        _, _, bend = path.motion(at)
        linear = np.linalg.norm(bend[:, :3], axis=1)
        angular = ROTATION_LENGTH * np.linalg.norm(bend[:, 3:], axis=1)
        strongest = np.maximum(linear, angular)
        cells = np.maximum.reduceat(strongest, np.arange(0, SAMPLES * count, SAMPLES))
        cells = np.maximum(cells, strongest[SAMPLES::SAMPLES])
        squares = acceleration / np.maximum(cells, 1e-9)
        self._caps: Array = np.sqrt(squares)
        # v^2 grows by 2 a with each metre before a bend.
        growth = 2.0 * BRAKING * acceleration * self._size * np.arange(count)
        reached = np.minimum.accumulate((squares + growth)[::-1])[::-1] - growth
        self._before: Array = np.sqrt(np.maximum(reached, 0.0))
        self._slope: Array = -BRAKING * acceleration / np.maximum(self._before, 1e-6)
        self._slope[self._before >= self._caps] = 0.0

    def approach(self, at: Array) -> tuple[Array, Array]:
        """Return the rates (k,) from which the tool can brake before the bends ahead of it.

        Their derivatives by the place (k,) come second [1/s].
        """
        index = np.clip((at / self._size).astype(int), 0, len(self._caps) - 1)
        return self._before[index], self._slope[index]

    def cap(self, first: Array, last: Array) -> Array:
        """Return the least rate (k,) over each stretch of the path from `first` to `last` [m]."""
        top = len(self._caps) - 1
        begin = np.clip((first / self._size).astype(int), 0, top)
        end = np.clip((last / self._size).astype(int), begin, top)
        pairs = zip(begin.tolist(), end.tolist(), strict=True)
        return np.array([self._caps[i : j + 1].min() for i, j in pairs])
