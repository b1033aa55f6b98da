"""Weighted means over time windows, of signals and of their derivatives.

Method of modulating functions (Shinbrot 1957): with a weight w that vanishes at both ends of its
window, the mean of a derivative follows by partial integration from the signal itself,
int w f' = - int w' f. So accelerations are never computed, and all signals pass the same filter:
they keep their phase to one another.
"""

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError

DEGREE = 4  #: Exponent q of the weight (1 - u^2)^q: q - 1 derivatives vanish at both ends
MIN_SAMPLES = 8  #: Smallest number of samples in a window
SPEED_HALF_WIDTH = 0.025  #: Half of the time over which a speed is fitted to positions [s]


class Windows:
    """Windows of equal width at equal steps [s]; where none fits, they raise an InputError."""

    def __init__(self, start: float, end: float, width: float, step: float) -> None:
        count = int((end - start - width) / step) + 1
        if end - start < width or count < 1:
            raise InputError(f"{end - start:.2f} s of data, a window takes {width:g} s")
        self._half = 0.5 * width
        #: (k,) times of the windows' centres [s]
        self.centres: Array = start + self._half + step * np.arange(count, dtype=np.float64)

    def mean(self, times: Array, values: Array, order: int = 0) -> Array:
        """Return the weighted mean of a signal, or of its derivative, in each window.

        Args:
            order: 0 for the signal, 1 or 2 for its first or second derivative.

        Returns:
            Means (k, c), per s^order.

        Raises:
            InputError: A window has too few samples.
        """
        spacing = np.gradient(times)
        result = np.empty((len(self.centres), values.shape[1]))
        first = np.searchsorted(times, self.centres - self._half)
        last = np.searchsorted(times, self.centres + self._half)
        for k, (centre, i, j) in enumerate(zip(self.centres, first, last, strict=True)):
            if j - i < MIN_SAMPLES:
                raise InputError(f"{j - i} samples within {2.0 * self._half:g} s: too few")
            u = (times[i:j] - centre) / self._half
            weight, slope, bend = _weight(u)
            norm = float(weight @ spacing[i:j])
            signal = values[i:j]
            if order:
                # A constant has no derivative; the sum over samples keeps that only nearly.
                signal = signal - signal.mean(axis=0)
            chosen = (weight, -slope / self._half, bend / self._half**2)[order]
            result[k] = (chosen * spacing[i:j]) @ signal / norm
        return result


def _weight(u: Array) -> tuple[Array, Array, Array]:
    """Return the weight (1 - u^2)^q and its first two derivatives by u."""
    room = np.maximum(1.0 - u * u, 0.0)
    q = DEGREE
    slope = -2.0 * q * u * room ** (q - 1)
    bend = -2.0 * q * room ** (q - 1) + 4.0 * q * (q - 1) * u * u * room ** (q - 2)
    return room**q, slope, bend


def resample(times: Array, values: Array, period: float) -> tuple[Array, Array]:
    """Return a signal (m, c) on a uniform grid of a period [s], interpolated linearly."""
    grid = np.arange(times[0], times[-1], period)
    return grid, np.column_stack([np.interp(grid, times, column) for column in values.T])


def speeds(positions: Array, period: float) -> Array:
    """Return the speeds of sampled positions: slopes of lines fitted over `SPEED_HALF_WIDTH`.

    Positions are (j, n) [rad], speeds (j, n) [rad/s].
    """
    reach = max(1, round(SPEED_HALF_WIDTH / period))
    offsets = np.arange(-reach, reach + 1)
    weights = offsets[::-1] / (period * float(offsets @ offsets))
    padded = np.pad(positions, ((reach, reach), (0, 0)), mode="edge")
    return np.column_stack([np.convolve(column, weights, mode="valid") for column in padded.T])
