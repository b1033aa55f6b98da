"""Speeds at which the bends of a path may be passed."""

import math
from collections.abc import Callable

import numpy as np

from omniman_ros.core.arrays import Array

CELL = 0.001  #: Length of a cell of the path for which a speed is known [m]
MAX_CELLS = 100_000  #: Largest number of cells
#: Number of bends that are looked at in each cell: the roundings of corners are millimetres long
SAMPLES = 3
BRAKING = 0.6  #: Fraction of the acceleration by which the tool brakes before a bend


class CornerSpeeds:
    """Rates of the path parameter at which bends keep an acceleration.

    At a constant rate s', what follows the path accelerates by s'^2 times its bend b(s) [1/m]. So
    s' <= sqrt(a / b) for the acceleration a [m/s^2].

    Args:
        bends: Returns b (k,) at places (k,) from 0 to the path's end [m].
    """

    def __init__(self, end: float, bends: Callable[[Array], Array], acceleration: float) -> None:
        count = min(max(1, math.ceil(end / CELL)), MAX_CELLS)
        self._size = max(end, CELL) / count
        strongest = bends(np.linspace(0.0, end, SAMPLES * count + 1))
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
