"""The last seconds of some signals, for the plots."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SPAN = 15.0
"""Length of the plots [s]."""
SAMPLING = 20.0
"""Samples of the plots [Hz]."""


class Window:
    """The last seconds of some signals, sampled at an even rate.

    Args:
        signals: How many, n.
        span: How long [s].
        rate: How many samples a second; a value that comes sooner replaces the last.
    """

    def __init__(self, signals: int, span: float = SPAN, rate: float = SAMPLING) -> None:
        self._span = span
        # Half a sample is left to jitter of who samples at this very rate.
        self._shortest = 0.5 / rate
        self._times = np.full(round(span * rate), -np.inf)
        self._values = np.full((len(self._times), signals), np.nan)

    def sample(self, now: float, values: Array) -> None:
        """Add values (n,) at a time [s]; NaN for what is not known."""
        if now - self._times[-1] >= self._shortest:
            self._times[:-1] = self._times[1:]
            self._values[:-1] = self._values[1:]
            self._times[-1] = now
        self._values[-1] = values

    def clear(self) -> None:
        """Forget all samples."""
        self._times[:] = -np.inf
        self._values[:] = np.nan

    def columns(self, now: float) -> tuple[Array, ...]:
        """Times (k,) before now [s, negative], then each signal (k,)."""
        first = int(np.searchsorted(self._times, now - self._span))
        return (self._times[first:] - now, *self._values[first:].T)
